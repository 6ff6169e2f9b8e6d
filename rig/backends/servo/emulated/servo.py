"""One emulated servo: its registers, its bridge with a motor behind it, its heat and its supply. Pure.

What both kinds have in common. The caller gives the time. Each millisecond the servo reads its sensor, looks at its
rules, and sets its bridge: so a drive acts within a millisecond after its packet, and a position is as old at most.
**No manual says so**: design assumption, to be measured on a real servo.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar, Literal, NamedTuple

from rig.backends.emulated.errors import EmulationError
from rig.backends.servo.emulated.violation import Violation
from rig.backends.servo.models import MODELS, Register, ServoModel
from rig.model.bench import BenchModel, BenchParameters
from rig.model.friction import Friction
from rig.model.motor import Motor

TICK_S = 1e-3
_BOOT_S = 0.2  # from supply or reboot to the first answer; no manual says

# XL330-M288 and STS3215 as Rhoban/bam 1b5a1ce has them (model M1), at the horn
XL330_M1 = Motor(0.0444, 2.354, Friction(0.133, 0.133, 0.133, 0.133))
STS3215_M1 = Motor(0.0467, 0.745, Friction(0.116, 0.116, 0.116, 0.116))


def _bench() -> BenchParameters:
    return BenchParameters(XL330_M1, stop_rad=(-math.inf, math.inf), supply_V=5.0)


@dataclass(frozen=True)
class ServoOptions:
    """A servo, its load and its surroundings.

    model, id, firmware, baud   as its registers say
    bench     motor, stops, supply and what else is behind the bridge; sensor and drive's steps are the model's. A motor
              with parts brakes with the torque off, too: of running free there is no law with them
    seed      of the noise
    registers other values than as shipped, by name
    polarity  +1: positive duty raises the position; -1: lowers it
    zero_counts   position register where the bench's shaft is at 0 rad
    stall_A   current at full duty with the shaft held
    sag_V     by which the supply falls then: the motor gets what is left
    ambient_degC, heating_degC_s, cooling_s   the square of current over stall's heats it; it cools with that time
    watchdog_defect   as 330 servos up to firmware 51: the watchdog says -1 and the motor drives on
    watchdog_fed_by   what feeds it: any instruction on the bus, or only what is for this servo
    stopped_by_watchdog  what its bridge does then
    resumes   whether the old goal drives again once the watchdog's error is cleared
    protects_in_pwm   Feetech: whether overload acts in PWM mode
    torque_on_by_goal Feetech: whether writing a goal switches the torque on
    goal_at_boot      Feetech: the duty's register after power-on; one source says 1000
    p_divisor         Dynamixel: steps of its position loop's P that make a step of duty of a count: 128 or 256
    The last eight are said by no manual: each may be either.
    """

    model: str = "xl330-m288"
    id: int = 1
    firmware: int = 52
    baud: int = 1_000_000
    bench: BenchParameters = field(default_factory=_bench)
    seed: int = 1
    registers: Mapping[str, int] = field(default_factory=dict)
    polarity: int = 1
    zero_counts: int = 2048
    stall_A: float = 1.0
    sag_V: float = 0.0
    ambient_degC: float = 25.0
    heating_degC_s: float = 0.0
    cooling_s: float = 300.0
    watchdog_defect: bool = False
    watchdog_fed_by: Literal["any", "own"] = "any"
    stopped_by_watchdog: Literal["brake", "coast"] = "brake"
    resumes: bool = False
    protects_in_pwm: bool = False
    torque_on_by_goal: bool = False
    goal_at_boot: int = 1000
    p_divisor: float = 128.0


class ServoTruth(NamedTuple):
    """What is really the case.

    t_s       time, s
    duty      that acts, steps of the drive's register, with the sign of the motor
    motor_V   voltage at the motor, positive towards rising positions of the bench
    y_rad, v_rad_per_s   of the bench's shaft
    is_on     whether the torque is on
    mode      value of its register
    errors    value of its register
    """

    t_s: float
    duty: float
    motor_V: float
    y_rad: float
    v_rad_per_s: float
    is_on: bool
    mode: int
    errors: int


def known_model(name: str) -> ServoModel:
    """The model of that name. Raises EmulationError."""
    if name not in MODELS:
        raise EmulationError(f"{name} is no servo that rig knows\nchoose one of {', '.join(MODELS)}")
    return MODELS[name]


class EmulatedServo:
    """The servo, powered on at time 0 with its torque off.

    options     what it is
    violated    called with each violation
    on_output   called with time, s, and voltage at the motor, V, at each change
    Raises EmulationError for a model, a register, a baud or a value that is none.
    """

    # as shipped where no manual says, or says it for other members of the family only
    guessed: ClassVar[Mapping[str, int]] = {}

    def __init__(
        self,
        options: ServoOptions,
        violated: Callable[[Violation], None],
        on_output: Callable[[float, float], None] | None = None,
    ) -> None:
        self.options = options
        self.model = known_model(options.model)
        self.on_output = on_output
        self.eeprom_writes: Counter[str] = Counter()
        self.t_s = 0.0
        self.temperature_degC = options.ambient_degC
        self.is_mute = False  # hears, and answers nothing: as after some overloads
        self._violated = violated
        parameters = replace(
            options.bench,
            encoder=True,
            rad_per_count=2.0 * math.pi / self.model.counts_per_turn,
            drive_counts=self.model.full_drive,
            coasting=True,
        )
        self._may_coast = parameters.real is None
        self._may_rest = self._may_coast and parameters.motor.bias_V == 0.0
        self.bench = BenchModel(replace(parameters, coasting=self._may_coast), options.seed)
        self._supply_V = parameters.supply_V
        self._saved = bytearray(self.model.end)
        self._ticks = 0
        self._counts = self.bench.read_counts()
        self._motor_V = 0.0
        self._duty = 0.0
        self._is_stopped = False  # by itself: it does not drive, whatever its goals are
        self._registered: tuple[int, bytes] | None = None  # address and data that wait for an action
        self._fill()
        self._active = bytearray(self._saved)
        self._values: dict[str, int] = {}  # what is in those bytes
        self._begin(self.t_s)
        self._awake_s = 0.0  # it has been on for a while

    # ------------------------------------------------------------------ registers

    def _fill(self) -> None:
        """The registers as shipped, then as the options say."""
        model, options = self.model, self.options
        for register in model.registers.values():
            shipped = register.shipped
            self._save(register, self.guessed.get(register.name, 0) if shipped is None else shipped)
        low, high = (round(10.0 * volts) for volts in model.supply_V)
        for role, value in (("low_voltage", low), ("high_voltage", high)):
            if model.role(role).shipped is None:
                self._save(model.role(role), value)
        indices = {baud: index for index, baud in model.bauds.items()}
        if options.baud not in indices:
            raise EmulationError(
                f"{options.model} has no baud {options.baud}\nchoose one of {', '.join(map(str, indices))}"
            )
        values = {"id": options.id, "baud": indices[options.baud], "firmware": options.firmware}
        for role, value in values.items():
            self._save(model.role(role), value)
        for name, value in options.registers.items():
            if not model.has(name):
                raise EmulationError(f"{options.model} has no register {name}")
            self._save(model[name], value)
        self._shipped = bytes(self._saved)

    def _save(self, register: Register, value: int) -> None:
        try:
            self._saved[register.address : register.end] = register.pack(value)
        except ValueError as error:
            raise EmulationError(str(error)) from error

    def value(self, name: str) -> int:
        """What a register holds, by name. Raises KeyError."""
        return self._values[name]

    def put(self, name: str, value: int) -> None:
        """Set a register, whatever rules it has. Raises KeyError, ValueError."""
        if self._values[name] == value:  # what it refreshes each millisecond seldom changes
            return
        register = self.model[name]
        self._active[register.address : register.end] = register.pack(value)
        self._values[name] = value

    def of(self, role: str) -> int:
        """What the register of a role holds."""
        return self._values[self.model.roles[role]]

    def _set(self, role: str, value: int) -> None:
        self.put(self.model.roles[role], value)

    def saved(self, name: str) -> int:
        """What a register will hold after the supply has failed for a moment, where it is kept at all."""
        register = self.model[name]
        return register.unpack(bytes(self._saved[register.address : register.end]))

    def _keep(self, register: Register) -> None:
        """Write a register to the EEPROM."""
        self._saved[register.address : register.end] = self._active[register.address : register.end]
        self.eeprom_writes[register.name] += 1

    def peek(self, address: int, length: int) -> bytes:
        """Bytes as a read brings them; a gap reads 0. Beyond the table it brings fewer."""
        self._refresh()
        return bytes(self._active[address : address + length])

    @property
    def id(self) -> int:
        """Its id."""
        return self.of("id")

    @property
    def baud(self) -> int:
        """Its baud; 0 where its register holds none that is known."""
        return self.model.bauds.get(self.of("baud"), 0)

    @property
    def return_delay_s(self) -> float:
        """From the end of a request to its answer."""
        return self.of("return_delay") * self.model.role("return_delay").scale

    @property
    def is_on(self) -> bool:
        """Whether its torque is on."""
        return self.of("torque") != 0

    @property
    def answers(self) -> bool:
        """Whether it hears and answers: not while it starts."""
        return self.t_s >= self._awake_s

    # ------------------------------------------------------------------ time

    def advance_to(self, t_s: float) -> None:
        """Let time pass to ``t_s``, with what every millisecond brings; none if that is past."""
        if t_s <= self.t_s:
            return
        while (tick_s := (self._ticks + 1) * TICK_S) <= t_s:
            self._move_to(tick_s)
            self._ticks += 1
            self._tick()
        self._move_to(t_s)

    def _move_to(self, t_s: float) -> None:
        if t_s > self.t_s:
            bench = self.bench
            rests = bench.state.v == 0.0 and bench.pin_counts == 0.0 and self._may_rest
            if not rests or bench.armed_for_s >= 0.0:
                bench.advance(t_s - self.t_s)
            self.t_s = t_s

    def _tick(self) -> None:
        self._counts = self.bench.read_counts()
        self._warm()
        if self._awake_s > self.t_s:
            return
        self._rules()
        is_driving = self.is_on and not self._is_stopped
        target = self._target() if is_driving else 0.0
        before = self._duty
        self._duty = self._ramped(target) if is_driving else 0.0
        # on a ramp the duty goes straight from one millisecond's to the next: the motor gets its mean
        is_ramp = is_driving and "slope" in self.model.roles
        self._act(0.5 * (before + self._duty) if is_ramp else self._duty, is_braking=self._is_braking())

    def _rules(self) -> None:
        """What it looks at each millisecond."""
        raise NotImplementedError

    def _target(self) -> float:
        """The duty that its mode and its goals ask for, steps of the drive's register, with the sign of the motor."""
        raise NotImplementedError

    def _is_braking(self) -> bool:
        """Whether its bridge shorts the motor where it does not drive: else that runs free."""
        return self.is_on

    def _ramped(self, target: float) -> float:
        if "slope" not in self.model.roles:
            return target
        slope = self.model.role("slope")
        step = self.of("slope") * slope.scale * TICK_S / self._supply_V * self.model.full_drive
        return min(max(target, self._duty - step), self._duty + step)

    def _act(self, duty: float, *, is_braking: bool) -> None:
        bench, p = self.bench, self.bench.parameters
        coasts = self._may_coast and not is_braking
        if coasts != p.coasting:
            bench.parameters = replace(p, coasting=coasts)
        bench.pin_counts = duty * self.voltage_V / self._supply_V
        motor_V = bench.motor_V
        if motor_V != self._motor_V:
            self._motor_V = motor_V
            if self.on_output is not None:
                self.on_output(self.t_s, motor_V)

    # ------------------------------------------------------------------ supply, heat, current

    @property
    def current_A(self) -> float:
        """Through the motor; 0 where it runs free."""
        if self.bench.parameters.coasting:
            return 0.0
        back_V = self.bench.state.v / self.bench.parameters.motor.K_rad_s_V
        return self.options.stall_A * (self._motor_V - back_V) / self._supply_V

    @property
    def voltage_V(self) -> float:
        """At its terminals: its supply, less what its current costs."""
        if self.options.sag_V == 0.0 or self._duty == 0.0:
            return self._supply_V
        share = abs(self._duty) / self.model.full_drive * abs(self.current_A) / self.options.stall_A
        return self._supply_V - self.options.sag_V * share

    def supply(self, supply_V: float) -> None:
        """Another supply from now on, V, > 0."""
        self._supply_V = supply_V
        self.bench.parameters = replace(self.bench.parameters, supply_V=supply_V)

    def _warm(self) -> None:
        heat = self.options.heating_degC_s
        if heat == 0.0 and self.temperature_degC == self.options.ambient_degC:
            return
        share = self.current_A / self.options.stall_A
        cooling = (self.temperature_degC - self.options.ambient_degC) / self.options.cooling_s
        self.temperature_degC += TICK_S * (heat * share * share - cooling)

    # ------------------------------------------------------------------ what is seen

    def _turned(self) -> int:
        """Counts of the sensor over turns, 0 where the shaft of the bench is at its zero and no offset is set."""
        return self.options.polarity * self._counts + self.options.zero_counts

    def _refresh(self) -> None:
        """The registers that tell what is the case."""
        raise NotImplementedError

    def truth(self) -> ServoTruth:
        """What is really the case now."""
        v, y, _ = self.bench.state
        errors = self.of("errors")
        return ServoTruth(self.t_s, self._duty, self._motor_V, y, v, self.is_on, self.of("mode"), errors)

    # ------------------------------------------------------------------ its end and its beginning

    def _begin(self, t_s: float) -> None:
        """The state after power-on: RAM as shipped, the EEPROM as it was kept, torque off."""
        end = self.model.eeprom_end
        self._active[:end] = self._saved[:end]
        self._active[end:] = self._shipped[end:]
        self._values = self.model.unpack(bytes(self._active), 0)
        self._duty = 0.0
        self._is_stopped = False
        self._registered = None
        self._awake_s = t_s + _BOOT_S
        self._act(0.0, is_braking=False)

    def power_cycle(self) -> None:
        """Its supply fails for a moment, or comes back."""
        self._begin(self.t_s)

    def power_off(self) -> None:
        """Its supply fails, until ``power_cycle``."""
        self._begin(math.inf)

    def _taken(self) -> tuple[int, bytes] | None:
        """What was registered, which is done now; None: nothing."""
        registered, self._registered = self._registered, None
        return registered

    def _factory(self, register: Register) -> int:
        """What a register held when the servo was shipped."""
        if register.shipped is not None:
            return register.shipped
        return register.unpack(self._shipped[register.address : register.end])

    def _ship(self, *, keeps: Collection[str]) -> None:
        """The EEPROM as it was shipped, but for these registers."""
        for register in self.model.registers.values():
            if self.model.is_eeprom(register) and register.access == "rw" and register.name not in keeps:
                self.put(register.name, self._factory(register))
                self._keep(register)

    def _holds_gently(self) -> bool:
        """Whether it is in a mode of its own in which its duty is bounded to what breaks nothing away."""
        return False

    def _arm(self, goal: str) -> None:
        """The torque comes on, with that goal of its duty."""
        if self.of("mode") != self.model.pwm_mode:
            if not self._holds_gently():
                self._violate(f"torque on in mode {self.of('mode')}")
        elif self.value(goal) != 0:
            self._violate(f"torque on with goal {self.value(goal)}")
        self.bench.arm()

    def _violate(self, what: str) -> None:
        self._violated(Violation(self.t_s, self.id, what))

    def place(self, y_rad: float, v_rad_per_s: float = 0.0) -> None:
        """Put the shaft somewhere, as a hand would."""
        self.bench.state = self.bench.state._replace(v=v_rad_per_s, y=y_rad)
        self._counts = self.bench.read_counts()

    def rewire(self, **wiring: Any) -> None:
        """Change ``drive``, ``sensor`` or ``fault_after_s`` from now on, as of BenchParameters."""
        self.bench.parameters = replace(self.bench.parameters, **wiring)

    def _clipped(self, value: float, most: float) -> float:
        return min(max(value, -most), most)
