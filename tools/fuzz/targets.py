"""What is fed to what. A target takes any bytes and returns; what it lets through is a defect.

Each swallows only the errors that its room declares, and asserts what must hold of every outcome.
"""

from __future__ import annotations

import itertools
import json
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
from pymodbus.framer import FramerRTU

from fuzz import servos, structured
from rig import config
from rig.backends.driver import Driver, Timeouts
from rig.backends.modbus.opening import modbus_driver
from rig.backends.serial import frames
from rig.backends.serial.driver import SerialDriver
from rig.core import strict_json
from rig.core.calibration import Calibration, DriveMap, Scaling
from rig.core.faults import Fault
from rig.core.signals import Limits
from rig.identification import IdentifyError, identify
from rig.output.report.source import load as load_report
from rig.panel.past_runs import Runs
from rig.panel.watch import Follower, Scene
from rig.run_folder.catalogue import catalogue
from rig.run_folder.live.view import LiveView
from rig.run_folder.recording.csv_file import read_csv
from rig.run_folder.recording.curves import read_curves
from rig.run_folder.recording.errors import RecordingError
from rig.run_folder.recording.log_file import read_log
from rig.run_folder.recording.log_format import LogColumn, LogFormat
from rig.run_folder.recording.reader import read_result, read_run
from rig.run_folder.recording.recording import Recording
from rig.running.preflight import check
from rig.running.replay import replay

ROOT = Path(__file__).resolve().parents[2]
_MAX_IDENTIFY_BYTES = 40_000


@dataclass(frozen=True)
class Target:
    """``feed``: takes one input; ``seeds``: good inputs to start from."""

    feed: Callable[[bytes], None]
    seeds: Callable[[], Iterator[bytes]]


# ---------------------------------------------------------------------- the wire


def _pieces(data: bytes) -> Iterator[tuple[int, bytes]]:
    """``data`` cut as it says itself: a byte of kind, a byte of length, so many bytes, and again."""
    at = 0
    while at + 2 <= len(data):
        kind, length = data[at], data[at + 1]
        yield kind, data[at + 2 : at + 2 + length]
        at += 2 + length


def frames_from_device(data: bytes) -> None:
    """Whatever arrives: no error, the same packets however it was cut, and each body can be unpacked."""
    whole, cut = frames.FrameReader(), frames.FrameReader()
    raw = _wire(data)
    packets = whole.feed(raw)
    step = 1 + (raw[0] % 7 if raw else 0)
    again = [packet for at in range(0, len(raw), step) for packet in cut.feed(raw[at : at + step])]
    assert packets == again
    assert whole.bad_frames == cut.bad_frames
    for packet in packets:
        if packet.version == frames.VERSION and packet.kind in _UNPACK:
            _UNPACK[packet.kind](packet.body)


_UNPACK: dict[int, Callable[[bytes], object]] = {
    frames.Kind.HELLO_REPLY: frames.Hello.unpack,
    frames.Kind.SETUP_REPLY: frames.Setup.unpack,
    frames.Kind.STATE: frames.DeviceState.unpack,
    frames.Kind.STOP_REPLY: frames.DeviceState.unpack,
    frames.Kind.RELAY_REPLY: frames.RelaySetup.unpack,
    frames.Kind.BLOCK: frames.Block.unpack,
    frames.Kind.NACK: frames.Nack.unpack,
}


def _wire(data: bytes) -> bytes:
    """Pieces of kind >= 128 as they are, the others packed into intact frames: damage inside and outside of them."""
    out = b""
    for kind, piece in _pieces(data):
        if kind >= 128 or len(piece) < 3:
            out += piece
        else:
            out += frames.encode(
                kind | 0x80, int.from_bytes(piece[:2], "little"), piece[3:][: frames.MAX_BODY], piece[2]
            )
    return out


class _Scripted:
    """A transport whose replies come from the input, again and again; the port dies after ``_MAX_READS`` of them.

    By its kind a piece is silence, an intact reply to what was asked, one of any length, or anything.
    """

    def __init__(self, data: bytes) -> None:
        self._pieces = itertools.islice(itertools.cycle(_pieces(data)), _MAX_READS)
        self._now_s = 0.0
        self._seq = 0
        self._kind = 0

    def write(self, data: bytes) -> None:
        for packet in frames.FrameReader().feed(data):
            self._seq, self._kind = packet.seq, packet.kind | 0x80

    def read(self, timeout_s: float) -> bytes:
        kind, piece = next(self._pieces, (255, b""))
        if kind == 255:
            raise Fault("LINK_LOST", "the input says so")
        if kind == 0:
            self._now_s += max(timeout_s, 1e-4)
            return b""
        self._now_s += 1e-3
        return self._reply(kind, piece)

    def _reply(self, kind: int, piece: bytes) -> bytes:
        if kind < 60:
            length = frames.BODY_LENGTH.get(frames.Kind(self._kind), 0) if self._kind in set(frames.Kind) else 0
            return frames.encode(self._kind, self._seq, piece[:length].ljust(length, b"\0"))
        if kind < 100:
            return frames.encode(self._kind, self._seq, piece[: frames.MAX_BODY])
        return _wire(bytes([kind, len(piece)]) + piece)

    def now_s(self) -> float:
        return self._now_s

    def close(self) -> None:
        pass


_MAX_READS = 2000
_LIMITS = Limits((-1.2, 1.2), (-1.5, 1.5), 4.0, 0.1)


def serial_driver(data: bytes) -> None:
    """A device that answers anything: only faults come out, a stop never fails, and 0 V is always taken."""
    calibration = Calibration([(0.0, -2.1), (1023.0, 2.1)])
    _drive(SerialDriver(_Scripted(data), Scaling(calibration, DriveMap(12.0), (5, 1018)), Timeouts(open_s=0.5)))


def _drive(driver: Driver) -> None:
    """A short run to its end, or to the fault that ends it; then a stop."""
    try:
        driver.open()
        driver.arm(_LIMITS)
        for u_V in (0.5, -0.5, 0.0):
            driver.write(u_V)
            sample = driver.read()
            assert np.isfinite(sample.y_rad)
            assert np.isfinite(sample.u_V)
    except Fault:
        pass
    assert driver.safe_stop() in (True, False)
    driver.close()


class _ScriptedUnit(_Scripted):
    """The same for Modbus RTU: the host's own unit, function and length where the input says so."""

    _request = bytes(8)

    def write(self, data: bytes) -> None:
        self._request = data

    def _reply(self, kind: int, piece: bytes) -> bytes:
        if kind >= 100:
            return piece
        head = self._request[:2]
        if kind < 60:
            if head[1:] in (b"\x06", b"\x10"):
                body = self._request[:6]
            else:
                length = 2 * int.from_bytes(self._request[4:6], "big") % 252
                body = head + bytes([length]) + piece[:length].ljust(length, b"\0")
        else:
            body = (head[:1] + bytes([head[1] | 0x80]) if kind < 80 else head) + piece
        return body + FramerRTU.compute_CRC(body).to_bytes(2, "big")


def modbus_unit(data: bytes) -> None:
    """A Modbus unit that answers anything: only faults come out, a stop never fails."""
    _drive(modbus_driver(_modbus_experiment().device, _ScriptedUnit(data)))


@cache
def _modbus_experiment() -> config.Experiment:
    return config.load(ROOT / "config" / "modbus-rtu.yaml")


def _unit_seeds() -> Iterator[bytes]:
    yield bytes([1, 8, 2, 0, 0, 1, 0, 0, 0, 1])
    yield bytes([1, 8, 2, 0, 0, 1, 0, 0, 0, 1, 61, 1, 2, 0, 0, 200, 3, 1, 2, 3])
    yield b"".join(bytes([1, 8, 2, k, 0, k, 0, 0, 0, 1]) for k in range(9))


def _frame_seeds() -> Iterator[bytes]:
    hello = frames.Hello(1, 1, 0, 0, 1023, 799, 5, 0, b"fuzz".ljust(16, b"\0")).pack()
    state = bytes(frames.BODY_LENGTH[frames.Kind.STATE])
    yield bytes([1, len(hello)]) + hello + bytes([1, len(state)]) + state
    yield bytes([4, 21, 1, 0, 1]) + state + bytes([200, 3, 0, 1, 0])
    clock = b"".join(
        bytes([1, len(hello)]) + hello[:10] + (1000 * k).to_bytes(4, "little") + hello[14:] for k in range(9)
    )
    yield clock + bytes([0, 0])


# ---------------------------------------------------------------------- files


@cache
def _folder() -> Path:
    return Path(tempfile.mkdtemp(prefix="rig-fuzz-", dir="/dev/shm" if Path("/dev/shm").is_dir() else None))


def _file(name: str, data: bytes) -> Path:
    path = _folder() / name
    path.write_bytes(data)
    return path


def experiment_config(data: bytes) -> None:
    """Any file as a config: an experiment that loads back equal, or ConfigError."""
    try:
        experiment, found = check(_file("experiment.yaml", data))
    except config.ConfigError as error:
        assert str(error)
        return
    assert found.lines
    assert config.load(_file("again.yaml", config.dump(experiment).encode())) == experiment


def campaign_config(data: bytes) -> None:
    """Any file as a campaign's config: a campaign that loads back equal, or ConfigError."""
    try:
        campaign = config.load_campaign(_file("campaign.yaml", data))
    except config.ConfigError as error:
        assert str(error)
        return
    assert list(config.campaign_lines(campaign))
    assert config.load_campaign(_file("again.yaml", config.dump(campaign).encode())) == campaign


def _config_seeds(campaign: bool) -> Iterator[bytes]:
    for path in sorted((ROOT / "config").glob("*.yaml")):
        if path.name.startswith("campaign") == campaign:
            yield path.read_bytes()


def csv_file(data: bytes) -> None:
    """Any file as a CSV: arrays of one length with rising time, or RecordingError."""
    try:
        recording = read_csv(_file("any.csv", data))
    except RecordingError as error:
        assert error.cause
        assert error.cure
        return
    _check(recording)


def log_file(data: bytes) -> None:
    """Any file as a log of one's own: arrays of one length with rising time, or RecordingError."""
    path = _file("log.csv", data)
    for log in _LOGS:
        try:
            runs = read_log(path, log)
        except RecordingError as error:
            assert error.cause
            assert error.cure
            continue
        for run in runs:
            _check(run)


_LOGS = (
    LogFormat(LogColumn("us"), LogColumn("pwm"), LogColumn("counts"), counts_per_turn=1440, full=255, supply_V=12),
    LogFormat(LogColumn("s"), LogColumn("V"), velocity=LogColumn("rpm")),
    LogFormat(LogColumn("s", "1"), LogColumn("V", "2"), LogColumn("deg", "3")),
)


def _check(recording: Recording) -> None:
    assert len({len(recording.t_s), len(recording.u_V), len(recording.y_rad), len(recording.t_u_s)}) == 1
    assert np.all(np.diff(recording.t_s) > 0.0)
    assert np.all(np.isfinite(recording.y_rad))
    assert np.all(np.isfinite(recording.u_V))


def identification(data: bytes) -> None:
    """Any CSV that can be read: estimates with verdicts, or IdentifyError; an ok estimate is finite."""
    try:
        recording = read_csv(_file("identify.csv", data[:_MAX_IDENTIFY_BYTES]))
        found = identify([recording])
    except (RecordingError, IdentifyError) as error:
        assert str(error)
        return
    for estimate in found.estimates.values():
        assert estimate.verdict in ("ok", "doubtful", "refused")
        if estimate.verdict == "ok":
            assert np.all(np.isfinite([estimate.tau_s, estimate.K_rad_s_V, estimate.fc_V]))


_RUN_FILES = ("config.yaml", "meta.json", "samples.csv", "events.jsonl", "result.json")


def run_folder(data: bytes) -> None:
    """A run folder with one of its files damaged, or missing: read, and read for its report, or RecordingError."""
    folder = _damaged_run(data)
    for read in (read_run, load_report):
        try:
            read(folder)
        except RecordingError as error:
            assert error.cause
            assert error.cure


def hostile_run(data: bytes) -> None:
    """A run folder with a file of deep, wide or strange values: each reader tells of it, and the pages' JSON is sound.

    The first byte names the file; the others make its text (``structured``). One of the events stands before good ones.
    """
    which = data[0] % 5 if data else 0
    name = ("events.jsonl", "meta.json", "result.json", "config.yaml", "curves.json")[which]
    text = (structured.yaml_text if which == 3 else structured.json_text)(data[1:])
    good = _good_run()
    folder = _folder() / "hostile" / "20260101T000000Z-run"
    folder.mkdir(parents=True, exist_ok=True)
    for other, content in good.items():
        (folder / other).write_bytes(content)
    (folder / "curves.json").unlink(missing_ok=True)  # of the input before
    after = good[name] if which == 0 else b""
    (folder / name).write_bytes(text.encode("utf-8", "replace") + b"\n" + after)
    for read in (read_run, load_report, read_result, _read_kept):
        try:
            read(folder)
        except RecordingError as error:
            assert error.cause
            assert error.cure
    view = LiveView(folder)
    snapshot = view.read()
    while (again := view.read()).rows != snapshot.rows or again.numbers["is_over"] != snapshot.numbers["is_over"]:
        snapshot = again
    assert which != 0 or snapshot.numbers["is_over"], "the good events behind the hostile ones were not seen"
    told = Follower(0).due(Scene(run=folder.name, snapshot=snapshot), operator=False, now_s=1.0)
    listed = [run.as_json() for run in catalogue(folder.parent).runs]
    for message in (*told, json.dumps([listed, Runs(folder.parent).row(folder)], allow_nan=False)):
        json.loads(message, parse_constant=_no_page_takes)
    assert sum(map(len, told)) < 200_000


def _read_kept(folder: Path) -> None:
    result, _ = read_result(folder)
    read_curves(folder, read_run(folder), None if result is None else result.answer)


def _no_page_takes(name: str) -> None:
    raise AssertionError(f"{name} for a page")


def _hostile_seeds() -> Iterator[bytes]:
    for which in (0, 1, 2, 4):
        for seed in structured.json_seeds():
            yield bytes([which]) + seed
    for seed in structured.yaml_seeds():
        yield bytes([3]) + seed


def structured_config(data: bytes) -> None:
    """As ``experiment_config``, of deep, wide and strange YAML."""
    experiment_config(structured.yaml_text(data).encode("utf-8", "replace"))


def strict(data: bytes) -> None:
    """Any text as JSON: what the standard library reads, too, or JsonError."""
    for text in (data.decode("utf-8", "replace"), structured.json_text(data)):
        try:
            value = strict_json.parse(text)
        except strict_json.JsonError as error:
            assert str(error)
            continue
        assert json.dumps(value, allow_nan=False) == json.dumps(json.loads(text))
        json.dumps(value, ensure_ascii=False).encode("utf-8")


def _damaged_run(data: bytes) -> Path:
    """The good run with the file that the first byte names replaced by the others, or removed where the next is 255."""
    folder = _folder() / "run"
    folder.mkdir(exist_ok=True)
    good = _good_run()
    which = data[0] % len(_RUN_FILES) if data else 0
    for name, content in good.items():
        (folder / name).write_bytes(content)
    if data[1:2] == b"\xff":
        (folder / _RUN_FILES[which]).unlink()
    else:
        (folder / _RUN_FILES[which]).write_bytes(data[1:])
    return folder


def replayed(data: bytes) -> None:
    """The same folder replayed: the same drive, or the first difference, or a declared error."""
    folder = _damaged_run(data)
    try:
        done = replay(folder)
    except (RecordingError, config.ConfigError) as error:
        assert str(error)
        return
    assert done.is_same == (done.difference is None)
    assert 0 <= done.replayed <= done.rows


@cache
def _good_run() -> dict[str, bytes]:
    """The files of a short run (`rig jog`), kept beside this module."""
    return {name: (_RUN / name).read_bytes() for name in _RUN_FILES}


_RUN = Path(__file__).resolve().parent / "run"


def _run_seeds() -> Iterator[bytes]:
    for number, name in enumerate(_RUN_FILES):
        yield bytes([number]) + _good_run()[name]


def _csv_seeds() -> Iterator[bytes]:
    yield _good_run()["samples.csv"]
    rows = b"".join(b"%.2f;%d;%d,5\n" % (0.01 * k, 2 if k % 8 < 4 else -2, k % 8) for k in range(60))
    yield b"t_s;u_V;y_rad\n" + rows
    yield b"# a comment\nt_s\tu_V\ty_rad\n" + rows.replace(b",", b".").replace(b";", b"\t")


def _log_seeds() -> Iterator[bytes]:
    rows = b"0,255,0\n10,-51,360\n20,0,720\n"
    yield rows
    yield b"millis,pwm,counts\n" + rows
    yield b"t rpm volts\n0 1 0.5\n1 2 -0.5\n4294967295 3 0\n1 3 0\n"


TARGETS = {
    "frames": Target(frames_from_device, _frame_seeds),
    "serial-driver": Target(serial_driver, _frame_seeds),
    "modbus-unit": Target(modbus_unit, _unit_seeds),
    "servo-packets": Target(servos.packets, servos.seeds),
    "servo-bus": Target(servos.buses, servos.seeds),
    "config": Target(experiment_config, lambda: _config_seeds(campaign=False)),
    "campaign-config": Target(campaign_config, lambda: _config_seeds(campaign=True)),
    "csv": Target(csv_file, _csv_seeds),
    "log": Target(log_file, _log_seeds),
    "run-folder": Target(run_folder, _run_seeds),
    "hostile-run": Target(hostile_run, _hostile_seeds),
    "hostile-config": Target(structured_config, structured.yaml_seeds),
    "strict-json": Target(strict, structured.json_seeds),
    "replay": Target(replayed, _run_seeds),
    "identify": Target(identification, _csv_seeds),
}
