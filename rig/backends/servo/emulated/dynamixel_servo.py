"""An emulated Dynamixel: access rules, torque, modes, watchdog, hardware errors. Pure.

Source: ROBOTIS e-Manual, pages of the models and "Protocol 2.0". What it does not say is an option (``ServoOptions``),
or the choice that is harder for a host: a mode that is written again resets the goals, too, and so does a start.
Modes: 16 drives the duty; 3, 4 and 5 hold a position by their P gain alone; in the others the duty stays 0.
Reading a gap brings 0. Indirect addresses, backup and profiles are not emulated.
"""

from __future__ import annotations

from types import MappingProxyType

from rig.backends.servo import dynamixel
from rig.backends.servo.dynamixel import (
    ACCESS,
    FAILED,
    LENGTH,
    LIMIT,
    NO_INSTRUCTION,
    RANGE,
    Frame,
    Instruction,
    Status,
)
from rig.backends.servo.emulated.servo import EmulatedServo
from rig.backends.servo.models import Register
from rig.backends.servo.models.control_table import SHADOW_OFF

VOLTAGE, HEAT, ENCODER, SHOCK, OVERLOAD = 0x01, 0x04, 0x08, 0x10, 0x20  # bits of hardware_error_status
REVERSED, SLAVE, TORQUE_ON_BY_GOAL = 0x01, 0x02, 0x08  # bits of drive_mode
_TORQUE_AT_START = 0x01  # bit of startup_configuration
_POSITION_MODES = (3, 4, 5)
_HARMLESS = 10  # steps of duty that break nothing away
_MODES = (0, 1, 3, 4, 5, 16)
_GOALS = ("goal_pwm", "goal_current", "goal_velocity", "goal_position")
_LIMITS = {"goal_pwm": "pwm_limit", "goal_current": "current_limit", "goal_velocity": "velocity_limit"}
_RESET = ("velocity_i_gain", "velocity_p_gain", "position_d_gain", "position_i_gain", "position_p_gain")
_TICK_TURN = 32_768


class DynamixelServo(EmulatedServo):
    """The servo, as ``EmulatedServo``."""

    guessed = MappingProxyType(
        {
            "temperature_limit": 80, "velocity_limit": 1000, "current_limit": 1000, "velocity_i_gain": 1920,
            "velocity_p_gain": 100, "position_p_gain": 800,
        }
    )  # fmt: skip

    _heard_s, _is_shut_down, _turn_counts = 0.0, False, 0

    def _begin(self, t_s: float) -> None:
        super()._begin(t_s)
        self._is_shut_down = False
        self._reset_goals()
        self._counts = self.bench.read_counts()
        self._fall_into_turn()
        if self.model.has("startup_configuration") and self.value("startup_configuration") & _TORQUE_AT_START:
            self._switch(1)

    # ------------------------------------------------------------------ each millisecond

    def heard(self, *, is_own: bool) -> None:
        """An instruction packet was on the bus."""
        if is_own or self.options.watchdog_fed_by == "any":
            self._heard_s = self.t_s

    def _rules(self) -> None:
        watchdog = self.value("bus_watchdog")
        silence_s = self.t_s - self._heard_s
        if watchdog > 0 and self.is_on and silence_s >= watchdog * self.model["bus_watchdog"].scale - 1e-9:
            self.put("bus_watchdog", -1)
            self._is_stopped = not self.options.watchdog_defect
        volts = round(10.0 * self.voltage_V)
        if not self.value("min_voltage_limit") <= volts <= self.value("max_voltage_limit"):
            self.fail(VOLTAGE)
        if self.temperature_degC > self.value("temperature_limit"):
            self.fail(HEAT)

    def fail(self, bit: int) -> None:
        """Set a bit of hardware_error_status; where ``shutdown`` has it the torque goes off, until a reboot."""
        self.put("hardware_error_status", self.value("hardware_error_status") | bit)
        if self.value("shutdown") & bit:
            self._is_shut_down = True
            self.put("torque_enable", 0)

    def _target(self) -> float:
        mode, sign = self.value("operating_mode"), -1.0 if self._is_reversed else 1.0
        most = float(self.value("pwm_limit"))
        if self.value("drive_mode") & SLAVE:
            return 0.0  # another servo's cable drives it, and there is none
        if mode == self.model.pwm_mode:
            return sign * self._clipped(self.value("goal_pwm"), most)
        if mode in _POSITION_MODES:
            error = self.value("goal_position") - self._position()
            gain = self.value("position_p_gain") / self.options.p_divisor
            return sign * self._clipped(gain * error, min(most, abs(self.value("goal_pwm"))))
        return 0.0

    def _holds_gently(self) -> bool:
        is_position = self.value("operating_mode") == self.model.position_mode
        return is_position and abs(self.value("goal_pwm")) <= _HARMLESS

    def _is_braking(self) -> bool:
        return self.is_on and not (self._is_stopped and self.options.stopped_by_watchdog == "coast")

    # ------------------------------------------------------------------ what is seen

    @property
    def _is_reversed(self) -> bool:
        return bool(self.value("drive_mode") & REVERSED)

    def _fall_into_turn(self) -> None:
        """From now on the position is within one turn; later it goes on over turns."""
        turn = self.model.counts_per_turn
        raw = -self._turned() if self._is_reversed else self._turned()
        self._turn_counts = -(raw // turn) * turn

    def _position(self) -> int:
        raw = -self._turned() if self._is_reversed else self._turned()
        return raw + self._turn_counts + self.value("homing_offset")

    def _refresh(self) -> None:
        sign = -1 if self._is_reversed else 1
        speed = self.model["present_velocity"].scale
        velocity = round(sign * self.options.polarity * self.bench.state.v / speed)
        self.put("realtime_tick", self._ticks % _TICK_TURN)
        self.put("moving", int(abs(velocity) > self.value("moving_threshold")))
        self.put("present_pwm", round(sign * self._duty))
        self.put("present_velocity", velocity)
        self.put("present_position", self._position())
        self.put("position_trajectory", self._position())
        self.put("present_input_voltage", round(10.0 * self.voltage_V))
        self.put("present_temperature", min(max(round(self.temperature_degC), 0), 255))
        self.put("registered_instruction", int(self._registered is not None))
        if self.model.has("present_current"):
            self.put("present_current", round(sign * self.current_A / self.model["present_current"].scale))
        else:
            self.put("present_load", round(sign * 1000.0 * self.current_A / self.options.stall_A))

    # ------------------------------------------------------------------ writing

    def write(self, address: int, data: bytes, *, is_shadow: bool = False) -> int:
        """Write, all or nothing; the error, 0: none. By its shadow id no EEPROM is written."""
        values = self._checked(address, data, is_shadow=is_shadow)
        if isinstance(values, int):
            return values
        for register, value in values:
            self._put(register, value)
        return 0

    def _checked(self, address: int, data: bytes, *, is_shadow: bool) -> list[tuple[Register, int]] | int:
        values: list[tuple[Register, int]] = []
        at = 0
        while at < len(data):
            register = self.model.at(address + at)
            if register is None or register.access == "r":
                return ACCESS
            if register.address != address + at or at + register.size > len(data):
                return LENGTH
            if self.model.is_eeprom(register) and (self.is_on or is_shadow):
                return ACCESS
            value = register.unpack(data[at : at + register.size])
            error = self._forbids(register, value)
            if error:
                return error
            values.append((register, value))
            at += register.size
        return values if values else LENGTH

    def _forbids(self, register: Register, value: int) -> int:
        if (register.low is not None and value < register.low) or (register.high is not None and value > register.high):
            return RANGE
        name = register.name
        watchdog = self.value("bus_watchdog")
        if watchdog < 0 and (name in _GOALS or (name == "bus_watchdog" and value != 0)):
            return RANGE  # its goals are read-only until 0 clears the error
        if name == "operating_mode" and value not in _MODES:
            return RANGE
        if name == "goal_pwm" and abs(value) > self.model.full_drive:
            return RANGE
        if name in _LIMITS and abs(value) > self.value(_LIMITS[name]):
            return LIMIT
        if name == "goal_position" and self.value("operating_mode") == 3:
            low, high = self.value("min_position_limit"), self.value("max_position_limit")
            return 0 if low <= value <= high else LIMIT
        return 0

    def _put(self, register: Register, value: int) -> None:
        name = register.name
        if name == "torque_enable":
            self._switch(value)
            return
        self.put(name, value)
        if self.model.is_eeprom(register):
            self._keep(register)
        if name == "operating_mode":
            self._reset_goals()
            for gain in _RESET:
                self.put(gain, self.model[gain].unpack(self._shipped[self.model[gain].address : self.model[gain].end]))
            self._fall_into_turn()
        elif name == "pwm_limit":
            self.put("goal_pwm", int(self._clipped(self.value("goal_pwm"), value)))
        elif name == "bus_watchdog":
            self._heard_s = self.t_s
            if value == 0 and self._is_stopped:
                self._is_stopped = False
                if not self.options.resumes:
                    self.put("goal_pwm", 0)
        elif name in _GOALS and not self.is_on and self.value("drive_mode") & TORQUE_ON_BY_GOAL:
            self._switch(1)

    def _reset_goals(self) -> None:
        self.put("goal_pwm", self.value("pwm_limit"))
        if self.model.has("goal_current"):
            self.put("goal_current", self.value("current_limit"))
        self.put("goal_velocity", 0)
        self.put("profile_acceleration", 0)
        self.put("profile_velocity", 0)

    def _switch(self, value: int) -> None:
        if value and self._is_shut_down:
            return  # only a reboot brings it back; its answer has the alert
        if value and not self.is_on:
            self._arm("goal_pwm")
            self._heard_s = self.t_s
            self.put("goal_position", self._position())
        self.put("torque_enable", value)

    # ------------------------------------------------------------------ instructions

    @property
    def shadow_id(self) -> int | None:
        """The id beside its own that it obeys; None: none."""
        value = self.value("secondary_id")
        return None if value >= SHADOW_OFF else value

    def read(self, address: int, length: int) -> Status:
        """Its answer to a read."""
        data = self.peek(address, length)
        return self._status(ACCESS) if length == 0 or len(data) < length else self._status(0, data)

    def _status(self, error: int, data: bytes = b"") -> Status:
        return Status(self.id, error, self.value("hardware_error_status") != 0, data)

    def instruct(self, frame: Frame) -> Status | None:
        """Do what a packet for it, or for all, says; its answer, as its return level has it. None: it gives none."""
        instruction, level = frame.instruction, self.value("status_return_level")
        if instruction == Instruction.PING:
            return self._status(0, self.peek(0, 2) + self.peek(6, 1))
        status = self._done(instruction, frame.parameters, is_for_all=frame.id == dynamixel.BROADCAST)
        least = 1 if instruction == Instruction.READ else 2
        return None if frame.id == dynamixel.BROADCAST or level < least else status

    def obey_shadow(self, frame: Frame) -> None:
        """Do what a packet for its shadow id says; it gives no answer."""
        if frame.instruction == Instruction.WRITE and len(frame.parameters) > 2:
            self.write(int.from_bytes(frame.parameters[:2], "little"), frame.parameters[2:], is_shadow=True)

    def _done(self, instruction: int, parameters: bytes, *, is_for_all: bool) -> Status:
        address = int.from_bytes(parameters[:2], "little")
        if instruction == Instruction.READ:
            if len(parameters) != 4:
                return self._status(LENGTH)
            return self.read(address, int.from_bytes(parameters[2:], "little"))
        if instruction == Instruction.WRITE:
            return self._status(self.write(address, parameters[2:]) if len(parameters) > 2 else LENGTH)
        if instruction == Instruction.REG_WRITE:
            checked = self._checked(address, parameters[2:], is_shadow=False) if len(parameters) > 2 else LENGTH
            if isinstance(checked, int):
                return self._status(checked)
            self._registered = address, parameters[2:]
            return self._status(0)
        if instruction == Instruction.ACTION:
            return self._status(self._act_registered())
        if instruction == Instruction.REBOOT:
            status = self._status(0)
            self.power_cycle()
            return status
        if instruction == Instruction.CLEAR:
            return self._status(self._clear(parameters))
        if instruction == Instruction.FACTORY_RESET:
            return self._status(self._reset(parameters, is_for_all=is_for_all))
        return self._status(NO_INSTRUCTION)

    def _act_registered(self) -> int:
        registered = self._taken()
        return NO_INSTRUCTION if registered is None else self.write(*registered)

    def _clear(self, parameters: bytes) -> int:
        if parameters != dynamixel.CLEAR_TURNS or self.bench.state.v != 0.0:
            return FAILED
        self._fall_into_turn()
        return 0

    def _reset(self, parameters: bytes, *, is_for_all: bool) -> int:
        kept = {b"\xff": (), b"\x01": ("id",), b"\x02": ("id", "baud_rate")}.get(parameters)
        if kept is None or self.is_on:
            return FAILED if kept is not None else RANGE
        if is_for_all and not kept:
            return FAILED  # all servos with one id would never be told apart again
        self._ship(keeps=kept)
        self.power_cycle()
        return 0
