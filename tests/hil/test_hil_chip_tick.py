"""The Uno's control tick is an interrupt: it goes on while the main loop is busy, and lets the others in."""

from __future__ import annotations

import random
from itertools import pairwise

import pytest
from chip_host import HELD, QUIET, ChipHost, armed_chip
from device_relay import DeviceRelay
from virtual_host import SETUP, TICK_S, Told

from rig.backends.serial.emulated.firmware_build import PLAIN_VARIANT, Variant
from rig.backends.serial.frames import STATUS_ARMED, STATUS_LAW, Code, Kind, RelaySetup, encode

RELAY = RelaySetup((-50, 16, -16, 50), 512 * 16, 3_000_000, 1, 10)
BITE = RelaySetup((-50, 16, -16, 50), 512 * 16, 200, 1, 10)  # the integral follows the position at once
FAST = Variant(baud=1_000_000)
FULL = 400
CLOCK_US = 8  # two steps of the chip's clock
BLOCKS_MS = 20  # for so long rows wait for the main loop


class Running(Told):
    """A chip whose relay drives, and all that it says of it."""

    def __init__(self, relay: RelaySetup = RELAY, options: Variant = PLAIN_VARIANT) -> None:
        super().__init__()
        self.relay = relay
        self.host: ChipHost = armed_chip(QUIET, SETUP._replace(max_drive=200), options)
        self.host.drive(1)
        self.start_s = self.host.truth().pin_changed_s - self.host.state().t_drive_us * 1e-6  # of the chip's clock
        self.host.drive(0)
        self.pins: list[tuple[float, float]] = []  # changes: time, mean voltage
        self.host.send(Kind.RELAY, relay.pack())

    def run(self, duration_s: float, step_s: float = 0.2e-3, keep_s: float = 9.7e-3) -> None:
        """Let the host's loop go on, and look at the pins all the while."""
        board = self.host.board
        end_s, keeps_s = board.now_s() + duration_s, board.now_s()
        while board.now_s() < end_s:
            if board.now_s() >= keeps_s:
                self.host.send(Kind.KEEP)
                keeps_s += keep_s
            board.sleep_until(board.now_s() + step_s)
            truth = board.truth()
            if not self.pins or truth.pin_changed_s != self.pins[-1][0]:
                self.pins.append((truth.pin_changed_s, truth.pin_V))
            self.take(board.read(0.0))

    def assert_decided_by_the_law(self) -> None:
        """Each drive is the one that the relay decides on the counts of all rows so far."""
        law = DeviceRelay(self.relay.centre, self.relay.z_bound, self.relay.drive, self.relay.direction)
        for t_us, counts, drive in self.rows():
            assert drive == law.step(counts), t_us

    def assert_gapless(self) -> None:
        assert self.numbers == list(range(len(self.numbers)))
        assert all(abs(b - a - 1000) <= CLOCK_US for (a, *_), (b, *_) in pairwise(self.rows()))


@pytest.mark.parametrize("stall_ms", [1.0, 7.3, BLOCKS_MS - 2.0])
def test_the_relay_goes_on_while_the_main_loop_is_busy(stall_ms: float) -> None:
    """Every tick decides and drives at its time, and its row is told afterwards."""
    rng = random.Random(int(stall_ms))
    running = Running(BITE)
    within = 0
    for _ in range(6):
        running.run(rng.uniform(0.06, 0.07))
        before_s = running.host.board.now_s()
        running.host.board.stall("main loop", 1e-3 * stall_ms)
        running.run(1e-3 * stall_ms)
        within += sum(before_s < t_s < before_s + 1e-3 * stall_ms for t_s, _ in running.pins)
    running.run(0.1)
    running.assert_gapless()
    running.assert_decided_by_the_law()
    if stall_ms > BLOCKS_MS / 2:
        assert within > 0  # it has switched meanwhile
    assert running.host.truth().resets == 0 and running.host.state().status == STATUS_ARMED | STATUS_LAW


def test_what_the_main_loop_is_too_late_to_send_is_missed() -> None:
    """A number of a block is missing, and the relay has gone on."""
    running = Running()
    running.run(0.05)
    running.host.board.stall("main loop", 2e-3 * BLOCKS_MS)
    running.run(0.15)
    missing = set(range(running.numbers[-1])) - set(running.numbers)
    assert missing and running.numbers == sorted(running.numbers)
    assert running.rows()[-1][0] - running.rows()[0][0] == pytest.approx(
        1000 * (len(running.rows()) + 10 * len(missing) - 1), abs=CLOCK_US
    )


def test_the_watchdog_for_the_hosts_silence_outlives_the_main_loop() -> None:
    """It is the tick's: off in time, and reset by the hardware watchdog later.

    Where the loop hangs in the few us in which it holds the tick back, the hardware watchdog is all there is.
    """
    rng = random.Random(4)
    by_the_tick = 0
    for _ in range(40):
        host = armed_chip(HELD)
        host.drive(60)
        heard_s = host.heard_s
        host.wait(rng.uniform(0.0, 0.01))
        host.board.hang("main loop")
        hung_s = host.board.now_s()
        host.board.sleep_until(heard_s + 0.1 - TICK_S)
        assert host.pin_V() > 0.0
        host.board.sleep_until(heard_s + 0.1 + TICK_S)
        by_the_tick += host.pin_V() == 0.0
        host.board.sleep_until(hung_s + 0.15)
        assert host.pin_V() == 0.0 and host.truth().resets == 1
    assert by_the_tick >= 36


@pytest.mark.parametrize(("stall_ms", "left_out"), [(0.5, 0), (1.2, 1), (2.5, 2)])
def test_a_tick_that_takes_too_long_is_never_entered_again(stall_ms: float, left_out: int) -> None:
    """Those that come due meanwhile are left out, as the rows' times tell; all others come, and the stack is whole."""
    running = Running()
    running.run(0.05)
    stack_bytes = running.host.truth().stack_bytes
    for _ in range(5):
        running.host.board.stall("tick", 1e-3 * stall_ms)
        running.run(0.05)
    running.run(0.02)
    steps_us = [b - a for (a, *_), (b, *_) in pairwise(running.rows())]
    long_us = [step for step in steps_us if step > 1000 + CLOCK_US]
    assert len(long_us) == (5 if left_out else 0)
    assert all(abs(step - 1000 * (left_out + 1)) <= CLOCK_US for step in long_us)
    running.assert_decided_by_the_law()
    truth = running.host.truth()
    assert truth.stack_bytes <= stack_bytes + 40 and truth.overruns == 0 and truth.resets == 0


@pytest.mark.parametrize(("options", "within_us"), [(PLAIN_VARIANT, 16.0), (FAST, 32.0)], ids=["115200", "1000000"])
def test_a_blocks_one_delay_is_true_of_all_its_rows(options: Variant, within_us: float) -> None:
    """From the sample to the pin, at every switching, against the truth at the pins."""
    running = Running(BITE, options)
    running.run(1.5)
    rows, told_us = running.rows(), [block.delay_us for block in running.blocks for _ in block.rows]
    pins = [(t_s, pin_V) for t_s, pin_V in running.pins if t_s > running.start_s]
    found_us = []
    for (_, _, before), (t_us, _, drive), delay_us in zip(rows, rows[1:], told_us[1:], strict=False):
        if drive != before:
            drives_s = running.start_s + 1e-6 * (t_us + delay_us)
            at_s, pin_V = min(pins, key=lambda pin: abs(pin[0] - drives_s))
            assert at_s == pytest.approx(drives_s, abs=1e-6 * within_us)
            assert pin_V == pytest.approx(drive / FULL * 12.0)
            found_us.append(1e6 * (at_s - running.start_s) - t_us)
    assert len(found_us) > 20
    assert min(found_us) > 150.0 and max(found_us) < 250.0 and max(found_us) - min(found_us) < within_us


def test_requests_at_any_phase_of_the_tick_cost_no_tick() -> None:
    """What holds the tick back for some 10 us delays it; none is left out, at the largest baud rate."""
    running = Running(options=FAST)
    for k in range(120):
        running.run(0.01 + 8.3e-6 * k, step_s=2e-3)
        running.host.board.write(encode(Kind.READ, k) + encode(Kind.KEEP, k))
        running.run(0.5e-3)
    running.run(0.02)
    running.assert_gapless()
    running.assert_decided_by_the_law()
    assert max(block.delay_us for block in running.blocks) < 400


def test_a_dead_tick_is_reset_by_the_hardware_watchdog_though_the_main_loop_lives() -> None:
    host = armed_chip(HELD, SETUP._replace(max_drive=200, watchdog_ms=1000))
    host.drive(60)
    host.board.hang("tick")
    host.wait(0.1)
    assert host.pin_V() > 0.0 and host.state().status == STATUS_ARMED  # it answers
    host.wait(0.05)
    assert host.pin_V() == 0.0 and host.truth().resets == 1
    assert host.hello().reset_words == "watchdog" and host.arm() == Code.RESET
