"""Live progress of a run. It reads the growing run folder in a process of its own, so it cannot delay the loop.

``python -m rig.run_folder.recording.follow FOLDER`` shows the stage, the last readings and the cycles. It ends with the
run, or
with the process that started it (end of standard input). If standard error is not a terminal, it prints one plain line
at the begin of each stage.
"""

from __future__ import annotations

import math
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, BinaryIO

from rig.core import strict_json
from rig.core.halted import end_within
from rig.core.plain_file import open_plain
from rig.core.strict_json import JsonObject
from rig.run_folder.recording.sample_columns import COLUMNS
from rig.run_folder.recording.writer import EndOfInput, end_of_input

if TYPE_CHECKING:  # rich loads slowly, and plain lines do not need it
    from rich.table import Table


REFRESH_S = 0.2
COMPUTES_S = 1.0  # without a row or an event: the drive is off, and the run computes
BAR_WIDTH = 41
ROWS_BELOW = 8  # of a terminal: the present stage, whose words may wrap, the shaft, and what wraps above
LACKING = 1.5  # residual over the noise of a live estimate beyond which its intervals are clearly too narrow


@contextmanager
def following(folder: Path) -> Iterator[None]:
    """Show the progress of ``folder`` while the block runs, on this process's own standard error; nowhere else."""
    try:
        is_shared = sys.stderr.fileno() == 2  # a child process writes to descriptor 2
    except (OSError, ValueError):
        is_shared = False
    if not is_shared:
        yield
        return
    viewer = subprocess.Popen(
        [sys.executable, "-P", "-m", "rig.run_folder.recording.follow", str(folder)],
        stdin=subprocess.PIPE,
        start_new_session=True,
    )
    try:
        yield
    finally:
        if viewer.stdin is not None:
            viewer.stdin.close()
        end_within(viewer, 3.0)


class Tail:
    """Reads the new whole lines of a file while another process appends to it.

    last_bytes  of a file that is longer, the first call reads only the whole lines in so many bytes; None: all
    most_bytes  that one call reads, the rest with later calls; None: all
    """

    def __init__(self, path: Path, last_bytes: int | None = None, most_bytes: int | None = None) -> None:
        self.path = path
        self._offset = 0
        self._last_bytes = last_bytes
        self._most_bytes = -1 if most_bytes is None else most_bytes

    def lines(self) -> list[str]:
        """Lines completed since the last call; none while there is no file.

        Raises OSError for a link, and for what is no file: a pipe that nobody writes would hold up whoever reads it.
        """
        try:
            with os.fdopen(open_plain(self.path), "rb") as file:
                torn = self._skip(file)
                file.seek(self._offset)
                data = file.read(self._most_bytes)
        except FileNotFoundError:
            return []
        end = data.rfind(b"\n") + 1
        if not end and len(data) == self._most_bytes:  # no line of ours is as long: go on behind this piece
            end = len(data)
        self._offset += end
        return data[:end].decode("ascii", errors="replace").splitlines()[torn:]

    def _skip(self, file: BinaryIO) -> int:
        """Skip what the first call does not read. Returns the number of lines that are torn by that: 1 or 0."""
        last_bytes, self._last_bytes = self._last_bytes, None
        if last_bytes is None:
            return 0
        self._offset = max(file.seek(0, os.SEEK_END) - last_bytes, 0)
        return int(self._offset > 0)


def event_of(line: str) -> JsonObject:
    """A line of events.jsonl. Raises ValueError for what is no event."""
    event = strict_json.parse(line)
    if not isinstance(event, dict):
        raise ValueError("no JSON object")
    return event


class Progress:
    """The state of the run so far, and how to show it."""

    def __init__(self) -> None:
        self.stage = "starting"
        self.detail = ""
        self.done: list[tuple[str, str, str]] = []  # "done" or "ended", stage, its outcome
        self.fault = False
        self.ended = False
        self.still_s = 0.0  # since the last row or event came
        self.t_s = 0.0
        self.y_rad = 0.0
        self.u_V = 0.0
        self.reach_rad = 0.2

    def take_event(self, event: JsonObject) -> None:
        """Take an event. Raises KeyError, TypeError, ValueError for one that rig does not write."""
        kind = event.get("kind")
        if kind == "stage":
            if self.stage not in ("starting", "rest", event["name"]):  # a stage may have several laws
                self.done.append(("done", self.stage, self.detail))
            self.stage, self.detail = str(event["name"]), ""
        elif kind == "breakaway":
            self.detail = f"moves at {event['plus_V']:+.2f} V and {-real(event['minus_V']):+.2f} V"
        elif kind == "search":
            self.detail = f"h1 {event['h1_V']:.2f} V, h2 {event['h2_V']:.2f} V: {event['outcome']}"
            if event.get("amplitude_rad") is not None:
                self.detail += f", {event['amplitude_rad']:.2f} rad, {event['period_s']:.2f} s"
        elif kind == "live":
            self.detail = live_words(event)
        elif kind == "decided" and event.get("what") in ("stop", "rest"):
            self.detail = "; ".join(filter(None, (self.detail, decided_words(event))))
        elif kind == "cycle":
            settled = "settled" if event["settled"] else "settling"
            self.detail = (
                f"cycle {event['number']} ({settled}): {event['amplitude_rad']:.3f} rad, {event['period_s']:.3f} s"
            )
        elif kind == "fault":
            self.detail = f"{event['code']}: {event['cause']}"
            self.fault = True
        elif kind == "end":
            self.done.append(("ended" if self.fault else "done", self.stage, self.detail))
            self.ended = True

    def take_row(self, line: str) -> None:
        """Take one line of samples.csv."""
        row = dict(zip(COLUMNS, line.split(","), strict=False))
        try:
            self.t_s, self.y_rad, self.u_V = float(row["t_s"]), float(row["y_rad"]), float(row["u_V"])
        except (KeyError, ValueError):
            return  # the header, or a line that is not complete yet
        self.reach_rad = max(self.reach_rad, abs(self.y_rad))

    def picture(self, most_done: int = 0, *, draws: bool = False) -> Table:
        """The finished stages, the present one, and the shaft as a mark on a line.

        most_done  of the finished stages, the newest; 0: all
        draws      whether the report is still drawn once the run is over
        """
        from rich.table import Table
        from rich.text import Text

        table = Table.grid(padding=(0, 2))
        so_long = f", {self.still_s:.0f} s" if self.still_s >= COMPUTES_S else ""
        for end, stage, detail in self.done[-most_done:]:
            table.add_row(Text(end, style="green" if end == "done" else "red"), stage, detail)
        if self.ended and draws:
            what = "the motor is identified, and drawn" if self.fault else "is drawn"
            table.add_row(Text("now", style="yellow"), "report", f"{what}{so_long}")
        if not self.ended:
            middle = BAR_WIDTH // 2
            mark = middle + round(middle * self.y_rad / self.reach_rad)
            line = "".join("|" if k == mark else "+" if k == middle else "." for k in range(BAR_WIDTH))
            computes = f"computing{so_long}" if so_long else self.detail
            table.add_row(Text("now", style="yellow"), self.stage, computes)
            table.add_row("", f"{self.t_s:6.1f} s", f"{line}  {self.y_rad:+.2f} rad {self.u_V:+.2f} V")
        return table


def live_words(event: JsonObject) -> str:
    """A live estimate: each value with half its 95 % interval, and what else it says."""
    values = (
        ("tau", "tau_s", "tau_percent", "s"),
        ("K", "K_rad_s_V", "K_percent", ""),
        ("f_c", "fc_V", "fc_percent", "V"),
    )
    shown = []
    for title, name, half, unit in values:
        value, percent = event.get(name), event.get(half)
        if value is not None and percent is not None:
            shown.append(f"{title} {value:.4g}{' ' + unit if unit else ''} ±{percent:.2g} %")
    remark = live_remark(event)
    separator = ", " if remark.startswith("with") else ": "
    return ", ".join(shown) + (separator + remark if remark else "")


def live_remark(event: JsonObject) -> str:
    """What else a live estimate says: the laws that it has, and whether its residual is too large; else nothing."""
    said = []
    laws, residual = event.get("laws"), event.get("residual_over_noise")
    if isinstance(laws, str) and laws:
        said.append("with " + " and ".join(laws.split(", ")).replace("_", " "))
    if isinstance(residual, float) and residual > LACKING:
        said.append(f"the residual is {residual:.2g} times the noise, so ± is too small")
    return ": ".join(said)


def decided_words(event: JsonObject) -> str:
    """What the tests go over to, and why."""
    what, why = event.get("what"), event.get("why") or ""
    if what == "stop":
        return f"enough: {why}" if event.get("by") == "advice" else f"over: {why}"
    if what == "rest":
        return f"broken off: {why}"
    seconds = event.get("expected_s")
    expected = f", {event['expected_percent']:.2g} % expected within {seconds:.1f} s" if seconds is not None else ""
    return f"next: {what}{expected}"


def number(value: object) -> float | None:
    """A finite number, or None for anything else."""
    is_number = isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)
    return float(value) if is_number else None  # type: ignore[arg-type]  # checked in the line above


def real(value: object) -> float:
    """A finite number. Raises ValueError for anything else."""
    found = number(value)
    if found is None:
        raise ValueError("no number")
    return found


def stage_line(event: JsonObject) -> str | None:
    """One plain line for a stage, a live estimate or why there is none, the end of tests, a fault; else None."""
    if event.get("kind") == "stage" and event["name"] != "rest":
        words = str(event["name"])
    elif event.get("kind") == "live":
        words = f"  {live_words(event)}"
    elif event.get("kind") == "decided" and event.get("what") in ("stop", "rest"):
        words = f"  {decided_words(event)}"
    elif event.get("kind") == "no_advice":
        words = f"  no live estimate: {event['why']}"
    elif event.get("kind") == "fault":
        words = f"{event['code']}: {event['cause']}"
    else:
        return None
    return f"{event['t_s'] or 0.0:7.1f} s  {words}"


def print_stages(events: Tail, waiting: EndOfInput) -> None:
    """Print each stage's line until the input ends, or until nobody reads standard error any more."""
    over, stage = False, ""
    while not over:
        over = waiting.wait(REFRESH_S)
        for line in events.lines():
            try:
                event = event_of(line)
                draws = event.get("kind") == "end" and not over
                text = f"{event['t_s'] or 0.0:7.1f} s  report" if draws else stage_line(event)
            except (ValueError, KeyError, TypeError):
                continue  # whoever reads the run afterwards says what is wrong with its files
            goes_on = event.get("kind") == "stage" and str(event["name"]) == stage
            stage = str(event["name"]) if event.get("kind") == "stage" else stage
            if text is not None and not goes_on:
                try:
                    sys.stderr.write(text + "\n")
                    sys.stderr.flush()
                except OSError:
                    return


def main(arguments: list[str]) -> int:
    """Show the progress of the run folder ``arguments[0]`` until the run ends."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    folder = Path(arguments[0])
    events, samples = Tail(folder / "events.jsonl"), Tail(folder / "samples.csv")
    waiting = end_of_input()
    if not sys.stderr.isatty():
        print_stages(events, waiting)
        return 0
    from rich.console import Console
    from rich.live import Live

    progress = Progress()
    console = Console(stderr=True)
    with Live(console=console, auto_refresh=False, transient=False) as live:
        over = False
        seen_s = time.monotonic()
        while not over:
            over = waiting.wait(REFRESH_S)
            happened, rows = events.lines(), samples.lines()
            for line in happened:
                with suppress(ValueError, KeyError, TypeError):
                    progress.take_event(event_of(line))
            if rows:
                progress.take_row(rows[-1])
            seen_s = time.monotonic() if happened or rows else seen_s
            progress.still_s = time.monotonic() - seen_s
            # a terminal cuts the end of what is higher than it, and that is the present stage
            most_done = 0 if over else max(console.height - ROWS_BELOW, 1)
            live.update(progress.picture(most_done, draws=not over), refresh=True)
            if progress.ended and not over:
                time.sleep(REFRESH_S)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
