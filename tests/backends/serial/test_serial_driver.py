"""The serial driver against a scripted port: pairs of an expected request and its reply, in virtual time."""

import math
import re
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, TypedDict, Unpack

import pytest
from raised import fault_of

from rig.backends.clock import MonotonicClock
from rig.backends.driver import Timeouts
from rig.backends.registry import unopened
from rig.backends.serial import frames
from rig.backends.serial.driver import SerialDriver, setup_for
from rig.backends.serial.fit import Board
from rig.backends.serial.frames import Code, DeviceState, Hello, Kind, Nack, Setup, encode
from rig.cli import main
from rig.config import Experiment, load
from rig.core.calibration import Calibration, DriveMap, Scaling, TachometerScale
from rig.core.faults import Fault
from rig.core.package import VERSION
from rig.core.signals import Limits
from rig.testing.line import on_device

CALIBRATION = Calibration([(24, -2.0015625), (1000, 2.0015625)])
DRIVE = DriveMap(supply_V=12.0)
RAILS = (5, 1018)
SCALING = Scaling(CALIBRATION, DRIVE, RAILS)
LIMITS = Limits(soft_rad=(-1.1, 1.1), hard_rad=(-1.9, 1.9), max_u_V=3.0, watchdog_s=0.1)
SESSION = 0x89ABCDEF
SETUP = Setup(SESSION, 49, 975, 5, 1018, 512, 200, 100, 1)
TIMEOUT_S = 0.03

Reply = tuple[float, bytes] | Fault


class HelloFields(TypedDict, total=False):
    """What a device says of itself, where it is not the plain one."""

    board: int
    reset_cause: int
    bridge: int
    features: int
    counts_max: int
    drive_full: int


class DriverOptions(TypedDict, total=False):
    """What a driver is told of its device."""

    board: Board
    name: str
    emulated: bool


class ScriptedPort:
    """A transport in virtual time. It answers HELLO by itself, READ until ``met``, and all else from its script.

    A reply is (delay in s, bytes), or a Fault that the port dies of.
    """

    def __init__(
        self,
        ratio: float = 1.0,
        start_us: int = 1000,
        silent_s: float = 0.0,
        version: int = frames.VERSION,
        **hello: Unpack[HelloFields],
    ) -> None:
        self.t_s = 100.0
        self.ratio, self.start_us = ratio, start_us
        self.silent_until_s = self.t_s + silent_s
        self.version = version
        self.hello = Hello(1, 1, 0, 0, 1023, 799, 0, 0, b"test-1".ljust(16, b"\0"))._replace(**hello)
        self.met = False
        self.script: list[tuple[bytes, tuple[Reply, ...]]] = []
        self.arriving: list[tuple[float, bytes]] = []
        self.requests = frames.FrameReader()
        self.seq = 0  # of the last request seen
        self.dead = False
        self.closed = False

    def device_us(self, t_s: float | None = None) -> int:
        return int(self.start_us + ((self.t_s if t_s is None else t_s) - 100.0) * 1e6 * self.ratio) % 2**32

    # the Transport

    def write(self, data: bytes) -> None:
        if self.dead:
            raise Fault("LINK_LOST", "scripted")
        requests = self.requests.feed(data)
        if not requests:
            return  # spelled, and not at its end
        (request,) = requests
        self.seq = request.seq
        if request.kind == Kind.HELLO:
            if self.t_s >= self.silent_until_s:
                body = self.hello._replace(now_us=self.device_us(self.t_s + 0.0001)).pack()
                self.reply(0.0005, encode(Kind.HELLO_REPLY, request.seq, body, self.version))
            return
        if request.kind == Kind.READ and not self.met:
            self.reply(0.001, encode(Kind.STATE, request.seq, self.state(status=0, session=0)))
            return
        assert self.script, f"unexpected {Kind(request.kind).name}"
        expected, replies = self.script.pop(0)
        assert data == expected
        for reply in replies:
            if isinstance(reply, Fault):
                self.dead = True
            else:
                self.reply(*reply)

    def reply(self, delay_s: float, data: bytes) -> None:
        self.arriving.append((self.t_s + delay_s, data))
        self.arriving.sort(key=lambda arrival: arrival[0])

    def read(self, timeout_s: float) -> bytes:
        assert timeout_s >= 0.0
        if self.arriving and self.arriving[0][0] <= self.t_s + timeout_s:
            self.t_s = max(self.t_s, self.arriving[0][0])
            return self.arriving.pop(0)[1]
        if self.dead:
            raise Fault("LINK_LOST", "scripted")
        self.t_s += timeout_s
        return b""

    def now_s(self) -> float:
        return self.t_s

    def close(self) -> None:
        self.closed = True

    # the script

    def next_seq(self, ahead: int = 1) -> int:
        return (self.seq + ahead + len(self.script)) & 0xFFFF

    def expect(self, kind: Kind, body: bytes = b"", *replies: Reply) -> None:
        """The next request, and what comes back."""
        self.met = True
        self.script.append((encode(kind, self.next_seq(), body), replies))

    def expect_answer(self, kind: Kind, body: bytes, reply_kind: Kind, reply_body: bytes) -> None:
        self.expect(kind, body, (0.001, encode(reply_kind, self.next_seq(), reply_body)))

    def expect_read(self, **state: int) -> None:
        self.expect_answer(Kind.READ, b"", Kind.STATE, self.state(**state))

    def state(self, **fields: int) -> bytes:
        base = DeviceState(self.device_us(), 512, frames.NO_TACHOMETER, 0, 0, 0, frames.STATUS_ARMED, 0, SESSION)
        return base._replace(**fields).pack()


def make(port: ScriptedPort, scaling: Scaling = SCALING, **options: Unpack[DriverOptions]) -> SerialDriver:
    return SerialDriver(port, scaling, Timeouts(TIMEOUT_S), session=SESSION, **options)


def opened(**hello: Unpack[HelloFields]) -> tuple[ScriptedPort, SerialDriver]:
    port = ScriptedPort(**hello)
    driver = make(port)
    driver.open()
    return port, driver


def expect_arming(port: ScriptedPort, setup: Setup = SETUP, stored: Setup | None = None, code: int = 0) -> None:
    port.expect_answer(Kind.STOP, b"", Kind.STOP_REPLY, port.state(status=0, session=0))
    port.expect_answer(Kind.SETUP, setup.pack(), Kind.SETUP_REPLY, (stored or setup).pack())
    port.expect_answer(Kind.ARM, frames.pack_arm(SESSION), Kind.ARM_REPLY, bytes([code]))


def armed() -> tuple[ScriptedPort, SerialDriver]:
    port, driver = opened()
    expect_arming(port)
    driver.arm(LIMITS)
    assert not port.script
    return port, driver


def test_a_zero_is_forgotten_by_a_setup_that_is_not_armed_with() -> None:
    port, driver = armed()
    forgets = Setup(SESSION, -1, 1, 0, 0, 0, 1, 1, 1, 1)
    port.expect_answer(Kind.SETUP, forgets.pack(), Kind.SETUP_REPLY, forgets.pack())
    port.expect_read(status=0)
    driver.forget_zero()
    expect_arming(port)  # the same limits as before
    driver.arm(LIMITS)
    assert not port.script


def test_firmware_that_keeps_its_zero_is_not_homed() -> None:
    """A homing that failed would leave it."""
    port, driver = opened()
    forgets = Setup(SESSION, -1, 1, 0, 0, 0, 1, 1, 1, 1)
    port.expect_answer(Kind.SETUP, forgets.pack(), Kind.SETUP_REPLY, forgets.pack())
    port.expect_read(status=frames.STATUS_ZERO)
    fault = fault_of(driver.forget_zero)
    assert fault.code == "LINK_VERSION" and "flash it" in fault.detail


def test_a_zero_that_the_device_does_not_confirm_is_not_set() -> None:
    port, driver = opened()
    state = port.state(status=frames.STATUS_FAULT, fault=Code.ENCODER_STILL)
    port.expect_answer(Kind.ZERO, frames.pack_zero(512), Kind.ZERO_REPLY, state)
    assert fault_of(lambda: driver.set_zero(0.0)).code == "DEVICE_ENCODER_STILL"
    refusal = Nack(Code.ENCODER_STILL, Kind.ZERO).pack()
    port.expect_answer(Kind.ZERO, frames.pack_zero(512), Kind.NACK, refusal)
    port.expect_read(status=frames.STATUS_FAULT, fault=Code.ENCODER_STILL)
    assert fault_of(lambda: driver.set_zero(0.0)).code == "DEVICE_ENCODER_STILL"


# ---------------------------------------------------------------------- opening


def test_open_says_who_is_there() -> None:
    port = ScriptedPort(ratio=1.005, reset_cause=8)
    driver = make(port, name="serial:/dev/ttyX")
    info = driver.open()
    assert (info.build, info.board, info.reset_cause, info.emulated) == ("test-1", "host", "watchdog", True)
    assert info.round_trip_s == pytest.approx(0.0005)
    assert driver.backend == "serial:/dev/ttyX (emulated host board, build test-1)"
    assert driver.order == "sample_first"


def test_a_real_board_is_not_called_emulated_unless_told() -> None:
    driver = make(ScriptedPort(board=2), name="serial:/dev/ttyACM0")
    assert not driver.open().emulated
    assert driver.backend == "serial:/dev/ttyACM0 (uno board, build test-1)"
    assert make(ScriptedPort(board=2), emulated=True).open().emulated


def test_hello_is_repeated_while_the_board_restarts() -> None:
    port = ScriptedPort(silent_s=2.0)
    make(port).open()
    assert 102.0 <= port.t_s < 104.0


def test_garbage_of_the_boot_loader_is_survived() -> None:
    port = ScriptedPort(silent_s=0.7)
    port.reply(0.0, b"left over from before")
    port.reply(0.3, b"\x14\x10\0garbage\0")
    driver = make(port)
    driver.open()
    assert driver.link_statistics["bad_frames"] >= 1


def test_what_an_earlier_run_left_in_the_port_is_not_believed() -> None:
    port = ScriptedPort()
    stale = port.hello._replace(build=b"stale".ljust(16, b"\0")).pack()
    port.reply(0.0, b"left over")
    port.reply(0.0, encode(Kind.HELLO_REPLY, 1, stale))
    assert make(port).open().build == "test-1"


def test_an_introduction_that_nobody_asked_for_is_not_believed() -> None:
    """Late, of a run before: its number is none of this one's."""
    port = ScriptedPort(silent_s=0.5)
    stale = port.hello._replace(build=b"stale".ljust(16, b"\0")).pack()
    port.reply(0.1, encode(Kind.HELLO_REPLY, 999, stale))
    driver = make(port)
    assert driver.open().build == "test-1"
    assert driver.link_statistics["stale_replies"] == 1


def test_a_silent_device_is_an_error_with_the_numbers() -> None:
    port = ScriptedPort(silent_s=1e9)
    fault = fault_of(make(port).open)
    assert fault.code == "LINK_HELLO"
    assert "25 requests in 5 s" in fault.detail
    assert port.t_s == pytest.approx(105.0, abs=0.2)


@pytest.mark.parametrize("version", [1, 255])
def test_another_version_names_both(version: int) -> None:
    fault = fault_of(make(ScriptedPort(version=version)).open)
    assert fault.code == "LINK_VERSION"
    assert f"version {version}" in fault.detail and f"version {frames.VERSION}" in fault.detail


UNO = load(Path(__file__).parents[3] / "config/uno.yaml").model_dump(mode="json", exclude_none=True)
AT = "rig flash --port /dev/ttyACM0 --bridge"


@pytest.mark.parametrize(
    ("changed", "line"),
    [
        ({}, f"type: {AT} in1-in2 --baud 1000000; add --supply and --end-switches if"),
        (
            {"daq": UNO["daq"] | {"baud": 115200}, "tachometer": {"rad_s_per_count": 0.25}},
            f"type: {AT} in1-in2 --baud 115200 --tachometer; add",
        ),
        (
            {"drive": {name: value for name, value in UNO["drive"].items() if name != "bridge"}},
            f"type: {AT} pwm-dir --baud 1000000 or {AT} in1-in2 --baud 1000000, as the inputs of the bridge are "
            "labelled (docs/real-bench.md): with the wrong one 0 V can be full drive",
        ),
        ({"daq": UNO["daq"] | {"baud": 57600}}, f"{AT} in1-in2 --baud 1000000; set daq.baud to 1000000"),
    ],
    ids=["as it is", "tachometer", "no bridge", "another baud"],
)
def test_a_board_of_before_gets_the_whole_line_that_flashes_it(changed: dict[str, object], line: str) -> None:
    device = on_device(ScriptedPort(version=1), MonotonicClock(), emulated=False)
    with device, unopened(Experiment.model_validate(UNO | changed).device) as (driver, *_):
        fault = fault_of(driver.open)
    assert fault.code == "LINK_VERSION"
    assert line in fault.detail
    commands = re.findall(r"rig flash ([^;,]+?)(?= or |;|,)", fault.detail)
    assert commands
    for command in commands:
        main.commands["flash"].make_context("flash", command.split())  # it can be typed


def test_a_device_that_refuses_our_version() -> None:
    port = ScriptedPort(silent_s=1e9)
    port.reply(0.01, encode(Kind.NACK, 1, Nack(Code.VERSION, Kind.HELLO).pack()))
    assert fault_of(make(port).open).code == "LINK_VERSION"


def test_a_late_hello_of_an_earlier_request_is_as_good() -> None:
    """A slow reply is not awaited for ever by asking ever anew."""
    port = ScriptedPort(silent_s=0.5)
    port.reply(0.45, encode(Kind.HELLO_REPLY, 1, port.hello._replace(build=b"late".ljust(16, b"\0")).pack()))
    assert make(port).open().build == "late"


def test_the_device_restarts_while_its_clock_is_measured() -> None:
    port = ScriptedPort(start_us=5_000_000)
    write = port.write

    def restarting(data: bytes) -> None:
        if port.t_s > 100.5:
            port.start_us = -500_000
        write(data)

    port.write = restarting  # type: ignore[method-assign]  # the restart
    assert fault_of(make(port).open).code == "DEVICE_RESET"


@pytest.mark.parametrize(
    ("hello", "scaling", "words"),
    [
        ({"counts_max": 4095}, replace(SCALING, counts_max=1023), "reads 0 to 4095"),
        ({"counts_max": 1000}, SCALING, "rail_counts"),
        ({"features": 0}, replace(SCALING, tachometer=TachometerScale(1.0)), "tachometer"),
    ],
)
def test_a_config_that_does_not_fit_the_device(hello: HelloFields, scaling: Scaling, words: str) -> None:
    fault = fault_of(make(ScriptedPort(**hello), scaling).open)
    assert fault.code == "CONFIG_MISMATCH"
    assert words in fault.detail


def test_firmware_that_cannot_run_strokes_is_refused() -> None:
    """By its name, and what to do; only where strokes may be driven in the device."""
    wants = Board(flashing="type: this line", runs_strokes=True)
    fault = fault_of(make(ScriptedPort(features=0), board=wants).open)
    assert fault.code == "CONFIG_MISMATCH"
    assert "the device's firmware, test-1, cannot: type: this line; or set relay.where to host" in fault.detail
    make(ScriptedPort(features=frames.FEATURE_STROKES), board=wants).open()
    make(ScriptedPort(features=0)).open()


@pytest.mark.parametrize(
    ("told", "config", "words"),
    [
        (2, "pwm-dir", "drive.bridge is pwm-dir, but the device's firmware is for in1-in2"),
        (1, "in1-in2", "type: this line"),
        (1, None, "write bridge: pwm-dir"),
        (7, "pwm-dir", "a bridge of kind 7"),
        (0, "in1-in2", "does not say which bridge it is for, and with the wrong one 0 V can be full drive: type: this"),
    ],
)
def test_a_bridge_that_is_not_the_configs(told: int, config: str | None, words: str) -> None:
    """The wrong one can be full drive at 0 V: nothing but questions goes out."""
    fault = fault_of(
        make(ScriptedPort(board=2, bridge=told), board=Board(bridge=config, flashing="type: this line")).open
    )
    assert fault.code == "CONFIG_MISMATCH"
    assert words in fault.detail


@pytest.mark.parametrize(
    ("board", "told", "config"),
    [(2, 1, "pwm-dir"), (2, 2, "in1-in2"), (2, 0, None), (1, 0, "in1-in2"), (1, 0, None), (1, 1, None)],
)
def test_a_bridge_that_is_the_configs_or_none(board: int, told: int, config: str | None) -> None:
    """A board that is emulated has none to say, whatever the config names."""
    make(ScriptedPort(board=board, bridge=told), board=Board(bridge=config)).open()


# ---------------------------------------------------------------------- what is latched already


def meeting(
    *latched: Code, refuses: Sequence[Code] = (), start_us: int = 600_000_000, silent_s: float = 0.0
) -> tuple[ScriptedPort, list[Code]]:
    """A port whose device has these codes latched, and refuses to clear some; it has run for ten minutes."""
    port = ScriptedPort(start_us=start_us, silent_s=silent_s)
    codes, write, reader = list(latched), port.write, frames.FrameReader()

    def answer(data: bytes) -> None:
        requests = reader.feed(data)
        if not requests or requests[0].kind == Kind.HELLO:  # spelled
            write(data)
            return
        (request,) = requests
        port.seq = request.seq
        status = frames.STATUS_FAULT if codes else 0
        if request.kind == Kind.ACK:
            (number,) = request.body
            code = Code(number)
            if code in refuses:
                port.reply(0.001, encode(Kind.NACK, request.seq, Nack(code, Kind.ACK).pack()))
                return
            codes.remove(code)
            port.reply(0.001, encode(Kind.ACK_REPLY, request.seq, port.state(status=0)))
        elif request.kind == Kind.READ:
            port.reply(
                0.001, encode(Kind.STATE, request.seq, port.state(status=status, fault=codes[0] if codes else 0))
            )
        else:
            write(data)

    port.write = answer  # type: ignore[method-assign]  # what is latched
    return port, codes


def test_opening_clears_what_was_latched_and_tells_of_it() -> None:
    port, codes = meeting(Code.RESET, Code.E_STOP, Code.WATCHDOG)
    assert make(port).open().acknowledged == ("DEVICE_ESTOP", "DEVICE_WATCHDOG")
    assert codes == []


def test_what_latches_while_a_device_is_opened_stays_latched() -> None:
    """Opening resets an Uno: what it has latched since then came after the command was given."""
    port, codes = meeting(Code.RESET, Code.E_STOP, start_us=0, silent_s=1.5)
    assert make(port).open().acknowledged == ()
    assert codes == [Code.E_STOP]
    port, codes = meeting(Code.E_STOP, Code.E_STOP)  # one that runs on: once more, after it was cleared
    assert make(port).open().acknowledged == ("DEVICE_ESTOP",)
    assert codes == [Code.E_STOP]


def test_what_lasts_stays_latched() -> None:
    port, codes = meeting(Code.RESET, Code.E_STOP, refuses=[Code.E_STOP])
    assert make(port).open().acknowledged == ()
    assert codes == [Code.E_STOP]


@pytest.mark.parametrize(
    ("build", "is_said"), [("uno 0.0.9", True), (f"uno {VERSION}", False), ("test-1", False), ("uno, my own", False)]
)
def test_the_firmware_of_another_version_of_rig_is_said_with_what_to_type(build: str, is_said: bool) -> None:
    port = ScriptedPort()
    port.hello = port.hello._replace(build=build.encode().ljust(16, b"\0"))
    remarks = make(port, board=Board(flashing="type: rig flash --bridge in1-in2")).open().remarks
    said = f"the board runs the firmware of rig 0.0.9, and this is rig {VERSION}: type: rig flash --bridge in1-in2"
    assert remarks == ((said,) if is_said else ())


def test_a_device_that_takes_long_to_answer_is_opened_all_the_same() -> None:
    """The pauses between the exchanges that measure its clock stay short: four of them fit."""
    port = ScriptedPort()
    reply = port.reply
    port.reply = lambda delay_s, data: reply(delay_s + 0.7, data)  # type: ignore[method-assign]  # slower
    driver = SerialDriver(port, SCALING, Timeouts(1.0), session=SESSION)
    assert driver.open().round_trip_s == pytest.approx(0.7, abs=0.01)


def test_full_drive_is_the_devices_own() -> None:
    _, driver = opened(drive_full=399)
    assert driver.drive_map.to_units(12.0) == 399
    assert fault_of(make(ScriptedPort(drive_full=0)).open).code == "LINK_HELLO"


# ---------------------------------------------------------------------- arming


def test_arming_sends_stop_limits_and_arm_in_this_order() -> None:
    port, driver = armed()
    assert driver.failsafe is not None and driver.failsafe.time_s == pytest.approx(0.1)
    assert port.hello.drive_full == 799


@pytest.mark.parametrize("field", [f for f in Setup._fields if f != "polarity"])
def test_a_read_back_that_differs_in_any_field(field: str) -> None:
    port, driver = opened()
    expect_arming(port, stored=SETUP._replace(**{field: getattr(SETUP, field) + 1}))
    fault = fault_of(driver.arm, LIMITS)
    assert fault.code == "ARM_READBACK"
    assert field in fault.detail
    assert len(port.script) == 1  # ARM was not sent


@pytest.mark.parametrize(
    ("code", "name"),
    [(Code.SENSOR_RAIL, "DEVICE_SENSOR"), (Code.NO_SETUP, "DEVICE_RESET"), (99, "LINK_REJECTED")],
)
def test_arming_refused(code: int, name: str) -> None:
    port, driver = opened()
    expect_arming(port, code=code)
    fault = fault_of(driver.arm, LIMITS)
    assert fault.code == name
    assert f"code {int(code)}" in fault.detail


@pytest.mark.parametrize("code", [Code.E_STOP, Code.RESET, Code.SENSOR_RAIL])
def test_what_was_latched_since_opening_refuses_and_is_not_cleared(code: Code) -> None:
    port, driver = opened()
    state = port.state(status=frames.STATUS_FAULT, fault=code, session=0)
    port.expect_answer(Kind.STOP, b"", Kind.STOP_REPLY, state)
    name = {Code.E_STOP: "DEVICE_ESTOP", Code.RESET: "DEVICE_RESET", Code.SENSOR_RAIL: "DEVICE_SENSOR"}[code]
    assert fault_of(driver.arm, LIMITS).code == name
    assert not port.script  # neither SETUP nor ACK nor ARM


def test_arming_again_sends_no_setup_and_names_the_session() -> None:
    port, driver = armed()
    port.expect_answer(Kind.STOP, b"", Kind.STOP_REPLY, port.state(status=0))
    driver.safe_stop()
    port.expect_answer(Kind.STOP, b"", Kind.STOP_REPLY, port.state(status=0))
    port.expect_answer(Kind.ARM, frames.pack_arm(SESSION), Kind.ARM_REPLY, bytes([Code.NONE]))
    driver.arm(LIMITS)
    assert not port.script


@pytest.mark.parametrize("session", [0, SESSION + 1])
def test_a_device_that_has_lost_the_session_was_reset(session: int) -> None:
    port, driver = armed()
    port.expect_answer(Kind.STOP, b"", Kind.STOP_REPLY, port.state(status=0))
    driver.safe_stop()
    port.expect_read(status=0, session=session)
    assert fault_of(driver.read).code == "DEVICE_RESET"  # in a pause
    port.expect_answer(Kind.STOP, b"", Kind.STOP_REPLY, port.state(status=0, session=session))
    assert fault_of(driver.arm, LIMITS).code == "DEVICE_RESET"
    assert not port.script
    port, driver = armed()
    port.expect_read(session=session)
    assert fault_of(driver.read).code == "DEVICE_RESET"  # armed, as it says


def test_an_e_stop_in_a_pause_is_told() -> None:
    port, driver = armed()
    port.expect_answer(Kind.STOP, b"", Kind.STOP_REPLY, port.state(status=0))
    driver.safe_stop()
    port.expect_read(status=frames.STATUS_FAULT, fault=Code.E_STOP)
    assert fault_of(driver.read).code == "DEVICE_ESTOP"


def test_each_driver_has_a_session_of_its_own() -> None:
    drivers = [SerialDriver(ScriptedPort(), SCALING) for _ in range(50)]
    sessions = {driver._session for driver in drivers}
    assert len(sessions) == 50 and all(1 <= session < 2**32 for session in sessions)


def test_setup_refused() -> None:
    port, driver = opened()
    port.expect_answer(Kind.STOP, b"", Kind.STOP_REPLY, port.state(status=0, session=0))
    port.expect_answer(Kind.SETUP, SETUP.pack(), Kind.NACK, Nack(Code.SETUP_INVALID, Kind.SETUP).pack())
    fault = fault_of(driver.arm, LIMITS)
    assert fault.code == "LINK_REJECTED"
    assert "SETUP refused, code 9" in fault.detail


def test_arming_asks_again_when_a_reply_is_lost_and_gives_up_in_the_end() -> None:
    port, driver = opened()
    port.expect(Kind.STOP)
    expect_arming(port)
    driver.arm(LIMITS)
    for _ in range(3):
        port.expect(Kind.STOP)
    assert fault_of(driver.arm, LIMITS).code == "LINK_TIMEOUT"


def test_setup_of_a_falling_sensor_and_a_reversed_bridge() -> None:
    falling = Calibration([(24, 2.0), (1000, -2.0)])
    setup = setup_for(LIMITS, falling, DRIVE, RAILS, SESSION)
    assert setup.polarity == -1
    assert setup.hard_lo < setup.centre < setup.hard_hi
    assert setup_for(LIMITS, falling, DriveMap(supply_V=12.0, reversed=True), RAILS, SESSION).polarity == 1
    assert setup_for(LIMITS, CALIBRATION, DriveMap(supply_V=12.0, reversed=True), RAILS, SESSION).polarity == -1


@pytest.mark.parametrize("calibration", [CALIBRATION, Calibration([(20, 2.03), (500, 0.1), (1000, -2.01)])])
def test_counts_are_inside_exactly_if_the_position_is(calibration: Calibration) -> None:
    setup = setup_for(LIMITS, calibration, DRIVE, RAILS, SESSION)
    for counts in range(6, 1018):
        inside = LIMITS.hard_rad[0] <= calibration.to_rad(counts) <= LIMITS.hard_rad[1]
        assert (setup.hard_lo <= counts <= setup.hard_hi) == inside


def test_the_largest_drive_covers_both_directions() -> None:
    drive = DriveMap(supply_V=12.0, dead_band_plus=0.0, dead_band_minus=0.1)
    setup = setup_for(LIMITS, CALIBRATION, drive, RAILS, SESSION)
    assert setup.max_drive == -drive.to_units(-3.0) > drive.to_units(3.0)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"hard_rad": (-2.6, 1.9)}, "rails at 5 and 1018"),
        ({"hard_rad": (-1.9, 2.6)}, "rails at 5 and 1018"),
        ({"hard_rad": (0.1, 1.9)}, "must enclose 0"),
        ({"hard_rad": (1.9, -1.9)}, "must enclose 0"),
        ({"max_u_V": 12.1}, "beyond the"),
        ({"max_u_V": 0.001}, "less than one unit"),
        ({"watchdog_s": 1.001}, "watchdog"),
        ({"watchdog_s": 0.0004}, "watchdog"),
    ],
)
def test_limits_that_the_device_cannot_hold(change: dict[str, Any], words: str) -> None:
    limits = Limits(**{**LIMITS.__dict__, **change})
    with pytest.raises(ValueError, match=words):
        setup_for(limits, CALIBRATION, DRIVE, RAILS, SESSION)


# ---------------------------------------------------------------------- one tick


def test_a_tick() -> None:
    """Read, write, read: the second sample tells when the drive took effect, and how much it was."""
    port, driver = armed()
    port.expect_read(counts=600)
    first = driver.read()
    assert first.y_counts == 600
    assert first.y_rad == pytest.approx(CALIBRATION.to_rad(600))
    assert first.u_V == 0.0
    assert math.isnan(first.t_u_s) and math.isnan(first.v_rad_per_s)

    port.expect(Kind.DRIVE, frames.pack_drive(-67))
    drive_seq = port.next_seq(0)
    driver.write(-1.0)
    effect_s = port.t_s + 0.0004
    port.t_s += 0.009
    port.expect_read(counts=601, drive=-67, drive_seq=drive_seq, t_drive_us=port.device_us(effect_s))
    sampled_s = port.t_s
    second = driver.read()
    assert second.t_s == pytest.approx(sampled_s, abs=20e-6)
    assert second.t_u_s == pytest.approx(effect_s, abs=20e-6)
    assert second.u_V == driver.drive_map.quantised(-1.0)
    assert second.u_V == pytest.approx(-1.0, abs=0.5 * 12.0 / 799)
    assert driver.link_statistics["drives_lost"] == 0


def test_a_drive_held_for_longer_than_the_clock_wraps_keeps_its_time() -> None:
    port, driver = armed()
    port.expect(Kind.DRIVE, frames.pack_drive(67))
    drive_seq = port.next_seq(0)
    driver.write(1.0)
    effect_us = port.device_us()
    times = []
    for _ in range(5):
        port.expect_read(drive=67, drive_seq=drive_seq, t_drive_us=effect_us)
        times.append(driver.read().t_u_s)
        port.t_s += 1800.0
    assert len(set(times)) == 1


def test_a_drive_beyond_the_bridge_is_refused_before_it_is_sent() -> None:
    _, driver = armed()
    with pytest.raises(ValueError, match="beyond"):
        driver.write(12.5)


def test_a_lost_drive_is_not_pretended() -> None:
    port, driver = armed()
    port.expect(Kind.DRIVE, frames.pack_drive(67))
    accepted = port.next_seq(0)
    driver.write(1.0)
    since_us = port.device_us()
    port.expect_read(drive=67, drive_seq=accepted, t_drive_us=since_us)
    before = driver.read()
    port.t_s += 0.01
    port.expect(Kind.DRIVE, frames.pack_drive(-67))  # lost on the way
    driver.write(-1.0)
    for _ in range(2):
        port.expect_read(drive=67, drive_seq=accepted, t_drive_us=since_us)
        sample = driver.read()
        assert sample.u_V == before.u_V > 0.0
        assert sample.t_u_s == before.t_u_s
    assert driver.link_statistics["drives_lost"] == 1


def test_three_lost_drives_in_a_row_end_the_run() -> None:
    """The drive that acts is no longer the host's."""
    port, driver = armed()
    for accepted in (False, False, True, False, False, False):
        port.expect(Kind.DRIVE, frames.pack_drive(67))
        seq = port.next_seq(0)
        driver.write(1.0)
        port.expect_read(drive_seq=seq if accepted else 0)
        if driver.link_statistics["drives_lost"] < 4:
            driver.read()
    with pytest.raises(Fault, match="3 drives in a row were not accepted") as caught:
        driver.read()
    assert caught.value.code == "LINK_TIMEOUT" and "512 counts" in caught.value.detail


def test_the_first_drive_lost_leaves_its_time_unknown() -> None:
    port, driver = armed()
    port.expect(Kind.DRIVE, frames.pack_drive(67))
    driver.write(1.0)
    port.expect_read(drive=0, drive_seq=0, t_drive_us=5)
    sample = driver.read()
    assert sample.u_V == 0.0
    assert math.isnan(sample.t_u_s)


def test_tachometer() -> None:
    port = ScriptedPort(features=1)
    driver = make(port, replace(SCALING, tachometer=TachometerScale(0.09, 512.0, 9.0)))
    driver.open()
    port.expect_read(tach=612)
    assert driver.read().v_rad_per_s == pytest.approx(1.0)
    port.expect_read(tach=frames.NO_TACHOMETER)
    assert math.isnan(driver.read().v_rad_per_s)


def test_reading_before_arming_is_allowed() -> None:
    port, driver = opened()
    port.expect_read(counts=700, status=0)
    assert driver.read().y_counts == 700
    port.expect_read(counts=701, status=frames.STATUS_FAULT, fault=Code.TRAVEL)  # of an earlier run
    assert driver.read().y_counts == 701


# ---------------------------------------------------------------------- replies that are not the reply


def test_late_replies_are_never_taken_for_the_next_ones() -> None:
    port, driver = armed()
    late = port.next_seq()
    port.expect(Kind.READ, b"", (LIMITS.watchdog_s + 0.001, encode(Kind.STATE, late, port.state(counts=111))))
    for _ in range(3):
        port.expect(Kind.READ)  # again, when most of the time-out is over, and then once in a time-out
    assert fault_of(driver.read).code == "LINK_TIMEOUT"
    port.t_s += 0.005
    now = port.next_seq()
    port.expect(Kind.READ, b"", (0.002, encode(Kind.STATE, now, port.state(counts=222))))
    sample = driver.read()
    assert (sample.y_counts, sample.seq) == (222, now)
    assert driver.link_statistics["stale_replies"] == 1
    assert driver.link_statistics["timeouts"] == 1


def test_a_lost_reply_is_asked_for_again_before_the_time_out() -> None:
    port, driver = armed()
    port.expect(Kind.READ)
    port.expect(Kind.READ, b"", (0.002, encode(Kind.STATE, port.next_seq(), port.state(counts=222))))
    started_s = port.t_s
    assert driver.read().y_counts == 222
    assert port.t_s - started_s == pytest.approx(2 / 3 * TIMEOUT_S + 0.002)
    assert (driver.link_statistics["asked_again"], driver.link_statistics["timeouts"]) == (1, 0)


def test_a_late_reply_to_what_was_asked_twice_will_do_and_says_when_it_was_sampled() -> None:
    port, driver = armed()
    sampled_us = port.device_us()
    first = encode(Kind.STATE, port.next_seq(), port.state(counts=222, t_sample_us=sampled_us))
    second = encode(Kind.STATE, port.next_seq(2), port.state(counts=223))
    port.expect(Kind.READ, b"", (0.8 * TIMEOUT_S, first))
    port.expect(Kind.READ, b"", (0.5 * TIMEOUT_S, second))
    started_s = port.t_s
    sample = driver.read()
    assert sample.y_counts == 222
    assert sample.t_s == pytest.approx(started_s, abs=1e-4)
    port.t_s += 0.5 * TIMEOUT_S
    port.expect_read(counts=224)
    assert driver.read().y_counts == 224  # not the second, which came meanwhile
    assert driver.link_statistics["stale_replies"] == 1


@pytest.mark.parametrize("together", [True, False])
def test_a_repeated_reply_counts_once(together: bool) -> None:
    port, driver = armed()
    reply = encode(Kind.STATE, port.next_seq(), port.state(counts=333))
    replies = [(0.001, reply + reply)] if together else [(0.001, reply), (0.002, reply)]
    port.expect(Kind.READ, b"", *replies)
    assert driver.read().y_counts == 333
    port.t_s += 0.01
    port.expect_read(counts=334)
    assert driver.read().y_counts == 334
    assert driver.link_statistics["stale_replies"] == 1


@pytest.mark.parametrize(
    "foreign",
    [
        lambda seq, state: encode(Kind.STATE, seq - 1, state),
        lambda seq, state: encode(Kind.STATE, (seq + 1) & 0xFFFF, state),
        lambda seq, state: encode(Kind.STOP_REPLY, seq, state),
        lambda seq, state: encode(Kind.STATE, seq, state, version=1),
        lambda seq, state: encode(0x90, seq, state),
    ],
    ids=["before", "ahead", "another kind", "another version", "unknown kind"],
)
def test_foreign_replies_are_passed_over(foreign: Callable[[int, bytes], bytes]) -> None:
    port, driver = armed()
    seq = port.next_seq()
    wrong, right = port.state(counts=111), port.state(counts=222)
    port.expect(Kind.READ, b"", (0.001, foreign(seq, wrong)), (0.002, encode(Kind.STATE, seq, right)))
    assert driver.read().y_counts == 222
    assert driver.link_statistics["stale_replies"] == 1


def test_a_garbled_reply_is_asked_for_again_at_once_and_is_never_another_reading() -> None:
    """Whichever bit of the reply is flipped."""
    port, driver = armed()
    bits = 8 * len(encode(Kind.STATE, 1, port.state()))
    for bit in range(bits):
        port.expect_read(counts=221)
        driver.read()
        reply = bytearray(encode(Kind.STATE, port.next_seq(), port.state(counts=222)))
        reply[bit // 8] ^= 1 << bit % 8
        port.expect(Kind.READ, b"", (0.001, bytes(reply)), (0.002, b"\0"))
        port.expect_read(counts=223)
        started_s = port.t_s
        assert driver.read().y_counts == 223
        assert port.t_s - started_s <= 0.003 + 1e-9
    assert driver.link_statistics["asked_again"] == bits
    assert driver.link_statistics["timeouts"] == 0


def test_two_garbled_replies_in_a_row_are_asked_for_again_at_once_though_nothing_is_armed() -> None:
    port, driver = opened()
    for _ in range(2):
        port.expect(Kind.READ, b"", (0.001, b"\x55\0"))
    port.expect_read(counts=223)
    assert driver.read().y_counts == 223
    assert driver.link_statistics["timeouts"] == 0


def test_three_garbled_replies_end_in_the_time_out() -> None:
    port, driver = armed()
    for _ in range(3):
        port.expect(Kind.READ, b"", (0.001, b"\x55\0"))
    for _ in range(3):
        port.expect(Kind.READ)
    started_s = port.t_s
    assert fault_of(driver.read).code == "LINK_TIMEOUT"
    assert port.t_s - started_s == pytest.approx(LIMITS.watchdog_s, abs=0.005)
    assert not port.script
    assert (driver.link_statistics["asked_again"], driver.link_statistics["timeouts"]) == (1, 1)
    port.expect_read(counts=223)
    assert driver.read().y_counts == 223


def test_three_readings_in_a_row_that_had_to_be_asked_for_again_end_the_run() -> None:
    port, driver = armed()
    for k in range(3):
        port.expect(Kind.READ, b"", (0.001, b"\x55\0"))
        port.expect_read(counts=223)
        if k < 2:
            assert driver.read().y_counts == 223
    fault = fault_of(driver.read)
    assert fault.code == "LINK_TIMEOUT"
    assert "3 readings in a row" in fault.detail
    assert "223 counts" in fault.detail  # the reading that ends the run is in no row


def test_a_reply_in_pieces() -> None:
    port, driver = armed()
    reply = encode(Kind.STATE, port.next_seq(), port.state(counts=222))
    port.expect(Kind.READ, b"", *((0.0005 * k, reply[k : k + 1]) for k in range(len(reply))))
    assert driver.read().y_counts == 222


def test_a_trickle_of_noise_does_not_stretch_the_time_out() -> None:
    port, driver = armed()
    port.expect(Kind.READ, b"", *((0.001 * k, b"\x55\0") for k in range(100)))
    for _ in range(6):
        port.expect(Kind.READ)
    started_s = port.t_s
    assert fault_of(driver.read).code == "LINK_TIMEOUT"
    assert port.t_s - started_s == pytest.approx(LIMITS.watchdog_s, abs=0.005)


def test_sequence_numbers_wrap() -> None:
    port, driver = armed()
    driver._exchange.seq = port.seq = 0xFFFE
    for seq in (0xFFFF, 0, 1):
        port.expect_read(counts=seq & 0x1FF)
        assert driver.read().seq == seq


# ---------------------------------------------------------------------- faults


@pytest.mark.parametrize(
    ("code", "name", "numbers"),
    [
        (Code.WATCHDOG, "DEVICE_WATCHDOG", "watchdog 100 ms"),
        (Code.TRAVEL, "DEVICE_TRAVEL", "limits 49 to 975 counts"),
        (Code.SENSOR_RAIL, "DEVICE_SENSOR", "rails 5 and 1018"),
        (Code.DRIVE_RANGE, "DEVICE_DRIVE_RANGE", "200 units"),
        (Code.POLARITY, "POLARITY", "code 11"),
        (42, "LINK_REJECTED", "code 42"),
    ],
)
def test_a_latched_fault_has_its_name_and_numbers(code: int, name: str, numbers: str) -> None:
    port, driver = armed()
    port.expect_read(counts=1001, status=frames.STATUS_FAULT, fault=code)
    fault = fault_of(driver.read)
    assert fault.code == name
    assert numbers in fault.detail and "1001 counts" in fault.detail


@pytest.mark.parametrize("code", [Code.NONE, Code.NOT_ARMED])
def test_a_device_that_is_no_longer_armed_has_restarted(code: Code) -> None:
    port, driver = armed()
    port.expect_read(status=0, fault=code)
    assert fault_of(driver.read).code == "DEVICE_RESET"


def test_driving_before_arming_is_told() -> None:
    port, driver = opened()
    port.expect(Kind.DRIVE, frames.pack_drive(67))
    driver.write(1.0)
    port.expect_read(status=0, fault=Code.NOT_ARMED)
    assert fault_of(driver.read).code == "DEVICE_NOT_ARMED"


def test_recovering_is_no_fault() -> None:
    port, driver = armed()
    port.expect_read(counts=1000, status=frames.STATUS_ARMED | frames.STATUS_RECOVERING)
    assert driver.read().y_counts == 1000


def test_a_refused_read() -> None:
    port, driver = armed()
    port.expect_answer(Kind.READ, b"", Kind.NACK, Nack(Code.UNKNOWN_TYPE, Kind.READ).pack())
    assert fault_of(driver.read).code == "LINK_REJECTED"


def test_a_dead_port_is_told_and_never_reopened() -> None:
    port, driver = armed()
    port.expect(Kind.READ, b"", Fault("LINK_LOST"))
    assert fault_of(driver.read).code == "LINK_LOST"
    assert fault_of(driver.read).code == "LINK_LOST"
    assert fault_of(driver.write, 1.0).code == "LINK_LOST"
    assert driver.safe_stop() is False
    driver.close()
    assert port.closed


# ---------------------------------------------------------------------- stopping


def test_safe_stop_confirmed() -> None:
    port, driver = armed()
    port.expect_answer(Kind.STOP, b"", Kind.STOP_REPLY, port.state(status=frames.STATUS_FAULT, fault=6))
    assert driver.safe_stop() is True


def test_safe_stop_asks_three_times_and_says_so() -> None:
    port, driver = armed()
    port.expect(Kind.STOP)
    port.expect_answer(Kind.STOP, b"", Kind.STOP_REPLY, port.state(status=frames.STATUS_ARMED))  # not stopped
    port.expect_answer(Kind.STOP, b"", Kind.STOP_REPLY, port.state(status=0))
    assert driver.safe_stop() is True
    for _ in range(3):
        port.expect(Kind.STOP)
    assert driver.safe_stop() is False
    assert not port.script


@pytest.mark.parametrize("left", [{"drive": 30, "status": 0}, {"drive": 0, "status": frames.STATUS_ARMED}])
def test_a_stop_that_leaves_the_drive_on_or_the_device_armed_is_not_confirmed(left: dict[str, int]) -> None:
    port, driver = armed()
    for _ in range(3):
        port.expect_answer(Kind.STOP, b"", Kind.STOP_REPLY, port.state(**left))
    assert driver.safe_stop() is False
    assert not port.script


def test_close_stops_what_is_armed() -> None:
    port, driver = armed()
    port.expect_answer(Kind.STOP, b"", Kind.STOP_REPLY, port.state(status=0))
    driver.close()
    assert port.closed and not port.script
    driver.close()


# ---------------------------------------------------------------------- clocks


@pytest.mark.parametrize(("slower_s", "least_s", "most_s"), [((0.0,), 1.0, 2.0), ((0.0, 0.004, 0.004), 3.0, 4.0)])
def test_the_clock_is_measured_for_a_second_and_for_three_where_exchanges_differ(
    slower_s: tuple[float, ...], least_s: float, most_s: float
) -> None:
    port, asked_s = ScriptedPort(), [0.0]
    reply = port.reply

    def uneven(delay_s: float, data: bytes) -> None:
        asked_s.append(port.t_s)
        reply(delay_s + slower_s[len(asked_s) % len(slower_s)], data)

    port.reply = uneven  # type: ignore[method-assign]  # a USB adapter
    make(port).open()
    assert least_s < asked_s[-1] - asked_s[1] < most_s


@pytest.mark.parametrize("ppm", [-20000, -5000, 0, 5000, 20000])
def test_device_time_becomes_host_time(ppm: int) -> None:
    """Over five minutes, a wrap of the 32 bits in between, whatever the device's rate."""
    ratio = 1.0 + 1e-6 * ppm
    port = ScriptedPort(ratio=ratio, start_us=2**32 - 60_000_000)
    driver = make(port)
    info = driver.open()
    assert info.clock_ratio == pytest.approx(ratio, abs=5e-6)
    start_s, first = port.t_s, None
    for k in range(31):
        port.t_s = start_s + 10.0 * k
        port.expect_read()
        sample = driver.read()
        first = first or sample
        assert sample.t_s - first.t_s == pytest.approx(10.0 * k, abs=1e-4 + 5e-6 * 10.0 * k)
    assert port.device_us() < 2**31  # it wrapped
