"""The panel's pages, its JSON and its WebSocket. Each request passes the gate first: ``access`` says why not."""

from __future__ import annotations

import asyncio
import contextlib
import functools
import json
import secrets
import time
from collections.abc import AsyncIterator, Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Final, TypeVar

from pydantic import JsonValue
from starlette.applications import Starlette
from starlette.requests import ClientDisconnect, Request
from starlette.responses import FileResponse, JSONResponse, RedirectResponse, Response
from starlette.routing import Mount, Route, WebSocketRoute
from starlette.staticfiles import StaticFiles
from starlette.types import ASGIApp, Message, Receive, Scope, Send
from starlette.websockets import WebSocket, WebSocketDisconnect, WebSocketState

from rig.core.package import FOLDER, VERSION
from rig.panel.access import Access, Kind, security_headers
from rig.panel.aside import answer_of
from rig.panel.bench import Bench
from rig.panel.messages import Answer, Refusal, Refused, RefusedError, State, Stop
from rig.panel.past_runs import Runs
from rig.panel.series import compared, drawn
from rig.panel.sockets import LARGEST_MESSAGE, MOST_MESSAGES_S, MOST_SOCKETS, Meter
from rig.panel.watch import Follower, Watch
from rig.run_folder.results import JsonObject

STATIC: Final = FOLDER / "panel" / "static"
UPLOT: Final = STATIC / "vendor" / "uPlot.esm.js"

_MOST_COMPARED: Final = 6  # as many colours as the page has
_MOST_WAITING: Final = 8  # requests for what a process reads or compares: each takes seconds of it
_STOP_WAITS_S: Final = 0.25  # for the rest of its request
_POLICY: Final = 1008  # WebSocket close codes
_TOO_MANY: Final = 1013
_Read = TypeVar("_Read")
_KINDS: Final[dict[str, Kind]] = {"GET": "read", "HEAD": "read", "POST": "write"}


@dataclass(frozen=True)
class Panel:
    """The parts of one panel: who may do what, the bench, the past runs, what the pages are told."""

    access: Access
    bench: Bench
    runs: Runs
    watch: Watch

    @classmethod
    def of(cls, access: Access, out: Path, config: Path | None = None, opened: Path | None = None) -> Panel:
        """A panel for the runs below ``out``.

        config  what it may start; None: nothing
        opened  the run that is shown first; None: the one that goes on
        """
        bench, runs = Bench(config, out), Runs(out)
        return cls(access, bench, runs, Watch(bench, runs, opened))


class Gate:
    """Turns away what is not ours to answer, and puts the security headers on each answer."""

    def __init__(self, app: ASGIApp, access: Access) -> None:
        self._app, self._access = app, access

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer, or pass on."""
        if scope["type"] not in ("http", "websocket"):
            await self._app(scope, receive, send)
            return
        is_socket = scope["type"] == "websocket"
        kind: Kind | None = "socket" if is_socket else _KINDS.get(scope["method"])
        if kind is None:
            refusal: RefusedError | None = RefusedError(405, "this method is not for the panel", "use GET or POST")
        else:
            refusal = self._access.refusal(kind, scope["headers"])
        if refusal is None:
            await self._app(scope, receive, send if is_socket else _with_headers(send))
        elif not is_socket:
            await _refused(refusal)(scope, receive, _with_headers(send))
        elif "websocket.http.response" in scope.get("extensions", {}):
            await _as_socket_answer(_refused(refusal), scope, receive, send)
        else:
            await send({"type": "websocket.close", "code": _POLICY, "reason": refusal.what})


def make_app(panel: Panel) -> ASGIApp:
    """The application: everything that the panel serves."""

    @contextlib.asynccontextmanager
    async def lifespan(app: Starlette) -> AsyncIterator[None]:
        tasks = [asyncio.create_task(panel.watch.go()), asyncio.create_task(panel.bench.attend())]
        try:
            yield
        finally:
            for task in tasks:
                task.cancel()
            panel.bench.release()
            for task in tasks:
                with contextlib.suppress(asyncio.CancelledError):
                    await task

    pages = _Pages(panel)
    app = Starlette(
        routes=[
            Route("/", pages.page),
            Route("/api/state", pages.state),
            Route("/api/take", pages.take, methods=["POST"]),
            Route("/api/check", pages.check, methods=["POST"]),
            Route("/api/start", pages.start, methods=["POST"]),
            Route("/api/stop", pages.stop, methods=["POST"]),
            Route("/api/jog/start", pages.start_jog, methods=["POST"]),
            Route("/api/jog/end", pages.end_jog, methods=["POST"]),
            Route("/api/calibration", pages.calibration),
            Route("/api/calibration/begin", pages.begin_calibration, methods=["POST"]),
            Route("/api/calibration/answer", pages.answer_calibration, methods=["POST"]),
            Route("/api/runs", pages.runs),
            Route("/api/runs/{name}", pages.run),
            Route("/api/compare", pages.compare),
            Route("/runs/{name}/report.html", pages.report),
            WebSocketRoute("/ws", _Sockets(panel).serve),
            Mount("/static", StaticFiles(directory=STATIC)),
        ],
        exception_handlers={RefusedError: _answer_refused, 404: _answer_unknown},
        lifespan=lifespan,
    )
    return Gate(app, panel.access)


class _Json(JSONResponse):
    """JSON in ASCII: a file's name may have bytes that are no text."""

    def render(self, content: object) -> bytes:
        return json.dumps(content, allow_nan=False, separators=(",", ":")).encode("ascii")


class _Pages:
    """The answers over HTTP."""

    def __init__(self, panel: Panel) -> None:
        self._panel = panel
        self._one_at_a_time = asyncio.Lock()  # of the processes that check
        self._readers = _Queue()  # who only watches never keeps the operator waiting
        self._list = _Shared(lambda: bytes(_Json({"runs": panel.runs.rows()}).body))

    async def page(self, request: Request) -> Response:
        """The page. A token in its URL becomes a session, and leaves the URL."""
        access = self._panel.access
        session = self._session(request)
        if (token := request.query_params.get("token")) is not None:
            answer: Response = RedirectResponse("/", status_code=303)
            if session is None and (new := access.redeem(token)) is not None:
                answer.headers["set-cookie"] = access.set_cookie(new)
            return answer
        answer = FileResponse(STATIC / "index.html")
        if access.has_password and session is None:
            peer = request.client.host if request.client is not None else ""
            found = access.log_in(request.headers.get("authorization", ""), peer)
            if isinstance(found, RefusedError):
                refused = _refused(found)
                refused.headers["www-authenticate"] = 'Basic realm="rig panel", charset="UTF-8"'
                return refused
            answer.headers["set-cookie"] = access.set_cookie(found)
        return answer

    async def state(self, request: Request) -> Response:
        """What the page shows before anything moves."""
        self._require_reader(request)
        panel, session = self._panel, self._session(request)
        config, scene = panel.bench.config, panel.watch.scene
        shown: State = {
            "version": VERSION, "config": None if config is None else config.name,
            "config_path": None if config is None else str(config), "runs_folder": str(panel.bench.out),
            "run": scene.run,
            "running": [{"run": one.folder.name, "pid": one.runner.pid} for one in panel.bench.running],
            "opening": scene.opening, "operator": panel.access.is_operator(session),
            "has_token": session is not None, "uplot": UPLOT.is_file(),
        }  # fmt: skip
        return _Json(shown)

    async def take(self, request: Request) -> Response:
        """Make this browser the operator's."""
        if not self._panel.access.take(self._session(request)):
            raise _no_session()
        return _Json({"operator": True})

    async def check(self, request: Request) -> Response:
        """What `rig check` says, and the confirmation for a start."""
        self._require_operator(request)
        async with self._one_at_a_time:
            return _Json(await self._panel.bench.check())

    async def start(self, request: Request) -> Response:
        """Start the run that was confirmed."""
        self._require_operator(request)
        asked = await _json_of(request)
        if asked.get("confirmed") is not True:
            raise RefusedError(400, "a start must be confirmed", "look at what will happen, then confirm it")
        return _Json(await asyncio.to_thread(self._panel.bench.start, asked.get("confirmation")))

    async def stop(self, request: Request) -> Response:
        """Stop. It needs no session and asks nothing; a body that is no JSON, or does not come, stops all the same."""
        name = None
        with contextlib.suppress(RefusedError, ClientDisconnect, TimeoutError):
            name = (await asyncio.wait_for(_json_of(request), _STOP_WAITS_S)).get("run")
        return _Json(await _stop(self._panel, name if isinstance(name, str) else None))

    async def start_jog(self, request: Request) -> Response:
        """Open the device for a jog. Nothing moves until a page holds."""
        self._require_operator(request)
        async with self._one_at_a_time:
            return _Json(await self._panel.bench.start_jog())

    async def end_jog(self, request: Request) -> Response:
        """End the jog, as its operator leaves it."""
        self._require_operator(request)
        await asyncio.to_thread(self._panel.bench.end_jog)
        return _Json({"ended": True})

    async def calibration(self, request: Request) -> Response:
        """The calibration: what was said, the open question; null before the first."""
        self._require_reader(request)
        found = self._panel.bench.calibration
        return _Json({"calibration": None if found is None else found.shown()})

    async def begin_calibration(self, request: Request) -> Response:
        """Begin a calibration."""
        self._require_operator(request)
        await asyncio.to_thread(self._panel.bench.calibrate)
        return _Json({"begun": True})

    async def answer_calibration(self, request: Request) -> Response:
        """Answer its question, leave the step out, or end it without writing."""
        self._require_operator(request)
        found = self._panel.bench.calibration
        if found is None:
            raise RefusedError(409, "no calibration goes on", "begin one")
        asked = await _json_of(request)
        await asyncio.to_thread(found.answer, asked.get("question"), _answer(asked))
        return _Json({"answered": True})

    async def runs(self, request: Request) -> Response:
        """The past runs."""
        self._require_reader(request)
        return Response(await self._list.get(), media_type="application/json")

    async def run(self, request: Request) -> Response:
        """One past run, to be drawn."""
        self._require_reader(request)
        runs = self._panel.runs
        async with self._readers.turn():
            folder = await _read(runs.find, request.path_params["name"])
            curves = await answer_of(drawn, folder)
            return _Json({**await _read(runs.row, folder), **curves})

    async def compare(self, request: Request) -> Response:
        """Whether past runs are of one motor: ``?run=NAME&run=NAME``."""
        self._require_reader(request)
        names = list(dict.fromkeys(request.query_params.getlist("run")))
        if not 2 <= len(names) <= _MOST_COMPARED:
            raise RefusedError(400, f"two to {_MOST_COMPARED} runs can be compared here", "rig compare takes more")
        async with self._readers.turn():
            folders = [await _read(self._panel.runs.find, name) for name in names]
            return _Json(await answer_of(compared, *folders))

    async def report(self, request: Request) -> Response:
        """A run's report, in a sandbox."""
        self._require_reader(request)
        page = await _read(self._panel.runs.report, request.path_params["name"])
        answer = Response(page, media_type="text/html")
        for key, value in security_headers(report=True):
            answer.headers[key.decode()] = value.decode()
        return answer

    def _session(self, request: Request) -> str | None:
        return self._panel.access.session_of(request.headers.raw)

    def _require_reader(self, request: Request) -> None:
        if self._panel.access.has_password and self._session(request) is None:
            raise RefusedError(401, "this panel asks for its password", "open its page first")

    def _require_operator(self, request: Request) -> None:
        _require_operator(self._panel.access, self._session(request))


class _Queue:
    """One at a time, and only so many who wait."""

    def __init__(self) -> None:
        self._lock = asyncio.Lock()
        self._waiting = 0

    @contextlib.asynccontextmanager
    async def turn(self) -> AsyncIterator[None]:
        """Wait for one's turn, and have it for the block. Raises RefusedError if too many wait."""
        if self._waiting >= _MOST_WAITING:
            raise RefusedError(429, "too much is being read at the moment", "try again in some seconds")
        self._waiting += 1
        try:
            await self._lock.acquire()
        finally:
            self._waiting -= 1
        try:
            yield
        finally:
            self._lock.release()


class _Shared:
    """What many ask for: those who ask before a reading begins have the same one."""

    def __init__(self, read: Callable[[], bytes]) -> None:
        self._reads = read
        self._lock = asyncio.Lock()
        self._next: asyncio.Task[bytes] | None = None

    async def get(self) -> bytes:
        if self._next is None:
            self._next = asyncio.create_task(self._read())
        return await asyncio.shield(self._next)

    async def _read(self) -> bytes:
        async with self._lock:
            self._next = None
            return await _read(self._reads)


class _Sockets:
    """The WebSockets: each page is told what it lacks, and may stop, take, jog and release."""

    def __init__(self, panel: Panel) -> None:
        self._panel = panel
        self._open = 0

    async def serve(self, socket: WebSocket) -> None:
        """One page, until it goes or asks too much."""
        panel = self._panel
        session = panel.access.session_of(socket.headers.raw)
        if panel.access.has_password and session is None:
            await socket.close(_POLICY, "this panel asks for its password")
            return
        if self._open >= MOST_SOCKETS * (2 if session is not None else 1):  # watchers leave room for who drives
            await socket.close(_TOO_MANY, "too many pages are open")
            return
        self._open += 1
        follower = panel.watch.follow()
        name = secrets.token_hex(8)
        telling: asyncio.Task[None] | None = None
        try:
            await socket.accept()
            telling = asyncio.create_task(self._tell(socket, follower, session))
            await self._listen(socket, follower, _Page(name, session))
        except WebSocketDisconnect:
            pass
        finally:
            panel.bench.release(name)
            panel.watch.leave(follower)
            self._open -= 1
            if telling is not None:
                telling.cancel()
                with contextlib.suppress(asyncio.CancelledError):
                    await telling

    async def _tell(self, socket: WebSocket, follower: Follower, session: str | None) -> None:
        """Send what the page lacks whenever there was a look. A page that reads slowly is told less often."""
        panel = self._panel
        with contextlib.suppress(WebSocketDisconnect, RuntimeError):  # it went meanwhile
            while True:
                await follower.wake.wait()
                follower.wake.clear()
                operator = panel.access.is_operator(session)
                for text in follower.due(panel.watch.scene, operator=operator, now_s=time.monotonic()):
                    await socket.send_text(text)

    async def _listen(self, socket: WebSocket, follower: Follower, page: _Page) -> None:
        meter = Meter(MOST_MESSAGES_S)
        while True:
            message = await socket.receive()
            if message["type"] == "websocket.disconnect":
                return
            try:
                if not meter.take():
                    raise RefusedError(429, f"more than {MOST_MESSAGES_S} messages a second", "")
                await self._obey(socket, follower, page, _parsed(message))
            except RefusedError as error:
                if socket.application_state is WebSocketState.CONNECTED:
                    await socket.close(_POLICY, error.what[:100])
                return

    async def _obey(self, socket: WebSocket, follower: Follower, page: _Page, asked: JsonObject) -> None:
        """Do what a page asks. Raises RefusedError for what no page of ours sends."""
        panel, kind = self._panel, asked.get("type")
        if kind == "stop":
            await socket.send_json(await _stop(panel, None))
        elif kind == "release":
            panel.bench.release(page.name)
        elif kind == "take":
            panel.access.take(page.session)
            follower.wake.set()
        elif kind == "seen" and isinstance(n := asked.get("n"), int) and not isinstance(n, bool):
            follower.seen(n)
        elif kind == "jog":
            share = asked.get("volts_share")
            if isinstance(share, bool) or not isinstance(share, int | float) or not -1.0 <= share <= 1.0:
                raise RefusedError(400, "volts_share is a number from -1 to 1", "")
            try:
                _require_operator(panel.access, page.session)
                panel.bench.jog(page.name, float(share))
            except RefusedError as error:  # the page may be late to know: it is told, and stays
                await socket.send_json(Refused(type="refused", what=error.what, cure=error.cure))
        else:
            raise RefusedError(400, "no message of the panel's page", "")


@dataclass(frozen=True)
class _Page:
    """One socket: a name of its own, and the session of its browser."""

    name: str
    session: str | None


_readers: Final = ThreadPoolExecutor(2, "read")  # for who only watches: he holds up neither a start nor the live view
_stoppers: Final = ThreadPoolExecutor(4, "stop")  # its own: whatever else a disk holds up, a Stop does not wait for it


async def _read(what: Callable[..., _Read], *arguments: object) -> _Read:
    """What a call that reads the disk gives, in a thread of the readers."""
    return await asyncio.get_running_loop().run_in_executor(_readers, what, *arguments)


async def _stop(panel: Panel, run: str | None) -> Stop:
    """Stop; what there is to say at once. The files are written in a thread: no disk may hold up the other pages."""
    answer = await asyncio.get_running_loop().run_in_executor(_stoppers, functools.partial(panel.bench.stop, run))
    return panel.watch.stop_asked(answer)


def _parsed(message: Message) -> JsonObject:
    text = message.get("text")
    if not isinstance(text, str) or len(text) > LARGEST_MESSAGE:
        raise RefusedError(400, "no message of the panel's page", "")
    return _object(text)


async def _json_of(request: Request) -> JsonObject:
    body = b""
    async for chunk in request.stream():
        body += chunk
        if len(body) > LARGEST_MESSAGE:
            raise RefusedError(413, "that is too much for one request", "send less")
    return _object(body.decode("utf-8", errors="replace")) if body else {}


def _object(text: str) -> JsonObject:
    try:
        value: JsonValue = json.loads(text)
    except (ValueError, RecursionError):
        value = None
    if not isinstance(value, dict):
        raise RefusedError(400, "that is no JSON object", "")
    return value


def _answer(asked: JsonObject) -> Answer:
    """One answer of a calibration, and nothing else that a page may have sent."""
    steps, text = asked.get("steps"), asked.get("answer")
    if asked.get("end") is True:
        return {"end": True}
    if asked.get("skip") is True:
        return {"skip": True}
    if isinstance(steps, list) and len(names := [name for name in steps if isinstance(name, str)]) == len(steps):
        return {"steps": names}
    if isinstance(text, str):
        return {"answer": text}
    raise RefusedError(400, "that is no answer", 'send "answer", "steps", "skip" or "end"')


def _require_operator(access: Access, session: str | None) -> None:
    if session is None:
        raise _no_session()
    if not access.is_operator(session):
        raise RefusedError(403, "another page has the bench", "take it first")


def _no_session() -> RefusedError:
    return RefusedError(403, "this browser may only watch and stop", "open the address that `rig panel` printed")


def _refused(error: RefusedError) -> Response:
    return _Json(Refusal(error={"what": error.what, "cure": error.cure}), status_code=error.status)


async def _answer_refused(request: Request, error: Exception) -> Response:
    assert isinstance(error, RefusedError)
    return _refused(error)


async def _answer_unknown(request: Request, error: Exception) -> Response:
    return _refused(RefusedError(404, "the panel has no such page", "open /"))


def _with_headers(send: Send) -> Send:
    """``send`` that adds the security headers which an answer does not have itself."""

    async def sending(message: Message) -> None:
        if message["type"] == "http.response.start":
            there = {key.lower() for key, _ in message["headers"]}
            message["headers"] = [*message["headers"], *(pair for pair in security_headers() if pair[0] not in there)]
        await send(message)

    return sending


async def _as_socket_answer(response: Response, scope: Scope, receive: Receive, send: Send) -> None:
    """Answer a WebSocket's handshake with a refusal over HTTP."""
    await send(
        {"type": "websocket.http.response.start", "status": response.status_code, "headers": response.raw_headers}
    )
    await send({"type": "websocket.http.response.body", "body": bytes(response.body)})
