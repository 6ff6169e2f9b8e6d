"""A calibration as the pages see it: what was said, the open question, and the process that does it.

Who lets a calibration drive has to be there: the panel promises it by leases, and the calibration's loop looks. Their
file is in rig's own folder beside the run folders. If the panel is killed or frozen, nothing has to notice: the last
lease runs out, and the drive is 0.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import threading
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from itertools import count
from pathlib import Path
from typing import Final

from rig.core.signals import plain
from rig.panel.messages import Answer, CalibrationEnd, CalibrationShown, Question, RefusedError, Said
from rig.run_folder.live.lease import HeldLease, Leaser
from rig.run_folder.live.own_folder import OwnFolder
from rig.running.calibrate.dialogue import ALONE

EVERY_S: Final = 0.05  # between two promises, each of 150 ms


@contextmanager
def watched(out: Path) -> Iterator[Callable[[], str]]:
    """In the calibration's process, for the block: what tells whether the panel is gone. Raises OSError.

    out  folder of the run folders
    """
    with OwnFolder(out) as folder, HeldLease(folder, name=_name(os.getpid())) as held:
        yield lambda: "" if held.holds() else ALONE


class Attendance:
    """The panel's promises to the calibration of process ``pid``. Not for two threads at once."""

    def __init__(self, out: Path, pid: int) -> None:
        self._out, self._name = out, _name(pid)
        self._leaser: Leaser | None = None

    def renew(self) -> None:
        """Promise to be there for 150 ms from now; nothing where there is no calibration that looks."""
        with suppress(OSError, ValueError):
            if self._leaser is None:
                with OwnFolder(self._out, makes=False) as folder:
                    self._leaser = Leaser(folder, name=self._name)
            self._leaser.stay()

    def end(self) -> None:
        """Promise no more; may be called twice."""
        leaser, self._leaser = self._leaser, None
        if leaser is not None:
            leaser.close()


def _name(pid: int) -> str:
    return f"calibration-{pid}.lease"


_LAST_WORDS_LINES: Final = 12
_MOST_SAID: Final = 500
_LONGEST_ANSWER: Final = 200
_NUMBERS: Final = count(1)  # of questions: none twice, or an old page's answer would be taken by a later calibration


class Calibration:
    """One calibration, from its begin to its end. It ends by itself when the panel does; its drive, when ``attend`` is
    not called any more.

    changed  called whenever there is something new to show
    Raises RefusedError if its process cannot be started.
    """

    def __init__(self, config: Path, out: Path, changed: Callable[[], object]) -> None:
        self._changed = changed
        self._lock = threading.Lock()
        self._said: deque[Said] = deque(maxlen=_MOST_SAID)
        self._words: deque[str] = deque(maxlen=_LAST_WORDS_LINES)  # that are none of its messages: an error
        self._question: Question | None = None
        self._does = "opens the config"
        self._end: CalibrationEnd | None = None
        self._was_stopped = False
        try:
            self._process = subprocess.Popen(
                [sys.executable, "-P", "-m", "rig.panel.calibrating", str(config), str(out)],
                stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, start_new_session=True,
                encoding="utf-8", errors="replace",
            )  # fmt: skip
        except OSError as error:
            raise RefusedError(503, f"the calibration cannot be started: {error.strerror}", "try again") from error
        self._attendance = Attendance(out, self.pid)
        threading.Thread(target=self._hear, daemon=True).start()

    @property
    def pid(self) -> int:
        """Of its process, which is also that of the strokes' run."""
        return self._process.pid

    @property
    def goes_on(self) -> bool:
        """Whether it has not ended."""
        return self._end is None

    @property
    def works(self) -> bool:
        """Whether it reads, drives or computes; else it waits for an answer, or is over, and nothing drives."""
        return self._end is None and self._question is None

    def shown(self) -> CalibrationShown:
        """All that a page shows of it."""
        with self._lock:
            return {
                "said": list(self._said), "question": self._question, "end": self._end,
                "does": self._does if self._end is None and self._question is None else None,
            }  # fmt: skip

    def answer(self, number: object, answer: Answer) -> None:
        """Answer the open question. Raises RefusedError if it is another one by now."""
        with self._lock:
            if self._question is None or number != self._question.get("number"):
                raise RefusedError(409, "this question is not open any more", "look at the page, and answer again")
            text = json.dumps(answer)
            if len(text) > _LONGEST_ANSWER:
                raise RefusedError(400, "that is too long for an answer", "type less")
            shown = _shown(answer)
            if shown:
                self._said.append({"kind": "answer", "words": shown, "drawings": []})
            self._question, self._does = None, "computes"
            assert self._process.stdin is not None
            with suppress(OSError, ValueError):  # it has ended: its last words are on their way
                self._process.stdin.write(text + "\n")
                self._process.stdin.flush()
        self._changed()

    def attend(self) -> None:
        """Promise to be there, as ``Attendance.renew``. For one thread, every ``EVERY_S``."""
        if self._end is None:
            self._attendance.renew()
        else:
            self._attendance.end()

    def stop(self, *, by_flag: bool) -> None:
        """Stop what drives. At a question nothing drives; an answer that is on its way is not taken any more.

        by_flag  a run of it was stopped already
        """
        with self._lock:
            if self._question is not None:
                self._question = {**self._question, "number": next(_NUMBERS)}
            elif self._end is None and not by_flag:
                self._was_stopped = True
                self._process.terminate()
        self._changed()

    def _hear(self) -> None:
        with self._process as process:  # its pipes are closed at the end
            assert process.stdout is not None
            for line in process.stdout:
                self._take(line)
                self._changed()
        with self._lock:
            self._question = None
            if self._end is None:
                if self._was_stopped:
                    words, cure = "stopped; nothing is written", "begin again"
                else:
                    last = " ".join(list(self._words)[-1:]) or f"exit status {process.returncode}"
                    words, cure = f"the calibration has failed: {last}", "try rig calibrate in a terminal"
                self._end = {"written": False, "words": words, "cure": cure}
        self._changed()

    def _take(self, line: str) -> None:
        try:
            said = json.loads(line)
            kind = said.pop("type")
        except (ValueError, KeyError, AttributeError, TypeError):
            self._words.append(plain(line.rstrip()))
            return
        with self._lock:
            if kind == "ask":
                self._question = said | {"number": next(_NUMBERS)}
                self._was_stopped = False  # that Stop has ended what it was for
            elif kind == "does":
                self._does = said["words"]
            elif kind == "end":
                self._end = said
            else:
                self._said.append(said)


def _shown(answer: Answer) -> str:
    """An answer in the list of what was said."""
    if "steps" in answer:
        return ", ".join(answer["steps"])
    if answer.get("skip"):
        return "left out"
    return plain(answer.get("answer", ""))
