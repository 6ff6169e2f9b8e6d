"""The advisor in a process of its own, so that it cannot hold up the loop (docs/until.md).

``python -m rig.running.experiment.live_process FOLDER`` reads the growing run folder, as
``rig.run_folder.recording.follow`` does: no row
goes from the loop to it. It gets the settings by its standard input, a word when the guard had to brake, and ends at
the end of that input. Its advice comes by its standard output, which the loop looks at without ever waiting. With each
advice it says how often it was told that the guard had to brake: a test designed before that has too much room. What it
writes on its standard error says why it ended, if it did.
"""

from __future__ import annotations

import contextlib
import os
import pickle
import queue
import subprocess
import sys
import threading
import time
from dataclasses import replace
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any

from rig.run_folder.recording.errors import RecordingError

if TYPE_CHECKING:
    from rig.design.advisor import Advice, Advisor, AdvisorSettings

ADVICE_EVERY_S = 1.0
LOOK_EVERY_S = 0.02
SILENT_S = 5.0  # without advice: it hangs, or the machine has no time for it
NICE = 10  # the loop, and the process that writes the rows, go first
BRAKED = b"braked"
_CLOSES_S = 5.0
_LAST_BYTES = 2000  # of its standard error, which are kept: the end of a traceback
_ONE_THREAD = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}


class LiveProcess:
    """The loop's side of the process. Nothing here waits for it, or ends a run for it.

    folder   the run folder

    trouble     what is wrong with the process, in words; empty if nothing is
    last_words  the end of what it wrote on its standard error, once it has ended
    """

    def __init__(self, folder: Path) -> None:
        self.trouble = self.last_words = ""
        self._errors = bytearray()
        self._said: queue.SimpleQueue[tuple[Advice, int] | None] = queue.SimpleQueue()
        self._braked = 0  # how often it was told that the guard had to brake
        self._heard_s: float | None = None  # when it was told to begin, or last gave advice
        self._process: subprocess.Popen[bytes] | None = None
        try:
            self._process = subprocess.Popen(
                [sys.executable, "-P", "-m", "rig.running.experiment.live_process", str(folder)],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.PIPE,
                env={**os.environ, **_ONE_THREAD},
                start_new_session=True,  # Ctrl-C in the terminal is not meant for it
            )
        except OSError as error:
            self.trouble = f"its process did not start: {error.strerror}"
            return
        # threads wait for its words, because not every system can poll a pipe
        self._thread = threading.Thread(target=_listen, args=(self._said, self._process.stdout), daemon=True)
        self._last_thread = threading.Thread(target=_keep_end, args=(self._errors, self._process.stderr), daemon=True)
        self._thread.start()
        self._last_thread.start()

    def begin(self, settings: AdvisorSettings) -> None:
        """Tell it what the breakaway check showed."""
        self._heard_s = time.monotonic()
        self._tell(settings)

    def braked(self) -> None:
        """Tell it that the guard had to brake."""
        self._braked += 1
        self._tell(BRAKED)

    def advice(self, row: int, t_s: float) -> Advice | None:
        """Advice that has come since the last call; None without any. A test designed before a braking is left out."""
        message = None
        with contextlib.suppress(queue.Empty):
            message = self._said.get_nowait()
        if message is None:
            self._look_after()
            return None
        self._heard_s, self.trouble = time.monotonic(), ""
        advice, braked = message
        return advice if braked == self._braked else replace(advice, design=None)

    def close(self) -> None:
        """End the process, whatever it does."""
        process = self._process
        if process is None:
            return
        if process.stdin is not None:
            with contextlib.suppress(OSError):
                process.stdin.close()
        process.kill()  # its words end, and with them the threads, which close the pipes
        process.wait()
        self._thread.join(_CLOSES_S)
        self._last_thread.join(_CLOSES_S)

    def _tell(self, message: AdvisorSettings | bytes) -> None:
        """Send a message. All messages of a run fit into the pipe, so nothing waits even if nobody reads them."""
        process = self._process
        if process is None or process.stdin is None:
            return
        try:
            pickle.dump(message, process.stdin)
            process.stdin.flush()
        except OSError as error:
            self.trouble = self.trouble or f"its process takes no message: {error.strerror}"

    def _look_after(self) -> None:
        status = None if self._process is None else self._process.poll()
        if status is not None:
            if self._last_thread.is_alive():
                return  # its last words are on their way
            self.last_words = self._errors.decode(errors="replace").strip()
            if status < 0:
                self.trouble = f"its process was killed by signal {-status}"
            else:
                self.trouble = ": ".join(
                    [f"its process ended with status {status}", *self.last_words.splitlines()[-1:]]
                )
        elif self._heard_s is not None and time.monotonic() - self._heard_s > SILENT_S:
            self.trouble = f"its process has said nothing for {SILENT_S:g} s"


def main(arguments: list[str]) -> int:
    """Advise on the run folder ``arguments[0]`` until the input ends."""
    if hasattr(os, "nice"):
        os.nice(NICE)
    from rig.design.advisor import Advisor

    told: queue.SimpleQueue[Any] = queue.SimpleQueue()
    threading.Thread(target=_listen, args=(told, os.fdopen(0, "rb")), daemon=True).start()
    settings = told.get()
    if settings is not None:
        with contextlib.suppress(BrokenPipeError), os.fdopen(1, "wb") as said:  # until nobody reads it
            _advise(Path(arguments[0]), Advisor(settings), told, said)
    return 0


def _advise(folder: Path, advisor: Advisor, told: queue.SimpleQueue[Any], said: IO[bytes]) -> None:
    from rig.run_folder.recording.csv_file import read_csv
    from rig.run_folder.recording.writer import SAMPLES

    known = None
    braked = 0
    due_s = -1.0  # time of the run
    while True:
        with contextlib.suppress(queue.Empty):
            message = told.get(timeout=LOOK_EVERY_S)
            if message is None:
                return
            advisor.braked()
            braked += 1
            due_s = -1.0
        try:
            known = read_csv(folder / SAMPLES, own=True, known=known)
        except RecordingError:
            continue  # it holds no three rows yet
        if known.t_s[-1] < due_s:
            continue
        advisor.take(known)
        due_s = float(known.t_s[-1]) + ADVICE_EVERY_S
        advice = advisor.advise()
        if advice is not None:
            pickle.dump((advice, braked), said)
            said.flush()


def _listen(heard: queue.SimpleQueue[Any], pipe: IO[bytes] | None) -> None:
    """Put each message of a pipe into a queue, and None at its end."""
    if pipe is not None:
        # ValueError: it was closed meanwhile; UnpicklingError: it ended within a message
        with contextlib.suppress(EOFError, OSError, ValueError, pickle.UnpicklingError), pipe:
            while True:
                heard.put(pickle.load(pipe))
    heard.put(None)


def _keep_end(kept: bytearray, pipe: IO[bytes] | None) -> None:
    """Keep the last bytes of a pipe, until its end."""
    if pipe is not None:
        with contextlib.suppress(OSError, ValueError), pipe:
            while data := pipe.read(_LAST_BYTES):
                kept += data
                del kept[:-_LAST_BYTES]


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
