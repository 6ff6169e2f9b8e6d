"""Our driver on an emulated servo bus in virtual time, with what a test changes, and bystanders beside the servo."""

from __future__ import annotations

import dataclasses
from collections import Counter
from pathlib import Path
from typing import Any

from rig.backends.backend import Line
from rig.backends.driver import DeviceInfo, Timeouts
from rig.backends.servo import dynamixel, feetech
from rig.backends.servo.before import BeforeStore
from rig.backends.servo.bus import ServoLink
from rig.backends.servo.driver import ServoDriver
from rig.backends.servo.emulated.bus import ServoBus
from rig.backends.servo.emulated.hearing import named_by_dynamixel, named_by_feetech
from rig.backends.servo.emulated.servo import EmulatedServo, ServoOptions
from rig.backends.servo.emulated.virtual_bus import VirtualServoBus
from rig.backends.servo.keeper import ServoKeeper
from rig.backends.servo.line import emulated_servo, setup_of
from rig.config import load
from rig.config.schema import Experiment
from rig.core.faults import Fault
from rig.core.signals import Limits, Sample
from rig.running.keeper.silence import Kept, Order

CONFIG = Path(__file__).resolve().parents[3] / "config"
CONFIGS = {"dynamixel": CONFIG / "servo.yaml", "feetech": CONFIG / "servo-sts3215.yaml"}
PROTOCOLS = list(CONFIGS)
BYSTANDERS = (4, 7)
PERIOD_S = 0.01


def addressed(bus: ServoBus) -> Counter[int]:
    """How many packets, pings apart, went to each id, BROADCAST included; what a group instruction names counts."""
    counted: Counter[int] = Counter()
    for _, frame in bus.log:
        if isinstance(frame, dynamixel.Frame):
            if frame.instruction != dynamixel.Instruction.PING:
                counted.update(named_by_dynamixel(frame) or {frame.id})
        elif frame.code != feetech.Instruction.PING:
            counted.update(named_by_feetech(frame))
    return counted


class Bench:
    """A servo of a ready config with two bystanders, and a driver on it.

    protocol  dynamixel or feetech
    store     what keeps the values of before; None: a new one
    others    how the bystanders are set, by the names of registers
    setup     what the config says otherwise, as of ServoSetup
    options   of the servo, as of ServoOptions
    """

    def __init__(
        self,
        protocol: str = "dynamixel",
        *,
        store: BeforeStore | None = None,
        others: dict[str, int] | None = None,
        setup: dict[str, Any] | None = None,
        **options: Any,
    ) -> None:
        self.e: Experiment = load(CONFIGS[protocol])
        self.own: ServoOptions = dataclasses.replace(emulated_servo(self.e.device), **options)
        beside = [dataclasses.replace(self.own, id=id, registers=others or {}) for id in BYSTANDERS]
        self.bus = VirtualServoBus([self.own, *beside])
        self.store = BeforeStore() if store is None else store
        self.setup = dataclasses.replace(setup_of(self.e.device), **(setup or {}))
        self.driver = self.another()

    def another(self) -> ServoDriver:
        """A driver as of a command that follows: on the same bus, with the same file of values."""
        daq = self.e.daq
        timeouts = Timeouts(daq.timeout_s, 0.2, max(self.e.period_s, PERIOD_S))
        self.bus._is_plugged = True  # the command before has closed its port
        self.driver = ServoDriver(self.bus, self.setup, daq.baud, self.e.device.scaling, timeouts, self.store)
        return self.driver

    @property
    def servo(self) -> EmulatedServo:
        return self.bus.bus.servo(self.own.id)

    @property
    def bystanders(self) -> list[EmulatedServo]:
        return [servo for servo in self.bus.bus.servos if servo.id != self.own.id]

    @property
    def limits(self) -> Limits:
        return self.e.device.arming

    def opened(self) -> DeviceInfo:
        return self.driver.open()

    def armed(self) -> None:
        self.driver.open()
        self.driver.arm(self.limits)

    def tick(self, u_V: float) -> Sample:
        """One tick of the loop: a reading, a drive, and the rest of the period."""
        begins_s = self.bus.now_s()
        sample = self.driver.read()
        self.driver.write(u_V)
        self.bus.sleep_until(begins_s + PERIOD_S)
        return sample

    def driven(self, ticks: int) -> None:
        """Two tests with a pause between them; the second one drives still."""
        self.armed()
        for k in range(ticks):
            self.tick(0.4 if k % 4 < 2 else -0.4)
        self.driver.safe_stop()
        self.driver.arm(self.limits)
        self.tick(0.2)

    def fault_within(self, ticks: int, u_V: float = 0.0) -> Fault | None:
        """The fault that so many ticks raise; None where they raise none."""
        try:
            for _ in range(ticks):
                self.tick(u_V)
        except Fault as fault:
            return fault
        return None

    def registers(self) -> dict[str, int]:
        """Of the servo, all that a run may change or must not. Goals but that of the duty the servo sets by itself."""
        servo = self.servo
        return {
            r.name: servo.value(r.name)
            for r in servo.model.registers.values()
            if r.access == "rw" and (r.name == "goal_pwm" or not r.name.startswith("goal"))
        }

    def wrong(self) -> list[str]:
        """What no host may do to a servo, and was done."""
        return [violation.what for violation in self.bus.bus.violations]


class Keeper(Kept):
    """What the process of a keeper writes, on the bus in virtual time; to the driver a keeper that never acts."""

    has_acted = False

    def __init__(self, bench: Bench) -> None:
        super().__init__(bench.bus, (), (), lambda s: bench.bus.sleep_until(bench.bus.now_s() + s))

    def __call__(self, link: ServoLink, store: BeforeStore) -> Keeper:
        orders = ServoKeeper.orders(link, store)
        self._stop, self._restore, self._zero = (
            [Order(*map(bytes.fromhex, one)) for one in orders[k]] for k in ("stop", "restore", "zero")
        )
        ahead_of, text = orders["mark"]
        self.marks(ahead_of, text, "" if store.path is None else str(store.path))
        return self

    def beat(self) -> None:
        """It lives."""

    waits = rest = beat

    def end(self, *, restored: bool) -> None:
        assert restored


def line_of(bench: Bench) -> Line:
    """The bus as a backend opens it."""
    return Line(bench.bus, bench.bus, "test", emulated=True)
