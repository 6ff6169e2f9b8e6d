"""The firmware on its emulated chip, Uno's or Pico's, through frames and through the driver, in virtual time."""

from __future__ import annotations

import itertools
import math
import random
from dataclasses import replace
from statistics import median

import pytest
from both_chips import PICO, UNO, Chip, name_of
from chip_host import BENCH, HELD, QUIET, SETTLE_S, SETUP, ChipHost, armed_chip
from evidence import evidence
from simulated_bench import CALIBRATION, LIMITS, RAILS
from virtual_host import LSB_RAD

from emulated_chips.truth import UnoTruth
from emulated_chips.virtual_chip import VirtualChip
from emulated_chips.virtual_pico import VirtualPico
from rig.backends.driver import Transport
from rig.backends.emulated.errors import EmulationError
from rig.backends.emulated.plug import Until
from rig.backends.serial.driver import SerialDriver
from rig.backends.serial.emulated.firmware_build import Variant
from rig.backends.serial.frames import (
    FEATURE_LOOPBACK,
    FEATURE_PULSE,
    FEATURE_STROKES,
    STATUS_ARMED,
    Code,
    FrameReader,
    Kind,
    Nack,
    encode,
)
from rig.core.calibration import Calibration, DriveMap, Scaling, TachometerScale
from rig.core.faults import Fault
from rig.model.bench import BenchParameters

FULL = 400
SUPPLY_V = 12.0
BRIDGES = [Variant(), Variant(bridge="IN1_IN2")]
FAST = Variant(baud=1_000_000)
WIRED = Variant(tachometer=True, supply=True, end_switches=True)


BOTH = pytest.mark.parametrize("chip", [UNO, PICO], ids=name_of)
UNO_OR_LATER_PICO = pytest.mark.parametrize("chip", [UNO, *evidence(PICO)], ids=name_of)


def driver_on(board: Transport, tachometer: TachometerScale | None = None, chip: Chip = UNO) -> SerialDriver:
    centre, most, lsb_rad = 512 * chip.scale, 1024 * chip.scale - 1, LSB_RAD / chip.scale
    calibration = Calibration([(0, -centre * lsb_rad), (most, (most - centre) * lsb_rad)])
    rails = (5 * chip.scale, 1018 * chip.scale)
    return SerialDriver(board, Scaling(calibration, DriveMap(SUPPLY_V), rails, tachometer=tachometer), emulated=True)


@pytest.mark.parametrize(
    ("chip", "options", "bridge"),
    [(chip, *case) for chip in (UNO, PICO) for case in zip(BRIDGES, (1, 2), strict=True)],
    ids=name_of,
)
def test_it_introduces_itself(chip: Chip, options: Variant, bridge: int) -> None:
    with chip.powered(BENCH, options) as host:
        hello = host.hello()
    assert hello.bridge == bridge and hello.build_text.startswith(f"{chip.name} ")
    told = (hello.board, hello.reset_words, hello.counts_max, hello.drive_full)
    assert told == (chip.id, "power-on", 1024 * chip.scale - 1, chip.full)
    assert hello.features == FEATURE_LOOPBACK | FEATURE_PULSE | FEATURE_STROKES


@pytest.mark.parametrize(("chip", "ppm"), [(UNO, -5000), (UNO, 0), (UNO, 4000), (PICO, 4000)], ids=name_of)
def test_the_driver_opens_arms_reads_drives_and_stops(chip: Chip, ppm: int) -> None:
    with chip.powered(QUIET, clock_error_ppm=ppm) as host:
        board = host.board
        driver = driver_on(board, chip=chip)
        info = driver.open()
        assert (info.board, info.emulated, info.reset_cause) == (chip.name, True, "power-on")
        assert info.clock_ratio == pytest.approx(
            1.0 + 1e-6 * ppm, abs=20e-6 if chip is UNO else 10e-6
        )  # it counts in us
        driver.arm(LIMITS)
        for u_V in (1.5, 1.8, 1.2, -1.5, -2.1, 0.0):
            driver.write(u_V)
            board.sleep_until(board.now_s() + 0.01)
            assert board.truth().pin_V == pytest.approx(round(u_V / SUPPLY_V * chip.full) / chip.full * SUPPLY_V)
            sample = driver.read()
            truth = board.truth()
            assert sample.u_V == pytest.approx(truth.pin_V, abs=1e-9)
            then_rad = truth.y_rad - truth.v_rad_per_s * (truth.t_s - sample.t_s)
            assert sample.y_rad == pytest.approx(then_rad, abs=0.51 * LSB_RAD / chip.scale + 1e-3)
            if u_V:
                assert sample.t_u_s == pytest.approx(truth.pin_changed_s, abs=chip.stamp_s)
        assert driver.safe_stop()
        assert board.truth().pin_V == 0.0 and not board.truth().led
        assert driver.link_statistics["bad_frames"] == driver.link_statistics["drives_lost"] == 0
        assert not board.truth().overruns


@pytest.mark.parametrize(
    ("chip", "ppm", "times", "start_s", "stamp_s", "age_s", "noise"),
    [(UNO, 3000, 100, (0.0, 0.6e-3), 20e-6, 0.5e-3, 0.8), (PICO, 0, 40, (-3e-6, 3e-6), 3e-6, 0.0, 1.0)],
    ids=name_of,
)
def test_what_the_state_says_is_what_is_at_the_pins(
    chip: Chip, ppm: int, times: int, start_s: tuple[float, float], stamp_s: float, age_s: float, noise: float
) -> None:
    """Times, drive and position against the truth, at random phases.

    start_s  of the program, after power on: on the Uno most of it clears the program's memory
    age_s    of a sample when it is asked for, at most; ``noise``: of the reading, counts
    """
    rng, rate = random.Random(5), 1.0 + 1e-6 * ppm
    with chip.powered(QUIET, clock_error_ppm=ppm) as host:
        host.acknowledge(Code.RESET)
        host.setup(chip.setup)
        assert host.arm() == Code.NONE
        host.drive(1)
        began_s = host.truth().pin_changed_s - host.state().t_drive_us / 1e6 / rate
        assert start_s[0] < began_s < start_s[1]
        for k in range(times):
            host.drive((-1) ** k * rng.randint(1, chip.full // 8))
            host.wait(rng.uniform(0.0, 0.008))
            asked_s = host.board.now_s()
            state, truth = host.state(), host.truth()
            assert state.drive / chip.full * SUPPLY_V == pytest.approx(truth.pin_V)
            assert began_s + state.t_drive_us / 1e6 / rate == pytest.approx(truth.pin_changed_s, abs=stamp_s)
            sampled_s = began_s + state.t_sample_us / 1e6 / rate
            assert asked_s - age_s < sampled_s < truth.t_s
            then_rad = truth.y_rad - truth.v_rad_per_s * (truth.t_s - sampled_s)
            assert state.counts == pytest.approx((512 + then_rad / LSB_RAD) * chip.scale, abs=noise)
            host.board.place(0.0)


@pytest.mark.parametrize("options", BRIDGES, ids=lambda o: o.bridge)
def test_the_bridge_gives_what_was_asked_for_both_ways(options: Variant) -> None:
    host = armed_chip(HELD, SETUP._replace(max_drive=FULL), options)
    for units in (1, -1, 200, -200, 0, FULL, -FULL, 399, 0, -3, 5, 0):
        host.drive(units)
        assert host.pin_V() == pytest.approx(units / FULL * SUPPLY_V, abs=1e-12)
    host.drive(FULL)
    host.board.reset(2)
    assert host.pin_V() == 0.0  # pins float, pull-downs hold the bridge off


@BOTH
def test_dead_time_takes_its_share_of_what_is_switched(chip: Chip) -> None:
    lost = 1e-6 * 20e3
    with chip.powered(HELD, dead_time_s=1e-6) as host:
        host.acknowledge(Code.RESET)
        host.setup(chip.setup._replace(max_drive=chip.full))
        assert host.arm() == Code.NONE
        for units, loss in ((chip.full // 2, lost), (-chip.full // 2, -lost), (chip.full, 0.0), (0, 0.0)):
            host.drive(units)
            assert host.pin_V() == pytest.approx(SUPPLY_V * (units / chip.full - loss), abs=1e-3 * (chip is PICO))
        host.drive(chip.full // 150)
        assert host.pin_V() == pytest.approx(0.0, abs=1e-3 * (chip is PICO))


@pytest.mark.parametrize(
    ("chip", "options"), [(UNO, Variant()), (UNO, FAST), (PICO, FAST), *evidence((PICO, Variant()))], ids=name_of
)
def test_no_byte_is_lost_however_dense_the_requests(chip: Chip, options: Variant) -> None:
    """The Uno holds two bytes, the Pico one; a longest frame at full speed and answers at the same time."""
    requests = b"".join(encode(Kind.SETUP, k, chip.setup.pack()) + encode(Kind.READ, k) for k in range(2))
    with chip.powered(BENCH, options, **({"measure": True} if chip is UNO else {})) as host:
        for _ in range(30 if chip is UNO else 15):
            host.send_raw(requests)
            host.send_raw(b"\x01" * 66 + b"\0")
            host.wait(0.02)
            host.board.read(0.0)
            host.hello()
        truth = host.truth()
        assert truth.overruns == 0 and truth.resets == 0
        assert truth.masked_us < (15.0 if chip is UNO else 5.0)  # one and a half bytes at 1 Mbaud; half a byte
        if isinstance(truth, UnoTruth):
            assert options.baud != 115200 or truth.interrupt_share < 0.30
        if isinstance(host.board, VirtualPico):
            assert truth.tick_us < 20.0 and host.board.stack_bytes() < 1024
            assert host.board.broken_rule() == ""


def test_more_replies_than_there_is_room_for_are_left_out_whole() -> None:
    """Of requests that come faster than replies can go, the first are answered, and none in part."""
    host = ChipHost(VirtualChip(BENCH))
    requests = 24
    host.send_raw(b"".join(encode(Kind.HELLO, 1 + k) for k in range(requests)))
    host.wait(0.2)
    reader = FrameReader()
    seqs = [packet.seq for packet in reader.feed(host.board.read(0.0))]
    assert reader.bad_frames == 0
    assert seqs == sorted(seqs) and seqs[:5] == [1, 2, 3, 4, 5] and len(seqs) < requests


def test_bytes_that_find_no_room_are_lost_and_not_those_before_them() -> None:
    """At 1 Mbaud requests come faster than they are answered: what was there first is answered first."""
    host = ChipHost(VirtualChip(BENCH, options=FAST), FAST.baud)
    host.send_raw(b"".join(encode(Kind.READ, 1 + k) for k in range(120)))
    host.wait(0.2)
    seqs = [packet.seq for packet in FrameReader().feed(host.board.read(0.0))]
    assert seqs[:12] == list(range(1, 13)) and len(seqs) < 120


@pytest.mark.parametrize("options", [Variant(), FAST], ids=lambda o: str(o.baud))
def test_a_reply_takes_the_time_of_its_bits(options: Variant) -> None:
    host = ChipHost(VirtualChip(BENCH, options=options), options.baud)
    host.board.reads = Until.BYTE
    host.send(Kind.HELLO)
    data, times_s = b"", []
    while not data.endswith(b"\0"):
        data += host.board.read(0.01)
        times_s.append(host.board.now_s())
    bits = 10 * (len(data) - 1)
    chips_baud = 2e6 / round(2e6 / options.baud)  # 115200 is 117647, by its divisor
    assert 0.99 * bits <= (times_s[-1] - times_s[0]) * chips_baud < 1.3 * bits  # a tick may come between two bytes


def test_the_devices_clock_never_jumps() -> None:
    """It is read around the end of its milliseconds, where the interrupt that counts them may still wait."""
    host, rng = ChipHost(VirtualChip(QUIET)), random.Random(7)

    def ahead_us() -> float:
        asked_s = host.board.now_s()
        return host.hello().now_us - 1e6 * asked_s

    plain_us = median(ahead_us() for _ in range(50))
    seen_us = []
    for _ in range(1000):
        soon_us = 1e6 * host.board.now_s() + 100.0
        host.board.sleep_until(1e-6 * (soon_us - (soon_us + plain_us) % 1000.0 + 1000.0 + rng.uniform(-12.0, 12.0)))
        seen_us.append(ahead_us())
    assert max(abs(us - plain_us) for us in seen_us) < 100.0


def test_the_emulated_receiver_holds_two_bytes() -> None:
    host = ChipHost(VirtualChip(BENCH))
    host.board.hang("everything")
    host.board.write(b"\x01\x02")
    host.wait(0.001)
    assert host.truth().overruns == 0
    host.board.write(b"\x03\x04")
    host.wait(0.001)
    assert host.truth().overruns == 2


def test_one_megabaud_answers_in_under_a_millisecond() -> None:
    host = armed_chip(BENCH, options=FAST)
    from_s = host.board.now_s()
    for _ in range(10):
        host.state()
    assert (host.board.now_s() - from_s) / 10 < 1e-3


@UNO_OR_LATER_PICO
def test_a_tachometer_where_it_is_wired(chip: Chip) -> None:
    scale = TachometerScale(0.05 / chip.scale, 512.0 * chip.scale)
    bench = replace(QUIET, tachometer_rad_s_per_count=0.05, tachometer_zero_counts=512.0)
    with chip.powered(bench, WIRED) as host:
        driver = driver_on(host.board, scale, chip)
        driver.open()
        driver.arm(LIMITS)
        driver.write(1.5)
        host.wait(0.09)
        sample, truth = driver.read(), host.truth()
        assert truth.v_rad_per_s > 1.0
        assert sample.v_rad_per_s == pytest.approx(truth.v_rad_per_s, abs=0.1)
    with chip.powered(bench) as host:
        with pytest.raises(Fault) as caught:
            driver_on(host.board, scale, chip).open()
        assert caught.value.code == "CONFIG_MISMATCH"
    with chip.powered(bench) as host:
        without = driver_on(host.board, chip=chip)
        without.open()
        without.arm(LIMITS)
        assert math.isnan(without.read().v_rad_per_s)


@UNO_OR_LATER_PICO
def test_the_motor_supply_where_it_is_wired(chip: Chip) -> None:
    def told_V(bench: BenchParameters, options: Variant) -> float:
        with chip.powered(bench, options) as host:
            return driver_on(host.board, chip=chip).open().supply_V

    assert told_V(QUIET, WIRED) == pytest.approx(12.0, abs=0.1)
    assert math.isnan(told_V(QUIET, Variant()))
    with pytest.raises(Fault, match=r"7\.0 V, drive\.supply_V is 12 V") as caught:
        told_V(replace(QUIET, supply_V=7.0), WIRED)
    assert caught.value.code == "CONFIG_MISMATCH"


def test_a_motor_supply_at_the_end_of_its_reading_may_be_more() -> None:
    """20 V are full scale: of 24 V nothing more can be said."""
    board = VirtualChip(replace(QUIET, supply_V=24.0), options=WIRED)
    told = SerialDriver(board, Scaling(CALIBRATION, DriveMap(24.0), RAILS), emulated=True).open()
    assert told.supply_V == pytest.approx(20.0) and told.supply_at_least
    with pytest.raises(Fault, match=r"at least 20\.0 V, drive\.supply_V is 12 V"):
        driver_on(VirtualChip(replace(QUIET, supply_V=24.0), options=WIRED)).open()


class Booting:
    """A port whose opening resets the chip, as an Uno's does: the boot loader is silent, or says what nobody asked."""

    def __init__(self, board: VirtualChip, boot_s: float, garbage: bool) -> None:
        self._board = board
        self._until_s = board.now_s() + boot_s
        self._rng = random.Random(3) if garbage else None
        board.reset(2, boot_s)

    def read(self, timeout_s: float) -> bytes:
        data = self._board.read(timeout_s)
        if self._rng is not None and self._board.now_s() < self._until_s:
            data += self._rng.randbytes(self._rng.randint(0, 40))
            self._board.sleep_until(self._board.now_s() + 0.003)
        return data

    def write(self, data: bytes) -> None:
        self._board.write(data)

    def now_s(self) -> float:
        return self._board.now_s()

    def close(self) -> None:
        self._board.close()


@pytest.mark.parametrize("garbage", [False, True])
@pytest.mark.parametrize("boot_s", [0.5, 2.0])
def test_opening_survives_the_boot_loader(boot_s: float, garbage: bool) -> None:
    board = VirtualChip(BENCH)
    board.sleep_until(0.3)
    driver = driver_on(Booting(board, boot_s, garbage))
    assert driver.open().reset_cause == "external"
    assert 0.3 + boot_s < board.now_s() < 0.3 + boot_s + 1.6  # its clock is measured for a second
    driver.arm(LIMITS)


@pytest.mark.parametrize(("cause", "words"), [(1, "power-on"), (2, "external"), (4, "brown-out")])
def test_the_cause_of_a_reset_is_told_and_nothing_else_survives_it(cause: int, words: str) -> None:
    host = armed_chip()
    host.drive(100)
    host.board.reset(cause)
    assert host.pin_V() == 0.0
    host.wait(2e-3)
    assert host.hello().reset_words == words
    assert host.state().fault == Code.RESET and host.arm_anew() == Code.NO_SETUP


def test_the_led_is_lit_while_armed_and_blinks_on_a_fault() -> None:
    host = ChipHost(VirtualChip(HELD))
    host.acknowledge(Code.RESET)
    host.setup()
    host.wait(2e-3)
    assert not host.truth().led
    assert host.arm() == Code.NONE
    host.wait(2e-3)
    assert host.truth().led
    host.wait(0.2)  # the watchdog
    lit = []
    for _ in range(100):
        host.wait(0.01)
        lit.append(host.truth().led)
    assert 40 <= sum(lit) <= 60 and 6 <= sum(a != b for a, b in itertools.pairwise(lit)) <= 9


def test_the_same_run_twice_is_the_same_to_the_last_bit() -> None:
    def run() -> list[object]:
        host = armed_chip(BENCH, seed=7, clock_error_ppm=1234)
        log: list[object] = []
        for k in range(60):
            host.drive((-1) ** (k // 7) * 60)
            log += [host.state(), host.truth()]
        return log

    assert run() == run()


def test_chips_in_one_process_are_independent() -> None:
    one, other = armed_chip(HELD), armed_chip(HELD, options=BRIDGES[1])
    one.drive(100)
    assert one.pin_V() > 0.0 and other.pin_V() == 0.0
    other.wait(1.0)
    assert one.pin_V() > 0.0 and one.board.now_s() < 0.1


def test_what_is_wrong_is_said() -> None:
    with pytest.raises(EmulationError, match="0 to 1023"):
        VirtualChip(replace(BENCH, counts_max=4095))
    with pytest.raises(EmulationError, match="dead-time-s"):
        VirtualChip(BENCH, dead_time_s=0.1)
    with pytest.raises(EmulationError, match="baud rate"):
        VirtualChip(BENCH, options=Variant(baud=3_000_000))
    host = ChipHost(VirtualChip(BENCH))
    packet = host.ask(Kind.SETUP, SETUP._replace(max_drive=FULL + 1).pack())
    assert packet.kind == Kind.NACK and Nack.unpack(packet.body).code == Code.SETUP_INVALID


def test_the_stack_is_far_from_the_data() -> None:
    host = armed_chip(BENCH, options=WIRED)
    for _ in range(5):
        host.hello()
        host.drive(60)
        host.wait(5 * SETTLE_S)
        assert host.state().status == STATUS_ARMED
    assert 100 < host.truth().stack_bytes < 400  # of the 1400 bytes that data leaves
