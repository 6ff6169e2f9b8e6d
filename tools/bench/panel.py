"""What the panel costs: the share of a core that its process takes, and the loop beside it.

PYTHONPATH=tools python -m bench.panel [--json] [--seconds 12]

`rig panel` starts a relay test on the emulated serial board in real time. Told are: the share of a core that the panel
takes with one page, with five, and with five and a client that floods it, each at 25 messages a second; how late the
loop's ticks begin in the last case, second by second in turn with none of them: panel and flood stand still; and the
time from a click on Stop in a headless Chromium until the device has confirmed 0 V. `stop.mjs` makes that click.
"""

from __future__ import annotations

import contextlib
import json
import logging
import os
import re
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import httpx2 as httpx
import numpy as np
from websockets.exceptions import WebSocketException
from websockets.sync.client import ClientConnection, connect
from websockets.typing import Origin

from bench.benchmark import options, tell
from bench.tick import CONFIG
from rig.run_folder.live.running import running
from rig.run_folder.live.view import LiveView
from rig.run_folder.recording.reader import read_run
from shared.table import markdown

PAGES = (1, 5)
TRIES = 5
HERE = Path(__file__).resolve().parent
TURN_S = 1.0
UNTIL = "until: {interval_percent: 0.4}"
GAINS = "gains: [{h1_V: 0.3905, h2_V: 0.8711}]\n  cycles: 100"


@dataclass
class Page:
    """A page: counts what it hears, and keeps the age of the newest row at each message."""

    opened: ClientConnection
    ages_ms: list[float] = field(default_factory=list)

    def hear(self) -> None:
        """Until the socket closes."""
        with contextlib.suppress(WebSocketException, OSError):
            for text in self.opened:
                message = json.loads(text)
                if message["type"] == "live" and message["age_ms"] is not None:
                    self.ages_ms.append(message["age_ms"])


class Panel:
    """A `rig panel` process, its operator, and its pages."""

    def __init__(self, folder: Path) -> None:
        self.out = folder / "runs"
        config = folder / "bench.yaml"
        text = (CONFIG / "demo.yaml").read_text(encoding="utf-8").replace("port: emulated ", "port: emulated-realtime ")
        config.write_text(text.replace(UNTIL, GAINS), encoding="utf-8")
        command = [sys.executable, "-m", "rig", "panel", str(config), "--out", str(self.out), "--port", "0"]
        self.process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True, start_new_session=True)
        assert self.process.stdout is not None
        found = re.search(r"(http://127\.0\.0\.1:\d+)/\?token=(\S+)", self.process.stdout.readline())
        assert found is not None
        self.origin = found[1]
        self.browser = httpx.Client(base_url=self.origin, headers={"origin": self.origin}, timeout=60.0)
        wait_for(self._answers)
        self.browser.get("/", params={"token": found[2]})

    def _answers(self) -> bool:
        with contextlib.suppress(httpx.ConnectError):
            return self.browser.get("/api/state").status_code == 200
        return False

    @contextlib.contextmanager
    def pages(self, number: int) -> Iterator[list[Page]]:
        """So many pages, open in the block."""
        url = self.origin.replace("http", "ws") + "/ws"
        cookie = "; ".join(f"{key}={value}" for key, value in self.browser.cookies.items())
        with contextlib.ExitStack() as stack:
            found = []
            for _ in range(number):
                opened = connect(
                    url, origin=Origin(self.origin), additional_headers={"cookie": cookie}, close_timeout=0.2
                )
                found.append(Page(stack.enter_context(opened)))
                threading.Thread(target=found[-1].hear, daemon=True).start()
            yield found

    @contextlib.contextmanager
    def flood(self) -> Iterator[subprocess.Popen[bytes]]:
        """A process that sends as fast as it can, and comes back whenever it is cut off."""
        command = [sys.executable, "-m", "bench.panel", "--flood", self.origin]
        flooding = subprocess.Popen(command)
        try:
            yield flooding
        finally:
            flooding.kill()
            flooding.wait()

    def cpu_s(self) -> float:
        """CPU time of the panel's process so far, s."""
        fields = Path(f"/proc/{self.process.pid}/stat").read_text(encoding="utf-8").rpartition(")")[2].split()
        return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")

    def share(self, seconds: float) -> float:
        """The share of a core that it takes for so long."""
        begin_s, cpu_s = time.monotonic(), self.cpu_s()
        time.sleep(seconds)
        return (self.cpu_s() - cpu_s) / (time.monotonic() - begin_s)

    def start(self) -> Path:
        """Start the run; returns its folder once a relay test goes on.

        On a busy machine the emulated board may be too late, which ends a run: then another one begins.
        """
        for _ in range(TRIES):
            checked = self.browser.post("/api/check").json()
            self.browser.post("/api/start", json={"confirmed": True, "confirmation": checked["confirmation"]})
            wait_for(lambda: bool(running(self.out)))
            folder = running(self.out)[-1].folder
            view = LiveView(folder)
            wait_for(lambda view=view: view.read().stage == "relay-1" or not running(self.out))
            if running(self.out):
                return folder
        raise RuntimeError("no run came to its relay test")

    def close(self) -> None:
        """End the panel, and the run."""
        self.process.send_signal(signal.SIGCONT)
        self.browser.post("/api/stop")
        wait_for(lambda: not running(self.out))
        self.process.terminate()
        self.process.wait()
        assert self.process.stdout is not None
        self.process.stdout.close()


def wait_for(true: Any) -> None:
    """Return once it is so; RuntimeError after two minutes."""
    until_s = time.monotonic() + 120.0
    while not true():
        if time.monotonic() > until_s:
            raise RuntimeError("the bench did not get there")
        time.sleep(0.05)


def flood(origin: str) -> None:
    """Be the client that floods, until killed."""
    logging.getLogger("websockets").disabled = True  # being cut off is what a flood is for
    while True:
        with (
            contextlib.suppress(WebSocketException, OSError),
            connect(origin.replace("http", "ws") + "/ws", origin=Origin(origin), close_timeout=0.1) as opened,
        ):
            while True:
                opened.send('{"type": "seen", "n": 1}')


def turns(both: tuple[subprocess.Popen[Any], ...], seconds: float) -> list[tuple[float, bool]]:
    """Let the panel and its flood run and stand still in turn; returns when each turn began, and whether they ran.

    both  the processes of panel and flood
    """
    begun = []
    for turn in range(2 * round(seconds / (2.0 * TURN_S))):
        for process in both:
            process.send_signal(signal.SIGSTOP if turn % 2 else signal.SIGCONT)
        begun.append((time.monotonic(), turn % 2 == 0))
        time.sleep(TURN_S)
    for process in both:
        process.send_signal(signal.SIGCONT)
    return begun


def clicked_ms(panel: Panel) -> dict[str, float]:
    """From a click on Stop in a headless Chromium: until the device has confirmed 0 V, and until the page says so.

    Of a run of its own. Browser and loop read the same clock of the machine; the loop's is monotonic.
    """
    for _ in range(TRIES):
        run = panel.start()
        zero_s = running(panel.out)[-1].runner.zero_s
        command = ["node", str(HERE / "stop.mjs"), panel.origin]
        told = subprocess.run(command, stdout=subprocess.PIPE, text=True, check=False)
        offset_s = time.time() - time.monotonic()
        wait_for(lambda: not running(panel.out))
        events = read_run(run).events
        faults = [event.detail["code"] for event in events if event.kind == "fault"]
        if told.returncode == 0 and faults == ["INTERRUPTED"]:  # else a busy machine ended it before the click
            click = json.loads(told.stdout)
            off_s = next(event.t_s for event in reversed(events) if event.kind == "stop")
            click_s = 1e-3 * click["click_ms"] - offset_s - zero_s
            return {
                "click_to_confirmed_zero_ms": round(1e3 * (off_s - click_s), 1),
                "click_to_shown_ms": round(click["shown_ms"] - click["click_ms"], 1),
            }
    raise RuntimeError("no run lasted until its click on Stop")


def late_us(folder: Path, zero_s: float, begun: list[tuple[float, bool]]) -> dict[str, dict[str, float]]:
    """How late ticks began with a panel that runs and with one that stands still, us."""
    recording = read_run(folder)
    at_s = recording.t_s + zero_s
    found = {}
    for name, ran in (("with", True), ("without", False)):
        rows = np.zeros(len(recording), dtype=bool)
        for begin_s, in_turn in begun:
            if in_turn == ran:
                rows |= (at_s > begin_s + 0.1) & (at_s < begin_s + TURN_S)
        late = recording.late_us[rows & np.isfinite(recording.late_us)]
        p50, p99, most = np.percentile(late, [50, 99, 100]).tolist()
        found[name] = {"ticks": len(late), "p50": round(p50, 1), "p99": round(p99, 1), "max": round(most, 1)}
    return found


def measure(seconds: float, folder: Path) -> dict[str, Any]:
    """All of it, in one run."""
    panel = Panel(folder)
    found: dict[str, Any] = {}
    try:
        run = panel.start()
        zero_s = running(panel.out)[-1].runner.zero_s
        ages_ms: list[float] = []
        for number in PAGES:
            with panel.pages(number) as pages:
                time.sleep(0.5)
                found[f"pages_{number}_of_a_core"] = round(panel.share(0.5 * seconds), 4)
                ages_ms += [age for page in pages for age in page.ages_ms]
        with panel.pages(PAGES[-1]), panel.flood() as flooding:
            time.sleep(0.5)
            found["flooded_of_a_core"] = round(panel.share(0.5 * seconds), 4)
            begun = turns((panel.process, flooding), seconds)
        panel.browser.post("/api/stop")
        wait_for(lambda: not running(panel.out))
        found |= clicked_ms(panel)
    finally:
        panel.close()
    p50, p99 = np.percentile(ages_ms, [50, 99]).tolist()
    return found | {"age_ms": {"p50": p50, "p99": p99}, "late_us": late_us(run, zero_s, begun)}


def table(found: dict[str, Any]) -> str:
    """For people."""
    late, age = found["late_us"], found["age_ms"]
    rows = [(name, one["ticks"], one["p50"], one["p99"], one["max"]) for name, one in late.items()]
    shares = [f"{name} pages: {100 * found[f'pages_{name}_of_a_core']:.1f} %" for name in PAGES]
    return "\n".join(
        [
            f"of a core: {', '.join(shares)}; flooded: {100 * found['flooded_of_a_core']:.1f} %",
            f"the newest row at a page: {age['p50']:g} ms old (median), {age['p99']:g} (p99)",
            f"from a click on Stop to confirmed 0 V: {found['click_to_confirmed_zero_ms']:g} ms; until the "
            f"page says so: {found['click_to_shown_ms']:g} ms",
            "",
            markdown(("five pages and one that floods", "ticks", "late, median", "p99", "most, us"), rows),
        ]
    )


def main() -> int:
    """Measure and print."""
    parser = options("What the panel costs.")
    parser.add_argument("--seconds", type=float, default=12.0, help="of the loop with and without the panel together")
    parser.add_argument("--flood", help="be the client that floods this address")
    arguments = parser.parse_args()
    if arguments.flood is not None:
        flood(arguments.flood)
    with tempfile.TemporaryDirectory() as folder:
        found = measure(arguments.seconds, Path(folder))
    tell(found, as_json=arguments.json, text=table(found))
    return 0


if __name__ == "__main__":
    sys.exit(main())
