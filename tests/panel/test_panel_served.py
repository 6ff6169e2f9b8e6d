"""`rig panel` as a process, on an emulated bench in real time: start, watch, die, come back, stop, jog, be flooded."""

from __future__ import annotations

import json
import os
import queue
import re
import resource
import signal
import socket
import ssl
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, suppress
from pathlib import Path
from typing import Any

import httpx2 as httpx
import pytest
from processes import PATIENCE_S, alive, plain_runs, wait_until
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import ClientConnection, connect
from websockets.typing import Origin

from rig.panel.sockets import MOST_CONNECTIONS
from rig.run_folder.live.running import running
from rig.run_folder.live.stop_flag import is_recorded

pytestmark = [pytest.mark.realtime, pytest.mark.long]

CONFIGS = Path(__file__).resolve().parents[2] / "config"
DEMO, UNO = CONFIGS / "demo.yaml", CONFIGS / "uno.yaml"
PANEL = (sys.executable, "-m", "rig", "panel")
LOCALHOST = Path(__file__).with_name("localhost.pem")  # key and certificate, for tests alone


class Served:
    """A `rig panel` process, and a browser that has used its token."""

    def __init__(self, folder: Path) -> None:
        command = [*PANEL, str(folder / "bench.yaml"), "--out", str(folder / "runs")]
        self.process = subprocess.Popen(
            [*command, "--port", "0"],
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            start_new_session=True,
            env=plain_runs(folder, "rig run", "rig jog", "rig.panel.calibrating"),
        )
        assert self.process.stdout is not None
        found = re.search(r"(http://127\.0\.0\.1:(\d+))/\?token=(\S+)", self.process.stdout.readline())
        assert found is not None
        self.origin, self.port = found[1], int(found[2])
        self.socket_url = f"ws://127.0.0.1:{self.port}/ws"
        wait_until(self._answers)
        self.browser = httpx.Client(base_url=self.origin, headers={"origin": self.origin}, timeout=PATIENCE_S)
        self.browser.get("/", params={"token": found[3]})
        self._stack = ExitStack()

    def _answers(self) -> bool:
        with socket.socket() as probe:
            return probe.connect_ex(("127.0.0.1", self.port)) == 0

    def post(self, path: str, **body: object) -> dict[str, Any]:
        answer = self.browser.post(path, json=body)
        assert answer.status_code == 200, answer.text
        return dict(answer.json())

    def page(self, *, session: bool = True) -> Page:
        cookie = "; ".join(f"{key}={value}" for key, value in self.browser.cookies.items()) if session else ""
        opened = connect(
            self.socket_url, origin=Origin(self.origin), additional_headers={"cookie": cookie}, close_timeout=0.1
        )
        return Page(self._stack.enter_context(opened))

    def end(self, number: int = signal.SIGKILL) -> None:
        self.process.send_signal(signal.SIGCONT)
        self.process.send_signal(number)
        self.process.wait(PATIENCE_S)
        self._stack.close()
        self.browser.close()
        assert self.process.stdout is not None
        self.process.stdout.close()


class Page:
    """A WebSocket of the panel. It reads all the time, as a browser does."""

    def __init__(self, opened: ClientConnection) -> None:
        self.socket = opened
        self.heard: list[dict[str, Any]] = []  # all that was read
        self._heard: queue.SimpleQueue[dict[str, Any]] = queue.SimpleQueue()
        threading.Thread(target=self._hear, daemon=True).start()

    def _hear(self) -> None:
        with suppress(ConnectionClosed, OSError):
            for text in self.socket:
                self._heard.put(json.loads(text))
        self._heard.put({"type": "closed"})

    def until(self, kind: str, true: Callable[[dict[str, Any]], bool] = lambda message: True) -> dict[str, Any]:
        """The next message of this kind for which it is true."""
        until_s = time.monotonic() + PATIENCE_S
        while time.monotonic() < until_s:
            message = self._heard.get(timeout=PATIENCE_S)
            self.heard.append(message)
            if message["type"] == kind and true(message):
                return message
            assert message["type"] != "closed", "the panel closed the socket"
        raise AssertionError(f"no {kind}")

    def say(self, kind: str, **what: object) -> None:
        self.socket.send(json.dumps({"type": kind, **what}))


@pytest.fixture(scope="module")
def bench(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("panel")
    (folder / "bench.yaml").write_bytes(DEMO.read_bytes())
    return folder


@pytest.fixture(scope="module")
def served(bench: Path) -> Iterator[list[Served]]:
    """The panel; a test that ends it puts another one there."""
    panels = [Served(bench)]
    yield panels
    panels[-1].end()


@pytest.fixture(scope="module")
def silent(served: list[Served]) -> Iterator[socket.socket]:
    """A WebSocket that is open, and answers nothing any more."""
    panel = served[-1]
    lines = (
        "GET /ws HTTP/1.1", f"Host: 127.0.0.1:{panel.port}", f"Origin: {panel.origin}", "Upgrade: websocket",
        "Connection: Upgrade", "Sec-WebSocket-Version: 13", "Sec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==", "", "",
    )  # fmt: skip
    with socket.create_connection(("127.0.0.1", panel.port), timeout=PATIENCE_S) as opened:
        opened.sendall("\r\n".join(lines).encode())
        assert b" 101 " in opened.recv(65536)
        yield opened


def start(panel: Served) -> None:
    checked = panel.post("/api/check")
    assert checked["may_run"]
    assert checked["plan"]["largest_drive_V"] == 3.0
    started = panel.post("/api/start", confirmed=True, confirmation=checked["confirmation"])
    assert alive(started["pid"])
    again = panel.browser.post("/api/start", json={"confirmed": True, "confirmation": checked["confirmation"]})
    assert again.status_code == 409, "each confirmation starts once"


def test_a_run_outlives_the_panel_and_a_new_one_finds_and_stops_it(served: list[Served], bench: Path) -> None:
    panel = served[-1]
    page = panel.page()
    start(panel)
    seen = page.until("live", lambda live: len(live["rows"]["t_s"]) > 0 and live["stage"] == "breakaway")
    assert seen["limits"] == {"soft_rad": [-1.1, 1.1], "hard_rad": [-1.95, 1.95], "drive_V": 3.0}
    refused = panel.browser.post("/api/jog/start")
    assert (refused.status_code, seen["run"] in refused.text) == (409, True), "one at a time"
    panel.end(signal.SIGKILL)
    assert alive(seen["pid"])

    served.append(Served(bench))
    panel = served[-1]
    page = panel.page(session=False)
    live = page.until("live", lambda live: live["run"] == seen["run"])
    assert len(live["rows"]["t_s"]) > 20, "all that is known at once"
    assert panel.browser.get("/api/state").json()["running"] == [{"run": seen["run"], "pid": seen["pid"]}]
    said = httpx.post(
        f"{panel.origin}/api/stop", headers={"origin": panel.origin}
    ).json()  # a browser without a session
    assert (said["received"], said["run"]) == (True, seen["run"])
    ended = page.until("ended")
    assert [one["code"] for one in page.heard if one["type"] == "fault"] == ["INTERRUPTED"]
    assert [one["drive_zero"] for one in page.heard if one["type"] == "stop"] == [True]
    assert (ended["run"], ended["why"], ended["exit"]) == (seen["run"], "INTERRUPTED", None)
    [row] = panel.browser.get("/api/runs").json()["runs"]
    assert (row["name"], row["fault"], row["report"]) == (seen["run"], "INTERRUPTED", True)
    assert page.until("idle")["opening"] is None


def test_a_start_that_fails_says_its_last_words(served: list[Served], bench: Path) -> None:
    panel = served[-1]
    page = panel.page()
    config = bench / "bench.yaml"
    good = config.read_bytes()
    try:
        config.write_bytes(good.replace(b"max_V: 3.0", b"max_V: 3.0\n  max_volts: 3.0"))
        checked = panel.post("/api/check")
        assert (checked["may_run"], checked["confirmation"]) == (False, None)
        assert "max_volts" in checked["lines"][0]["text"]
        config.write_bytes(UNO.read_bytes().replace(b"/dev/ttyACM0", b"/dev/nowhere"))
        checked = panel.post("/api/check")
        config.write_bytes(config.read_bytes() + b"\n")
        body = {"confirmed": True, "confirmation": checked["confirmation"]}
        assert "has changed" in panel.browser.post("/api/start", json=body).text
        body["confirmation"] = panel.post("/api/check")["confirmation"]
        panel.post("/api/start", **body)
        ended = page.until("ended", lambda message: message["run"] is None)
        assert ended["exit"] == 1
        assert "/dev/nowhere" in ended["words"]
    finally:
        config.write_bytes(good)


@pytest.mark.usefixtures("silent")  # opened here, so that the next test need not wait for the ping
def test_a_jog_ends_with_its_lease_however_the_page_goes(served: list[Served], bench: Path) -> None:
    panel = served[-1]
    page, watcher = panel.page(), panel.page(session=False)
    panel.post("/api/jog/start")
    run = watcher.until("live", lambda live: live["command"] == "jog" and live["rows"]["t_s"])["run"]

    def drives(live: dict[str, Any]) -> bool:
        return live["run"] == run and any(live["rows"]["u_V"])

    def rests(live: dict[str, Any]) -> bool:
        return live["run"] == run and len(live["rows"]["u_V"]) > 0 and not any(live["rows"]["u_V"])

    def hold(one: Page, times: int = 6) -> None:
        for number in range(times):
            one.say("jog", volts_share=0.5, lease=number)
            time.sleep(0.05)

    hold(page)
    assert watcher.until("live", drives)
    page.say("release")
    assert watcher.until("live", rests)

    hold(page)
    page.socket.socket.close()  # the tab is gone
    assert watcher.until("live", drives)
    assert watcher.until("live", rests)

    page = panel.page()
    hold(page)
    assert watcher.until("live", drives)
    panel.process.send_signal(signal.SIGSTOP)  # the panel freezes, and what the page says piles up
    hold(page)
    [going] = running(bench / "runs")
    wait_until(lambda: _last_drive(going.folder) == 0.0)
    panel.process.send_signal(signal.SIGCONT)
    assert page.until("refused")["what"] == "the hold was interrupted"
    assert watcher.until("live", rests)
    page.say("release")
    hold(page)
    assert watcher.until("live", drives)
    page.say("release")
    assert panel.post("/api/jog/end") == {"ended": True}
    ended = watcher.until("ended", lambda ended: ended["run"] == run)
    assert (ended["why"], ended["exit"]) == ("", 0)


def _last_drive(folder: Path) -> float:
    """u_V of the last whole row."""
    header, *rows = (folder / "samples.csv").read_text().rsplit("\n", 1)[0].splitlines()
    return float(rows[-1].split(",")[header.split(",").index("u_V")])


def test_a_calibrations_strokes_end_when_the_panel_freezes_and_it_says_so_afterwards(
    served: list[Served], bench: Path
) -> None:
    """The pin is looked at in tests/hil/test_hil_stop.py; here the promises come from the panel's own event loop."""
    panel = served[-1]

    def shown() -> dict[str, Any]:
        return dict(panel.browser.get("/api/calibration").json()["calibration"])

    def answer(words: str, **given: object) -> None:
        wait_until(lambda: shown()["question"] is not None)
        question = shown()["question"]
        assert words in question["words"].lower(), shown()
        panel.post("/api/calibration/answer", question=question["number"], **given)

    def drives() -> bool:
        for one in filter(lambda one: is_recorded(one.folder), running(bench / "runs")):
            with suppress(OSError, IndexError):  # it has no row yet
                return _last_drive(one.folder) != 0.0
        return False

    panel.post("/api/calibration/begin")
    answer("which steps", steps=["strokes"])
    for _ in range(5):
        answer("may the motor move", answer="yes")
        wait_until(lambda: drives() or shown()["question"] is not None)
        if shown()["question"] is None:
            break
        answer("and then", answer="again")  # on a busy machine the panel was late, too
    panel.process.send_signal(signal.SIGSTOP)
    wait_until(lambda: not [one for one in running(bench / "runs") if is_recorded(one.folder)])
    panel.process.send_signal(signal.SIGCONT)
    wait_until(lambda: shown()["question"] is not None)
    assert shown()["said"][-1]["words"] == "the panel fell silent: the drive is at 0 V"
    answer("and then", end=True)
    wait_until(lambda: shown()["end"] is not None)
    wait_until(lambda: not list((bench / "runs" / ".panel").glob("*.lease")))


def test_a_flood_and_half_open_sockets_leave_the_others_alone(served: list[Served], silent: socket.socket) -> None:
    panel = served[-1]
    for origin in ("http://evil.example", f"http://localhost:{panel.port + 1}", "null"):
        with pytest.raises(InvalidStatus) as denied, connect(panel.socket_url, origin=Origin(origin)):
            pass
        assert denied.value.response.status_code == 403

    watcher, flood, large = panel.page(), panel.page(), panel.page()
    with suppress(ConnectionClosed):
        for _ in range(10_000):
            flood.say("seen", n=1)
    with suppress(ConnectionClosed):
        large.socket.send("x" * 1_000_000)
    assert flood.until("closed")
    assert large.until("closed")
    for _ in range(3):
        watcher.until("idle")
    assert panel.post("/api/stop")["received"]
    while silent.recv(65536):  # it answers no ping: the panel lets go of it
        pass


def test_connections_that_say_nothing_keep_no_stop_out_and_the_longest_silent_one_is_let_go(
    served: list[Served],
) -> None:
    panel = served[-1]
    half = f"GET / HTTP/1.1\r\nHost: 127.0.0.1:{panel.port}\r\n".encode()
    with ExitStack() as stack:
        opened = []
        for number in range(MOST_CONNECTIONS + 40):
            one = stack.enter_context(socket.create_connection(("127.0.0.1", panel.port), timeout=PATIENCE_S))
            if number % 2:
                one.sendall(half)
            opened.append(one)
            if number % 40 == 39:
                assert panel.post("/api/stop")["received"]
        for one in opened[:20]:
            with suppress(ConnectionResetError):
                assert one.recv(1) == b""
        opened[-1].sendall(half + b"\r\n" if len(opened) % 2 else b"\r\n")
        assert opened[-1].recv(12) == b"HTTP/1.1 200"


def test_handshakes_that_never_end_keep_no_stop_out_and_take_up_no_files(tmp_path: Path) -> None:
    """With as many of them as the panel may open files."""
    few = 256
    files = resource.getrlimit(resource.RLIMIT_NOFILE)

    def with_few_files() -> None:
        resource.setrlimit(resource.RLIMIT_NOFILE, (few, few))

    secret = tmp_path / "password"
    secret.write_text("correct horse battery\n")
    secret.chmod(0o600)
    tls = ssl.create_default_context(cafile=LOCALHOST)
    with ExitStack() as stack:
        panel = stack.enter_context(
            subprocess.Popen(
                [
                    *PANEL,
                    "--out",
                    str(tmp_path),
                    "--port",
                    "0",
                    "--tls-cert",
                    str(LOCALHOST),
                    "--tls-key",
                    str(LOCALHOST),
                    "--password-file",
                    str(secret),
                ],
                stdout=subprocess.PIPE,
                stderr=subprocess.PIPE,
                text=True,
                preexec_fn=with_few_files,
            )
        )
        stack.callback(panel.kill)
        assert panel.stdout is not None and panel.stderr is not None
        found = re.search(r"https://127\.0\.0\.1:(\d+)", panel.stdout.readline())
        assert found is not None
        port = int(found[1])

        def connection() -> socket.socket:
            return stack.enter_context(socket.create_connection(("127.0.0.1", port), timeout=PATIENCE_S))

        def stop() -> bytes:
            request = f"POST /api/stop HTTP/1.1\r\nHost: 127.0.0.1:{port}\r\nOrigin: {found[0]}\r\n\r\n"
            with tls.wrap_socket(connection(), server_hostname="127.0.0.1") as asked:
                asked.sendall(request.encode())
                return asked.recv(12)

        resource.setrlimit(resource.RLIMIT_NOFILE, (max(files[0], min(files[1], 4096)), files[1]))
        stack.callback(resource.setrlimit, resource.RLIMIT_NOFILE, files)
        connection()  # the process listens before it serves: wait for it
        assert stop() == b"HTTP/1.1 200"
        silent = [connection() for _ in range(2 * few)]
        assert stop() == b"HTTP/1.1 200"
        assert silent[0].recv(1) == b"", "the oldest is let go"
        assert len(list(Path(f"/proc/{panel.pid}/fd").iterdir())) < few
        silent[-1].settimeout(0.1)
        with pytest.raises(TimeoutError):
            silent[-1].recv(1)
        panel.send_signal(signal.SIGINT)
        assert panel.wait(PATIENCE_S) == 0
        assert panel.stderr.read() == ""


@pytest.fixture
def untiring(bench: Path) -> Iterator[None]:
    """The panel's config is of a run in virtual time that goes on until it is stopped: no busy machine ends it."""
    config = bench / "bench.yaml"
    good = config.read_bytes()
    config.write_bytes(
        (CONFIGS / "quick.yaml")
        .read_bytes()
        .replace(b"interval_percent: 0.4", b"interval_percent: 0.1, longest_s: 3600, most_cycles: 10000")
    )
    yield
    config.write_bytes(good)


def started(panel: Served, page: Page) -> dict[str, Any]:
    """A run that has rows: its first live message with some."""
    before = panel.browser.get("/api/state").json()["run"]
    panel.post("/api/start", confirmed=True, confirmation=panel.post("/api/check")["confirmation"])
    return page.until("live", lambda live: live["run"] != before and live["rows"]["t_s"])


@pytest.mark.usefixtures("untiring")
def test_a_run_whose_stop_flag_is_gone_goes_on_in_the_page_and_is_stopped(served: list[Served], bench: Path) -> None:
    panel = served[-1]
    page = panel.page()
    seen = started(panel, page)
    run, flag = seen["run"], bench / "runs" / seen["run"] / "stop.flag"
    flag.unlink()
    flag.symlink_to("/dev/zero")
    assert page.until("trouble")["code"] == "Stop flag gone"
    for _ in range(3):
        assert page.until("live", lambda live: live["rows"]["t_s"])["run"] == run, "it goes on"
    confirmed = {"confirmed": True, "confirmation": panel.post("/api/check")["confirmation"]}
    again = panel.browser.post("/api/start", json=confirmed)
    assert (again.status_code, run in again.text) == (409, True), "it is known to go on"
    said = panel.post("/api/stop")
    assert (said["received"], said["run"], said["drive_zero"]) == (True, run, None)
    assert page.until("stop", lambda stop: stop["drive_zero"] is True)["run"] == run
    ended = page.until("ended")
    assert (ended["run"], ended["why"]) == (run, "INTERRUPTED")
    wait_until(lambda: not alive(seen["pid"]))


@pytest.mark.usefixtures("untiring")
def test_stop_of_a_loop_that_hangs_says_that_nothing_is_confirmed(served: list[Served]) -> None:
    """A device has a watchdog of its own, but nobody here can know what it has done."""
    panel = served[-1]
    page = panel.page()
    seen = started(panel, page)
    # in the pause before, the device has confirmed 0 V
    page.until(
        "live",
        lambda live: (
            live["run"] == seen["run"] and live["stage"] not in ("rest", "breakaway") and not live["drive_is_off"]
        ),
    )
    os.kill(seen["pid"], signal.SIGSTOP)
    try:
        assert panel.post("/api/stop")["drive_zero"] is None
        said = page.until("stop", lambda stop: stop["drive_zero"] is not None)
        assert (said["drive_zero"], said["why"]) == (False, "the device has not confirmed 0 V")
        assert panel.post("/api/stop")["run"] == seen["run"], "pressed again"
    finally:
        os.kill(seen["pid"], signal.SIGCONT)
    assert page.until("ended")["why"] == "INTERRUPTED"
    wait_until(lambda: not alive(seen["pid"]))


def test_ctrl_c_ends_the_panel_and_says_nothing_wrong(served: list[Served]) -> None:
    panel = served[-1]
    for _ in range(2):  # an impatient hand: of the second one uvicorn wrote a traceback
        os.kill(panel.process.pid, signal.SIGINT)
        time.sleep(0.02)
    assert panel.process.stdout is not None
    said = panel.process.stdout.read()
    assert panel.process.wait(PATIENCE_S) == 0
    assert "Traceback" not in said
    assert "Error" not in said
