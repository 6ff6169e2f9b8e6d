"""The panel's pages, JSON and WebSocket, without a network: what each browser may, and what hostile ones get."""

from __future__ import annotations

import asyncio
import json
import os
import shutil
import subprocess
import threading
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path
from typing import Any, get_type_hints
from urllib.parse import quote

import httpx2 as httpx
import pytest
from processes import PATIENCE_S, wait_until
from starlette.testclient import TestClient, WebSocketDenialResponse
from starlette.websockets import WebSocketDisconnect

from rig.panel.access import Access, Address
from rig.panel.app import Panel, make_app
from rig.panel.aside import answer_of
from rig.panel.bench import StopAnswer
from rig.panel.messages import Checked, Compared, Drawn, RefusedError, RunRow, State, Stop
from rig.panel.processes import StartedProcess
from rig.panel.prospect import prospect
from rig.panel.sockets import LARGEST_MESSAGE, MOST_MESSAGES_S
from rig.panel.watch import Follower
from rig.run_folder.live.own_folder import NAME
from rig.run_folder.live.running import Running, Seen
from rig.run_folder.live.stop_flag import Runner, StopFlag, born

HERE = Address("127.0.0.1", 8470)
ORIGIN = {"origin": "http://127.0.0.1:8470"}
HOSTILE = "20260102T000000Z-run-<img src=x onerror=alert(1)>"
CONFIG = "hostile <script>.yaml"


@pytest.fixture(scope="module")
def out(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Run folders as others may have written them."""
    out = tmp_path_factory.mktemp("out") / "runs"
    for name in (HOSTILE, "20260101T000000Z-run-broken", "20260103T000000Z-run-whole", "campaign-1", "..secret"):
        (out / name).mkdir(parents=True)
    (out / HOSTILE / "meta.json").write_text('{"name": "\\u001b[2J</script>", "script": {"name": 7}}')
    (out / HOSTILE / "report.html").write_text("<script>fetch('/api/stop',{method:'POST'})</script>")
    for name in ("meta.json", "samples.csv", "result.json"):
        (out / "20260101T000000Z-run-broken" / name).write_text("{broken")
    (out / "20260103T000000Z-run-whole" / "samples.csv").write_text(
        "t_s,u_V,y_rad,stage\n"
        + "".join(f"{0.01 * k},{1 if k % 20 < 10 else -1},{0.001 * k},relay-1\n" for k in range(9000))
    )
    (out / "..secret" / "report.html").write_text("secret")
    secret = out.parent / "20260104T000000Z-run-elsewhere"
    secret.mkdir()
    (secret / "meta.json").write_text("{}")
    (secret / "report.html").write_text("secret")
    (out / secret.name).symlink_to(secret)
    linked = out / "20260105T000000Z-run-linked"
    linked.mkdir()
    (linked / "samples.csv").symlink_to("/etc/passwd")
    (out / CONFIG).write_text("daq: [not, a, config]\nname: '<b>'\n")
    return out


@pytest.fixture(scope="module")
def panel(out: Path) -> Panel:
    return Panel.of(Access(HERE), out, out / CONFIG)


@pytest.fixture(scope="module")
def watcher(panel: Panel) -> Iterator[TestClient]:
    """A browser without a session."""
    with TestClient(make_app(panel), base_url="http://127.0.0.1:8470", headers=ORIGIN) as client:
        yield client


@pytest.fixture(scope="module")
def operator(panel: Panel, watcher: TestClient) -> TestClient:
    """A browser that has used the token."""
    client = TestClient(watcher.app, base_url="http://127.0.0.1:8470", headers=ORIGIN)
    client.portal = watcher.portal  # one event loop, as in a server
    token = panel.access.token
    answer = client.get(f"/?token={token}", follow_redirects=False)
    assert (answer.status_code, answer.headers["location"]) == (303, "/"), "the token leaves the address bar"
    assert "set-cookie" not in watcher.get(f"/?token={token}", follow_redirects=False).headers
    return client


def error(answer: Any, status: int) -> dict[str, str]:
    assert answer.status_code == status, answer.text
    said: dict[str, str] = answer.json()["error"]
    assert set(said) == {"what", "cure"}
    return said


def test_a_browser_without_a_session_watches_and_stops_and_no_more(watcher: TestClient, operator: TestClient) -> None:
    assert watcher.get("/api/state").json()["operator"] is False
    assert operator.get("/api/state").json()["operator"] is True
    for path in ("/api/check", "/api/start", "/api/jog/start", "/api/take"):
        error(watcher.post(path, json={"confirmed": True}), 403)
    for body in (b"", b"{}", b'{"run": null}', b"no json", b'{"run": ["x"]}', b"\xff\xfe"):
        answer = watcher.post("/api/stop", content=body).json()
        assert (answer["received"], answer["run"], answer["drive_zero"]) == (True, None, None)
    error(operator.post("/api/start", json={"confirmed": False}), 400)
    assert (
        "not confirmed"
        in error(operator.post("/api/start", json={"confirmed": True, "confirmation": None}), 409)["what"]
    )
    said = operator.post("/api/check").json()
    assert said["may_run"] is False
    assert said["confirmation"] is None
    assert all(line["severity"] == "error" for line in said["lines"])


def test_each_answer_has_the_keys_of_its_type(watcher: TestClient, operator: TestClient) -> None:
    """What a process of its own has answered is not validated: this does it."""
    name = "20260103T000000Z-run-whole"
    answers = [
        (watcher.get("/api/state"), State), (operator.post("/api/check"), Checked), (watcher.post("/api/stop"), Stop),
        (watcher.get(f"/api/compare?run={quote(HOSTILE)}&run=20260101T000000Z-run-broken"), Compared),
    ]  # fmt: skip
    for answer, kind in answers:
        assert answer.json().keys() == get_type_hints(kind).keys(), answer.text
    row, *_ = watcher.get("/api/runs").json()["runs"]
    assert row.keys() == get_type_hints(RunRow).keys()
    shown = watcher.get(f"/api/runs/{name}").json()
    assert shown.keys() == get_type_hints(RunRow).keys() | get_type_hints(Drawn).keys()


def test_each_answer_forbids_foreign_code_framing_and_telling(watcher: TestClient) -> None:
    answers = [
        watcher.get("/"), watcher.get("/api/state"), watcher.get("/nowhere"), watcher.get("/static/nowhere.js"),
        watcher.get("/", headers={"host": "evil.example"}), watcher.request("DELETE", "/api/state"),
    ]  # fmt: skip
    assert [answer.status_code for answer in answers] == [200, 200, 404, 404, 421, 405]
    for answer in answers:
        policy = answer.headers["content-security-policy"]
        assert policy.startswith("default-src 'self';")
        assert "unsafe" not in policy
        assert "frame-ancestors 'none'" in policy
        assert answer.headers["x-content-type-options"] == "nosniff"
        assert answer.headers["referrer-policy"] == "no-referrer"
        assert "access-control-allow-origin" not in answer.headers
    error(watcher.post("/api/stop", headers={"origin": "http://evil.example"}), 403)
    error(watcher.request("OPTIONS", "/api/start"), 405)


def test_a_name_never_leads_out_of_the_folder_and_a_report_runs_nothing(watcher: TestClient) -> None:
    rows = watcher.get("/api/runs").json()["runs"]
    assert [row["name"] for row in rows] == ["20260103T000000Z-run-whole", HOSTILE, "20260101T000000Z-run-broken"]
    assert rows[1]["config"].isprintable()
    assert "broken JSON" in rows[2]["notes"][0]
    outside = (
        "..%2f..%2f..%2fetc",
        "%2e%2e",
        "..secret",
        "20260104T000000Z-run-elsewhere",
        "20260105T000000Z-run-linked",
        "campaign-1",
        "%00",
        "a" * 300,
    )
    for name in outside:
        for path in (f"/api/runs/{name}", f"/runs/{name}/report.html"):
            error(watcher.get(path), 404)
    for path in ("/static/../app.py", "/static/%2e%2e/app.py", "/static/..%2fapp.py", "/static//etc/passwd"):
        assert watcher.get(path).status_code == 404
    report = watcher.get(f"/runs/{HOSTILE}/report.html")
    assert report.status_code == 200
    assert report.headers["content-security-policy"].startswith("sandbox; default-src 'none'")
    assert "allow-scripts" not in report.headers["content-security-policy"]


def test_what_others_wrote_into_the_folder_of_runs_hides_none_of_the_rest(tmp_path: Path) -> None:
    def hostile(name: str | bytes, **files: bytes) -> str:
        folder = os.path.join(os.fsencode(tmp_path), os.fsencode(name))  # noqa: PTH118
        os.mkdir(folder)  # noqa: PTH102  # a Path has no bytes
        for file, content in {"meta": b"{}", **files}.items():
            Path(os.fsdecode(folder), f"{file}.json").write_bytes(content)
        return os.fsdecode(name)

    unseen = [hostile(b"20260101T000000Z-run-\xff\xfe"), hostile("20260102T000000Z-new\nline"),
              hostile("20260103T000000Z-\u202ertl"), hostile("20260104T000000Z-\x1b[2J")]  # fmt: skip
    odd = [
        hostile("20260105T000000Z-run-deep", meta=b"[" * 200_000),
        hostile("20260106T000000Z-run-no-text", meta=b'{"name": "\\ud800", "script": {"name": "\\udfff"}}'),
        hostile(
            "20260107T000000Z-run-endless",
            result=b'{"estimates": {"sampled-data": {"values": {"tau_s": 1e999}}}, '
            b'"loop": {"ticks": 1000000000, "period_s": 1e308}}',
        ),
        hostile("20260108T000000Z-run-types", meta=b"[]", result=b'{"estimates": [1], "faults": 3, "loop": "x"}'),
        hostile("20260109T000000Z-run-..\u2215..\u2215etc"),
    ]
    for name, make in (("pipe", os.mkfifo), ("folder", os.mkdir)):
        (tmp_path / f"20260110T000000Z-run-{name}").mkdir()
        make(tmp_path / f"20260110T000000Z-run-{name}" / "meta.json")
        unseen.append(f"20260110T000000Z-run-{name}")
    odd.append(hostile("20260111T000000Z-run-large"))
    with (tmp_path / odd[-1] / "meta.json").open("wb") as file:
        file.truncate(1 << 30)
    app = make_app(Panel.of(Access(HERE), tmp_path, opened=tmp_path / os.fsdecode(unseen[0])))
    with TestClient(app, base_url="http://127.0.0.1:8470", headers=ORIGIN) as client:
        rows = client.get("/api/runs").json()["runs"]
        assert [row["name"] for row in rows] == odd[::-1]
        assert "larger than" in rows[0]["notes"][0]
        for name in (*unseen, "20260112T000000Z-" + "\u0416" * 180):
            error(client.get(f"/api/runs/{quote(os.fsencode(name))}"), 404)
        wait_until(lambda: client.get("/api/state").json()["run"] == unseen[0])


def test_a_run_folder_that_vanishes_is_over_and_the_pages_hear_on(tmp_path: Path) -> None:
    name = "20260101T000000Z-run-there"
    (tmp_path / name).mkdir()
    for file in ("meta.json", "samples.csv", "events.jsonl"):
        (tmp_path / name / file).write_text("{}\n")
    watch = Panel.of(Access(HERE), tmp_path, opened=tmp_path / name).watch
    watch.look()
    shutil.rmtree(tmp_path / name)
    for _ in range(8):
        watch.look()
    told = [json.loads(one) for one in Follower(0).due(watch.scene, operator=False, now_s=1.0)]
    assert [one["why"] for one in told if one["type"] == "ended"] == ["the process died, and left no end"]


def test_a_stop_reaches_the_run_that_is_known_before_it_looks_for_others(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A look at a disk that hangs takes long; and a run that has ended since the last look is no fault."""
    bench = Panel.of(Access(HERE), tmp_path).bench
    (folder := tmp_path / "20260101T000000Z-run-goes").mkdir()
    asked: list[str] = []

    with StopFlag() as flag:
        flag.begin(folder)
        bench.look()

        def looked(parent: Path) -> list[Running]:
            asked.append(flag.asked_by())
            return []

        monkeypatch.setattr("rig.panel.bench.running", looked)
        assert bench.stop() == StopAnswer((folder,), (), "")
        assert asked == ["panel"]
        bench._running = [Running(folder, Runner(os.getpid(), 0.0, 0.01))]
        monkeypatch.setattr(Seen, "goes_on", lambda seen, one: False)
    assert bench.stop() == StopAnswer((), (), ""), "it ended since the last look: nothing has failed"


def test_a_run_is_drawn_with_few_points_and_a_broken_one_says_why(watcher: TestClient) -> None:
    drawn = watcher.get("/api/runs/20260103T000000Z-run-whole").json()
    series = drawn["series"]
    assert 3000 < len(series["t_s"]) == len(series["y_rad"]) == len(series["u_V"]) <= 4000
    assert series["y_rad"][-1] == pytest.approx(8.999)
    assert drawn["first_switch_s"] == pytest.approx(0.1)
    assert drawn["rows"] == 9000
    assert "samples.csv" in error(watcher.get("/api/runs/20260101T000000Z-run-broken"), 409)["what"]


def test_runs_are_compared_by_name(watcher: TestClient) -> None:
    name = "20260103T000000Z-run-whole"
    assert "two to 6" in error(watcher.get(f"/api/compare?run={name}&run={name}"), 400)["what"]
    error(watcher.get(f"/api/compare?run={name}&run=..secret"), 404)


def test_what_is_done_aside_is_ended_by_what_it_computes_not_by_how_busy_the_machine_is(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "asked.py").write_text(
        "import os, resource, signal\n"
        "def limit(path): return [*resource.getrlimit(resource.RLIMIT_CPU), os.nice(0)]\n"
        "def endless(path): os.kill(os.getpid(), signal.SIGXCPU)\n"
    )
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    monkeypatch.syspath_prepend(tmp_path)
    asked = import_module("asked")
    assert asyncio.run(answer_of(asked.limit, tmp_path)) == [60, 60, os.nice(0) + 10]
    with pytest.raises(RefusedError, match="computes for 60 s"):
        asyncio.run(answer_of(asked.endless, tmp_path))


def test_whoever_reads_much_keeps_neither_a_check_nor_a_stop_waiting(
    out: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Readers whose process does not answer, and reads of a disk that hangs, on every thread that they may take."""
    disk, read = threading.Event(), asyncio.Event()
    panel = Panel.of(Access(HERE), out, out / CONFIG)
    session = panel.access.redeem(panel.access.token or "") or ""
    headers = ORIGIN | {"cookie": panel.access.set_cookie(session).partition(";")[0]}

    async def answer_of(asked: object, *paths: Path) -> dict[str, Any]:
        if asked is not prospect:
            await read.wait()
        return {"lines": [], "may_run": False, "plan": None}

    def hanging() -> list[dict[str, Any]]:
        disk.wait()
        return []

    async def all_at_once() -> None:
        transport = httpx.ASGITransport(make_app(panel))
        async with httpx.AsyncClient(transport=transport, base_url="http://127.0.0.1:8470", headers=headers) as client:
            path = "/api/runs/20260103T000000Z-run-whole"
            readers = [asyncio.create_task(client.get(path)) for _ in range(30)]
            refused: set[asyncio.Task[httpx.Response]] = set()
            while len(refused) < 30 - 1 - 8:  # one is read, eight wait
                refused, _ = await asyncio.wait(readers, timeout=0.01)
            assert {one.result().status_code for one in refused} == {429}
            disks = [asyncio.create_task(client.get("/api/runs")) for _ in range(64)]
            await asyncio.sleep(0)
            assert (await client.post("/api/stop")).json()["received"]
            disk.set()
            assert (await client.post("/api/check")).status_code == 200
            read.set()
            assert {one.status_code for one in await asyncio.gather(*readers, *disks)} == {200, 429}

    async def within_patience() -> None:
        try:
            await asyncio.wait_for(all_at_once(), PATIENCE_S)
        finally:
            disk.set()

    monkeypatch.setattr("rig.panel.app.answer_of", answer_of)
    monkeypatch.setattr("rig.panel.bench.answer_of", answer_of)
    monkeypatch.setattr(panel.runs, "rows", hanging)
    asyncio.run(within_patience())


@pytest.mark.parametrize("goes", [False, True], ids=["stalls", "goes"])
def test_a_stop_whose_request_never_ends_stops(out: Path, monkeypatch: pytest.MonkeyPatch, goes: bool) -> None:
    panel = Panel.of(Access(HERE), out)
    stopped: list[str | None] = []

    def stop(run: str | None) -> StopAnswer:
        stopped.append(run)
        return StopAnswer((), (), "")

    monkeypatch.setattr(panel.bench, "stop", stop)
    headers = [(b"host", b"127.0.0.1:8470"), (b"origin", ORIGIN["origin"].encode()), (b"content-length", b"40")]
    scope = {"type": "http", "method": "POST", "path": "/api/stop", "query_string": b"", "headers": headers}
    messages = [{"type": "http.request", "body": b'{"run": "2026', "more_body": True}]
    if goes:
        messages.append({"type": "http.disconnect"})

    async def receive() -> Any:
        return messages.pop(0) if messages else await asyncio.Event().wait()

    async def send(message: Any) -> None:
        pass

    async def ask() -> None:
        await make_app(panel)(scope, receive, send)

    asyncio.run(ask())
    assert stopped == [None]


def test_what_is_too_large_is_refused(operator: TestClient) -> None:
    error(operator.post("/api/start", content=b" " * (LARGEST_MESSAGE + 1)), 413)
    error(operator.post("/api/start", content=b"[" * LARGEST_MESSAGE), 400)
    assert operator.post("/api/stop", content=b"x" * 100_000).json()["received"], "Stop never fails for its body"


@pytest.mark.parametrize("headers", [{"origin": "http://evil.example"}, {"origin": "null"}, {"origin": ""}])
def test_a_socket_of_another_site_is_not_opened(watcher: TestClient, headers: dict[str, str]) -> None:
    with (
        pytest.raises(WebSocketDenialResponse) as denied,
        watcher.websocket_connect("ws://127.0.0.1:8470/ws", headers=headers),
    ):
        pass
    assert denied.value.status_code == 403
    host = {"host": "evil.example", "origin": "http://evil.example"}
    with (
        pytest.raises(WebSocketDenialResponse) as rebound,
        watcher.websocket_connect("ws://127.0.0.1:8470/ws", headers=host),
    ):
        pass
    assert rebound.value.status_code == 421


def closed(socket: Any) -> tuple[int, str]:
    """Code and reason with which the server closes."""
    with pytest.raises(WebSocketDisconnect) as end:
        while True:
            socket.receive_json()
    return end.value.code, end.value.reason


@pytest.mark.parametrize(
    "message",
    ["no json", "[]", '{"type": "start"}', '{"type": "jog"}', '{"type": "jog", "volts_share": 2}', "[" * 4000,
     '{"type": "jog", "volts_share": NaN}', '{"type": "jog", "volts_share": true}', '{"type": "seen", "n": "1"}',
     '{"type": "stop", "long": "' + "x" * LARGEST_MESSAGE + '"}'],
)  # fmt: skip
def test_a_socket_that_speaks_nonsense_is_closed_with_the_reason(operator: TestClient, message: str) -> None:
    with operator.websocket_connect("ws://127.0.0.1:8470/ws") as socket:
        socket.send_text(message)
        code, reason = closed(socket)
    assert code == 1008
    assert reason


def test_a_flood_is_closed_and_bytes_are_no_message(watcher: TestClient) -> None:
    with watcher.websocket_connect("ws://127.0.0.1:8470/ws") as socket:
        socket.send_bytes(b"\0\1")
        assert closed(socket)[0] == 1008
    with watcher.websocket_connect("ws://127.0.0.1:8470/ws") as socket:
        for _ in range(1000):
            socket.send_text('{"type": "seen", "n": 1}')
        assert closed(socket) == (1008, f"more than {MOST_MESSAGES_S} messages a second")


def test_each_page_knows_who_drives_and_only_that_one_jogs(watcher: TestClient, operator: TestClient) -> None:
    def until(socket: Any, kind: str) -> dict[str, Any]:
        while (message := socket.receive_json())["type"] != kind:
            assert message["type"] == "idle", message
        return dict(message)

    with (
        watcher.websocket_connect("ws://127.0.0.1:8470/ws") as one,
        operator.websocket_connect("ws://127.0.0.1:8470/ws") as other,
    ):
        assert until(one, "operator")["you"] is False
        assert until(other, "operator")["you"] is True
        assert until(one, "idle")["opening"] is None
        one.send_json({"type": "take"})
        for socket, what in ((one, "this browser may only watch and stop"), (other, "no jog goes on")):
            socket.send_json({"type": "jog", "volts_share": 0.5, "lease": 1})
            assert until(socket, "refused")["what"] == what
            socket.send_json({"type": "release"})
        one.send_json({"type": "stop"})
        assert until(one, "stop")["received"] is True


def test_a_page_is_told_what_a_start_says_that_takes_long(tmp_path: Path) -> None:
    """As the first one after an installation, which builds the firmware of what is emulated."""
    folder = tmp_path / NAME
    folder.mkdir()
    note = {"command": "run", "pid": os.getpid(), "born": born(os.getpid())}
    (folder / f"{'1' * 16}.json").write_text(json.dumps(note))
    (folder / f"{'1' * 16}.stderr").write_text("rig: before\nrig: building the Uno's firmware\n")
    watch = Panel.of(Access(Address("127.0.0.1", 8470)), tmp_path).watch
    watch.look()
    (told,) = map(json.loads, Follower(0, _operator=True).due(watch.scene, operator=True, now_s=1.0))
    assert told == {"type": "idle", "opening": "run", "words": "rig: building the Uno's firmware"}


@pytest.mark.parametrize("began", [False, True])
def test_only_a_command_without_a_run_folder_did_not_start(tmp_path: Path, began: bool) -> None:
    """A run that was stopped may take long to exit: nobody may read then that the next one did not start."""
    panel = Panel.of(Access(Address("127.0.0.1", 8470)), tmp_path)
    child = subprocess.Popen(["false"])
    child.wait()
    started = StartedProcess(tmp_path, "one.json", "run", child.pid, "", child)
    started.has_folder = began
    panel.bench._started.append(started)
    panel.watch.look()
    told = [news for _, news in panel.watch.scene.news]
    assert [one["why"] for one in told if one["type"] == "ended"] == ([] if began else ["rig run did not start"])
    assert all(one["type"] == "ended" for one in told)


def test_with_a_password_nothing_is_told_without_it_but_stop_works(out: Path) -> None:
    access = Access(Address("192.168.1.5", 8470, secure=True), "correct horse battery")
    base = "https://192.168.1.5:8470"
    with TestClient(make_app(Panel.of(access, out)), base_url=base, headers={"origin": base}) as client:
        assert client.get("/").headers["www-authenticate"].startswith("Basic")
        error(client.get("/?token=None"), 401)
        for path in ("/api/state", "/api/runs", f"/api/runs/{HOSTILE}", f"/runs/{HOSTILE}/report.html"):
            error(client.get(path), 401)
        with pytest.raises(WebSocketDisconnect), client.websocket_connect("wss://192.168.1.5:8470/ws"):
            pass
        assert client.post("/api/stop").json()["received"]
        assert client.get("/", auth=("me", "correct horse battery")).status_code == 200
        assert json.loads(client.get("/api/state").text)["operator"] is True
