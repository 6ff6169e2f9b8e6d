"""An emulated Feetech STS: torque, modes, lock, protection. Pure.

Sources: those of ``models/sts.py``. What they do not say is an option (``ServoOptions``). What does not fit a register,
or may not be written, is ignored without a word: the error byte has no bit for it. There is no watchdog.
Modes: 2 drives the duty; 0 holds a position by its P gain alone; in the others the duty stays 0.
"""

from __future__ import annotations

from types import MappingProxyType

from rig.backends.servo import feetech
from rig.backends.servo.emulated.servo import TICK_S, EmulatedServo
from rig.backends.servo.feetech import CURRENT, HEAT, OVERLOAD, VOLTAGE, Frame, Instruction, Status
from rig.backends.servo.models import Register
from rig.backends.servo.models.sts import MANY_TURNS, STEPS_PER_SECOND

MIDDLE = 128  # written to torque_enable: makes here the middle of the turn
_DAMPED = 2
_HARMLESS = 10  # steps of duty, which break no servo away
_POSITION = 0
_MIDDLE_COUNTS = 2048
_P_PER_RAD = 0.166  # of full duty, for a gain of 1 (Rhoban/bam)
_GOALS = ("goal_position", "goal_duty", "goal_speed")
_STEPS_OF_COARSE = 50
_MOST_READ = feetech.LONGEST - 6  # bytes of data that an answer holds


class FeetechServo(EmulatedServo):
    """The servo, as ``EmulatedServo``."""

    guessed = MappingProxyType(
        {
            "phase": STEPS_PER_SECOND | 0x08, "unloading_condition": HEAT | CURRENT | OVERLOAD,
            "led_alarm_condition": 0x2F, "position_p_gain": 32, "position_d_gain": 32, "minimum_startup_force": 16,
        }
    )  # fmt: skip

    _failed, _loaded_s, _is_overloaded = 0, 0.0, False

    def _begin(self, t_s: float) -> None:
        super()._begin(t_s)
        self._failed = 0
        self._unload()
        self.put("torque_limit", self.value("max_torque"))
        self.put("goal_duty", self.options.goal_at_boot)
        self.put("lock", 1)

    # ------------------------------------------------------------------ each millisecond

    def _unload(self) -> None:
        self._loaded_s, self._is_overloaded = 0.0, False

    def fail(self, bit: int) -> None:
        """Set an error that stays until its supply has failed; where its protection has it the torque goes off."""
        self._failed |= bit
        self._protect()

    def _errors(self) -> int:
        volts = round(10.0 * self.voltage_V)
        is_in_range = self.value("min_voltage_limit") <= volts <= self.value("max_voltage_limit")
        errors = self._failed | (0 if is_in_range else VOLTAGE) | (OVERLOAD if self._is_overloaded else 0)
        return errors | (HEAT if self.temperature_degC > self.value("max_temperature_limit") else 0)

    def _protect(self) -> None:
        self.put("status", self._errors())
        if self.value("status") & self.value("unloading_condition") & ~OVERLOAD:
            self.put("torque_enable", 0)

    def _rules(self) -> None:
        mode = self.value("mode")
        if self.options.protects_in_pwm or mode != self.model.pwm_mode:
            is_loaded = abs(self._duty) >= 10.0 * self.value("overload_torque")
            self._loaded_s = self._loaded_s + TICK_S if is_loaded else 0.0
            if self._loaded_s > 1e-2 * self.value("protection_time") and self.value("unloading_condition") & OVERLOAD:
                self._is_overloaded = True
        self._protect()

    def _target(self) -> float:
        most = float(self.value("torque_limit"))
        if self._is_overloaded:
            most = min(most, 10.0 * self.value("protective_torque"))
        mode = self.value("mode")
        if mode == self.model.pwm_mode:
            return self._clipped(self.value("goal_duty"), most)
        if mode == _POSITION:
            error_rad = (self.value("goal_position") - self._position()) * self.model["goal_position"].scale
            gain = _P_PER_RAD * self.value("position_p_gain") * self.model.full_drive
            return self._clipped(gain * error_rad, most)
        return 0.0

    @property
    def is_on(self) -> bool:
        """Whether its torque is on; while it only damps it does not drive."""
        return self.value("torque_enable") == 1

    def _holds_gently(self) -> bool:
        return self.value("mode") == _POSITION and self.value("torque_limit") <= _HARMLESS

    def _is_braking(self) -> bool:
        return self.value("torque_enable") in (1, _DAMPED)

    # ------------------------------------------------------------------ what is seen

    def _position(self) -> int:
        position = self._turned() - self.value("homing_offset")
        return position if self.value("phase") & MANY_TURNS else position % self.model.counts_per_turn

    def _refresh(self) -> None:
        steps_s = self.options.polarity * self.bench.state.v / self.model["present_speed"].scale
        if not self.value("phase") & STEPS_PER_SECOND:
            steps_s /= _STEPS_OF_COARSE
        self.put("present_position", self._position())
        self.put("present_speed", round(steps_s))
        self.put("present_load", round(self._duty))
        self.put("present_voltage", min(round(10.0 * self.voltage_V), 255))
        self.put("present_temperature", min(max(round(self.temperature_degC), 0), 255))
        self.put("async_write", int(self._registered is not None))
        self.put("moving", int(round(steps_s) != 0))
        self.put("present_current", round(self.current_A / self.model["present_current"].scale))

    # ------------------------------------------------------------------ writing

    def write(self, address: int, data: bytes) -> None:
        """Write what is a register, may be written and fits; the rest is lost."""
        for register in self.model.registers.values():
            if register.access == "r" or not address <= register.address <= register.end <= address + len(data):
                continue
            raw = data[register.address - address : register.end - address]
            try:
                value = register.unpack(raw)
            except ValueError:
                continue  # bits above its sign
            if register.low is not None and not register.low <= value <= (register.high or register.most):
                continue
            self._put(register, value)

    def _put(self, register: Register, value: int) -> None:
        name = register.name
        if name == "torque_enable":
            self._switch(value)
            return
        self.put(name, value)
        if self.model.is_eeprom(register) and self.value("lock") == 0:
            self._keep(register)
        if name == "mode" and self.is_on:
            self._violate(f"mode {value} while the torque is on")
        elif name in _GOALS and self.options.torque_on_by_goal and not self.is_on:
            self._switch(1)

    def _switch(self, value: int) -> None:
        if value == MIDDLE:
            self._violate("128 to register 40: here is the middle now")
            turn = self.model.counts_per_turn
            offset = (self._turned() - _MIDDLE_COUNTS + turn // 2) % turn - turn // 2
            self.put("homing_offset", max(offset, 1 - turn // 2))
            self._keep(self.model["homing_offset"])
            return
        if value not in (0, 1, _DAMPED):
            return
        if value == 1 and not self.is_on:
            self._arm("goal_duty")
        self._unload()
        self.put("torque_enable", value)

    # ------------------------------------------------------------------ instructions

    def status(self, data: bytes = b"") -> Status:
        """Its answer, with its errors."""
        return Status(self.id, self.value("status"), data)

    def read(self, address: int, length: int) -> Status:
        """Its answer to a read; beyond its table it reads 0."""
        return self.status(self.peek(address, length).ljust(length, b"\0"))

    def instruct(self, frame: Frame) -> Status | None:
        """Do what a packet for it, or for all, says; its answer, as its level has it. None: it gives none."""
        code, parameters = frame.code, frame.parameters
        answers_all = self.value("response_level") == 1
        if code == Instruction.PING:
            return self.status()
        if code == Instruction.READ:
            return self.read(*parameters) if len(parameters) == 2 and parameters[1] <= _MOST_READ else None
        if code == Instruction.WRITE and len(parameters) > 1:
            self.write(parameters[0], parameters[1:])
        elif code == Instruction.REG_WRITE and len(parameters) > 1:
            self._registered = parameters[0], parameters[1:]
        elif code == Instruction.ACTION:
            if (registered := self._taken()) is not None:
                self.write(*registered)
        elif code == Instruction.RESET:
            self._ship(keeps=("id",))
        elif code == Instruction.REBOOT:
            self.power_cycle()
            return None
        else:
            return None
        return self.status() if answers_all else None
