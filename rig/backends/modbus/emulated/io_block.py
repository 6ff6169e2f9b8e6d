"""An emulated Modbus I/O block: an analogue output and an input with the bench behind them, and its own safety rules.

Pure: the caller gives the time; bytes are protocol data units (function code and data, without address and check sum).
The block follows the Modbus application protocol, V1.1b3; ``io_block_registers`` says what each register means.

Its safety rules are those of firmware/core/rig_core.c. Nothing drives before the block is armed with all its settings.
Four things set 0 V and latch until it is armed again: silence of the host, a position beyond the travel limits, a
sensor at its rail, a drive beyond the largest. Armed outside the limits, it takes inward drive only. It checks the
rules each millisecond and at each reading.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING, Any, NamedTuple, Self

from rig.backends.emulated.bench_of_config import bench_parameters
from rig.backends.emulated.errors import EmulationError
from rig.backends.modbus.emulated.io_block_registers import RANGES, BlockRegisters
from rig.backends.modbus.registers import Table
from rig.model.bench import BenchModel

if TYPE_CHECKING:  # the process of an emulated device starts without the config
    from rig.backends.modbus.section import Modbus
    from rig.config.schema import Emulated

TICK_S = 1e-3
VENDOR, PRODUCT = "rig", "emulated I/O block"
LONGEST_WATCHDOG_S = 10.0

# exceptions (section 7)
ILLEGAL_FUNCTION, ILLEGAL_ADDRESS, ILLEGAL_VALUE, DEVICE_FAILURE = 1, 2, 3, 4

OFF, ARMED = 0, 1  # of the status register; faults are beyond

# As in the firmware: farther inside than this is recovered; farther out than this part of the range is no recovery.
_RECOVERED_COUNTS = 3.0
_POLARITY_DIVISOR = 32.0
_NO_SETTING = {"drive", "sequence", "control"}  # of what is written
_MOST_READ, _MOST_WRITTEN, _MOST_WRITTEN_23 = 125, 123, 121


class ExecutedDrive(NamedTuple):
    """A drive that was written: when, its value, and whether it was taken."""

    t_s: float
    value: float
    taken: bool


class IoBlockTruth(NamedTuple):
    """The true state of the block and of the bench.

    t_s            time, s
    output_V       drive at the output
    motor_V        voltage that the wiring passes on to the motor
    y_rad, v_rad_per_s   of the measured shaft
    armed          whether a drive is allowed
    fault          code of the latched fault; DEVICE_NOT_ARMED after a drive refused for that; None: no fault
    recovering     +1 armed above the limits, -1 below, 0 neither
    """

    t_s: float
    output_V: float
    motor_V: float
    y_rad: float
    v_rad_per_s: float
    armed: bool
    fault: str | None
    recovering: int


class _Refused(Exception):
    """An exception of the protocol."""

    def __init__(self, code: int) -> None:
        super().__init__(code)
        self.code = code


class IoBlock:
    """The block, powered on and disarmed at time 0.

    registers  the register map
    bench      the bench behind it: the block's output is the bench's pin, with the drive register's resolution
    unit       its unit id, 1 to 247
    polarity   +1: positive drive raises the position register; -1: lowers it
    revision   version that it reports
    on_drive   called with each drive that is written, taken or not
    on_output  called with time, s, and value, V, of each change at the output
    Raises EmulationError where the position's type cannot hold what the sensor reads.

    Without a control register a drive arms it, once it has its settings; after a fault a drive of 0 arms it again. A
    refused drive shows in the status register, or without one as exception 4. Gaps in the register map read 0.
    """

    def __init__(
        self,
        registers: BlockRegisters,
        bench: BenchModel,
        unit: int = 1,
        *,
        polarity: int = 1,
        revision: str = "1",
        on_drive: Callable[[ExecutedDrive], None] | None = None,
        on_output: Callable[[float, float], None] | None = None,
    ) -> None:
        self.registers = registers
        self.bench = bench
        self.unit = unit
        self.t_s = 0.0
        self.drive = 0.0  # at the output, in units of its register
        self.e_stop_open = False  # cuts the output and disarms, but does not latch: the host must read the status
        self.requests = 0
        self._polarity = polarity
        self._revision = revision
        self.on_drive = on_drive
        self.on_output = on_output
        self._ticks = 0
        self._heard_s = 0.0
        self._farthest = 0.0
        self._has_control = registers.has("control")
        types = {f.name: f.type for fields in registers.readable.values() for f in fields}
        self._is_whole = types["position"] in RANGES
        _must_hold("position", types["position"], [self._units(n) for n in (0, bench.parameters.counts_max)])
        _must_hold("applied", types.get("applied", "float32"), [-registers.full, registers.full])
        self._begin()

    def _begin(self) -> None:
        """The state at power-on: disarmed, no fault, every register 0 and no setting."""
        self.armed = False
        self.fault: str | None = None
        self.latched = False
        self.recovering = 0
        self._values: dict[str, float] = {f.name: 0.0 for fields in self.registers.readable.values() for f in fields}
        self._unset = {f.name for f in self.registers.writable} - _NO_SETTING
        self._read_position()

    @classmethod
    def of(cls, modbus: Modbus, emulated: Emulated, seed: int, **options: Any) -> Self:
        """As the sections ``daq.modbus`` and ``emulated`` have it; options as of the class."""
        bench = BenchModel(bench_parameters(emulated), seed)
        return cls(BlockRegisters.of(modbus), bench, modbus.unit, **options)

    # ------------------------------------------------------------------ time

    def advance_to(self, t_s: float) -> None:
        """Let time pass to ``t_s``, with the checks of every millisecond on the way; none if that is past."""
        while (tick_s := (self._ticks + 1) * TICK_S) <= t_s:
            self._move_to(tick_s)
            self._ticks += 1
            self._tick()
        self._move_to(t_s)

    def _move_to(self, t_s: float) -> None:
        if t_s > self.t_s:
            self.bench.advance(t_s - self.t_s)
            self.t_s = t_s

    def _tick(self) -> None:
        self._sample()
        watchdog_s = self.watchdog_s
        if watchdog_s is None or not self.armed or not (self._has_control or self.drive != 0.0):
            return
        if self.t_s - self._heard_s >= watchdog_s - 1e-9:  # 0.1 s are 100 ticks, whatever the binary fraction
            self._latch("DEVICE_WATCHDOG")

    @property
    def watchdog_s(self) -> float | None:
        """Silence after which it sets 0 V; None: it has no watchdog."""
        if "watchdog" in self._values:
            return self._values["watchdog"] * self.registers.unit_s
        return self.registers.device_watchdog_s

    # ------------------------------------------------------------------ the true state

    @property
    def output_V(self) -> float:
        """Drive at the output, V."""
        return self.drive / self.registers.full * self.bench.parameters.supply_V

    def truth(self) -> IoBlockTruth:
        """The true state now."""
        v, y, _ = self.bench.state
        fault = self.fault
        return IoBlockTruth(self.t_s, self.output_V, self.bench.motor_V, y, v, self.armed, fault, self.recovering)

    @property
    def status(self) -> int:
        """Value of the status register."""
        if self.e_stop_open:
            return self.registers.status_of["DEVICE_ESTOP"]
        if self.fault is not None:
            return self.registers.status_of[self.fault]
        return ARMED if self.armed else OFF

    def power_off(self) -> None:
        """Cut the power: the output falls to 0 V."""
        self._act(0.0)
        self.armed = False

    def power_cycle(self) -> None:
        """Cut the power for a moment: the output falls to 0 V, and the block has forgotten all that was written."""
        self._act(0.0)
        self._begin()

    # ------------------------------------------------------------------ sensor

    def _units(self, counts: float) -> float:
        return (counts - self.registers.offset_counts) / self.registers.scale

    def _read_position(self) -> None:
        position = self._units(self.bench.read_counts())
        self._values["position"] = float(round(position)) if self._is_whole else position

    def _at_rail(self) -> bool:
        if "rails.low" not in self._values:
            return False
        return not self._values["rails.low"] < self._values["position"] < self._values["rails.high"]

    def _side(self) -> int:
        """Where the shaft is: 0 inside, +1 above the limits, -1 below."""
        if "limits.low" not in self._values:
            return 0
        position = self._values["position"]
        return (position > self._values["limits.high"]) - (position < self._values["limits.low"])

    def _obstacle(self) -> str | None:
        """What forbids any drive, wherever the shaft is."""
        if self._at_rail():
            return "DEVICE_SENSOR"
        if "limits.low" in self._values and not self._values["limits.low"] < self._values["limits.high"]:
            return "DEVICE_TRAVEL"  # no way is inward
        return None

    def _is_recovered(self) -> bool:
        position, margin = self._values["position"], _RECOVERED_COUNTS / abs(self.registers.scale)
        if self.recovering > 0:
            return position < self._values["limits.high"] - margin
        return position > self._values["limits.low"] + margin

    def _moves_outward(self) -> bool:
        """While recovering under inward drive: does the shaft move outward instead?"""
        position = self._values["position"]
        if self.drive == 0.0:
            self._farthest = position  # it may still coast outward from before
            return False
        allowed = (self._values["limits.high"] - self._values["limits.low"]) / _POLARITY_DIVISOR
        return self.recovering * (position - self._farthest) > allowed

    def _sample(self) -> None:
        self._read_position()
        if self.e_stop_open:
            self._disarm()
        if not self.armed:
            return
        obstacle = self._obstacle()
        if obstacle is not None:
            self._latch(obstacle)
            return
        side = self._side()
        if self.recovering != 0 and side != -self.recovering:
            if side != 0 or not self._is_recovered():
                if self._moves_outward():
                    self._latch("DEVICE_TRAVEL")
                return
            self.recovering = 0
        if side != 0:
            self._latch("DEVICE_TRAVEL")

    # ------------------------------------------------------------------ drive and faults

    def _act(self, value: float) -> None:
        if value != self.drive:
            self.drive = value
            p = self.bench.parameters
            self.bench.pin_counts = value / self.registers.full * p.drive_counts
            if self.on_output is not None:
                self.on_output(self.t_s, self.output_V)

    def _disarm(self) -> None:
        self._act(0.0)
        self.armed = False
        self.recovering = 0

    def _latch(self, fault: str) -> None:
        # the cause is noted first: whoever watches the output sees why it fell
        self.fault, self.latched = fault, True
        self._disarm()

    def _clear_fault(self) -> None:
        self.fault, self.latched = None, False

    def _arm(self) -> None:
        self._disarm()  # arming starts from drive 0, also when already armed
        self._read_position()
        self._clear_fault()
        if self.e_stop_open:
            return
        obstacle = self._obstacle()
        if obstacle is not None:
            self._latch(obstacle)
            return
        self.recovering = self._side()
        self._farthest = self._values["position"]
        self._heard_s = self.t_s
        self.armed = True
        self.bench.arm()

    def _take_drive(self, value: float) -> bool:
        """Whether the drive is taken; where it is not, the fault says why."""
        self._heard_s = self.t_s
        if not self._has_control and not self._unset and (value == 0.0 if self.latched else not self.armed):
            self._arm()
        if self.latched:
            return False
        if not self.armed:
            if value != 0.0:
                self.fault = "DEVICE_NOT_ARMED"
            return value == 0.0
        largest = self._values.get("max_drive", self.registers.full)
        if abs(value) > largest:
            self._latch("DEVICE_DRIVE_RANGE")
            return False
        raises = (value > 0.0) == (self._polarity > 0)
        if self.recovering != 0 and value != 0.0 and raises == (self.recovering > 0):
            self._latch("DEVICE_TRAVEL")
            return False
        self._act(value)
        return True

    # ------------------------------------------------------------------ requests

    def request(self, pdu: bytes, t_s: float) -> bytes:
        """The answer to one request that arrives whole at ``t_s``. A time that is past counts as now.

        ``pdu`` has at least its function code. The block answers any bytes. If it has ``_Refused`` them, the
        answer is a Modbus exception.
        """
        self.advance_to(t_s)
        self.requests += 1
        function, data = pdu[0], pdu[1:]
        answers = {3: self._fc03, 4: self._fc04, 6: self._fc06, 16: self._fc16, 23: self._fc23, 43: self._fc43}
        try:
            answer = answers.get(function)
            if answer is None:
                raise _Refused(ILLEGAL_FUNCTION)
            return bytes((function,)) + answer(data)
        except _Refused as refused:
            return bytes((function | 0x80, refused.code))
        finally:
            if self.drive == 0.0:  # what drives is kept up by drive writes alone: one that got lost must not stay on
                self._heard_s = self.t_s

    def _fc03(self, data: bytes) -> bytes:
        return self._fc_read("holding", data)

    def _fc04(self, data: bytes) -> bytes:
        return self._fc_read("input", data)

    def _fc_read(self, table: Table, data: bytes) -> bytes:
        address, count = _unpack(">HH", data)
        _within(count, _MOST_READ)
        self._check_readable(table, address, count)
        return self._read(table, address, count)

    def _fc06(self, data: bytes) -> bytes:
        address, word = _unpack(">HH", data)
        self._write(self._fields_of(address, [word]))
        return data

    def _fc16(self, data: bytes) -> bytes:
        address, count, n_bytes = _unpack(">HHB", data[:5])
        _within(count, _MOST_WRITTEN)
        self._write(self._fields_of(address, _words(data[5:], count, n_bytes)))
        return data[:4]

    def _fc23(self, data: bytes) -> bytes:
        read_address, read_count, address, count, n_bytes = _unpack(">HHHHB", data[:9])
        _within(read_count, _MOST_READ)
        _within(count, _MOST_WRITTEN_23)
        words = _words(data[9:], count, n_bytes)
        self._check_readable("holding", read_address, read_count)
        self._write(self._fields_of(address, words))  # written before read (section 6.17)
        return self._read("holding", read_address, read_count)

    def _fc43(self, data: bytes) -> bytes:
        if len(data) < 1 or data[0] != 14:
            raise _Refused(ILLEGAL_FUNCTION)  # another interface than "read device identification"
        if len(data) != 3 or not 1 <= data[1] <= 4:
            raise _Refused(ILLEGAL_VALUE)
        texts = [VENDOR, PRODUCT, self._revision]
        code, first = data[1], data[2]
        if code == 4:
            if first >= len(texts):
                raise _Refused(ILLEGAL_ADDRESS)
            wanted = [first]
        else:  # a stream from the first on; from 0 where there is no such object
            wanted = list(range(first if first < len(texts) else 0, len(texts)))
        objects = b"".join(bytes((n, len(texts[n]))) + texts[n].encode("ascii") for n in wanted)
        return bytes((14, code, 0x81, 0, 0, len(wanted))) + objects

    # ------------------------------------------------------------------ registers

    def _check_readable(self, table: Table, address: int, count: int) -> None:
        fields = self.registers.readable[table]
        if not fields:
            raise _Refused(ILLEGAL_ADDRESS)
        first, end = min(f.address for f in fields), max(f.address + f.words for f in fields)
        if address < first or address + count > end:
            raise _Refused(ILLEGAL_ADDRESS)

    def _read(self, table: Table, address: int, count: int) -> bytes:
        self._sample()
        values = self._values | {"applied": self.drive, "status": float(self.status)}
        words = [0] * count
        for f in self.registers.readable[table]:
            at = f.address - address
            if -f.words < at < count:
                for k, word in enumerate(f.pack(values[f.name], self.registers.drive.low_first)):
                    if 0 <= at + k < count:
                        words[at + k] = word
        return bytes((2 * count,)) + struct.pack(f">{count}H", *words)

    def _fields_of(self, address: int, words: list[int]) -> dict[str, float]:
        """Names and values of the fields that the words are; raises unless each is one, or a whole one of two."""
        values: dict[str, float] = {}
        n = 0
        for f in self.registers.writable:
            at = f.address - address
            if at >= 0 and at + f.words <= len(words):
                values[f.name] = f.unpack(words[at : at + f.words], self.registers.drive.low_first)
                n += f.words
        if n != len(words):
            raise _Refused(ILLEGAL_ADDRESS)
        return values

    def _write(self, values: dict[str, float]) -> None:
        """All of it, or an exception and nothing: settings, then arming, then the drive."""
        settings = {name: value for name, value in values.items() if name not in _NO_SETTING}
        for name, value in values.items():
            if not self._is_allowed(name, value):
                raise _Refused(ILLEGAL_VALUE)
        arms = values.get("control") == self.registers.arm
        if settings and self.armed and (self._has_control or self.drive != 0.0):
            raise _Refused(DEVICE_FAILURE)  # limits never change under drive
        if arms and self._unset - settings.keys():
            raise _Refused(DEVICE_FAILURE)  # it was never told its limits
        self._values |= settings
        self._unset -= settings.keys()
        if "control" in values:
            self._values["control"] = values["control"]
            if arms:
                self._arm()
            else:
                self._disarm()
                self._clear_fault()
        taken = True
        if "drive" in values:
            self._values["drive"] = values["drive"]
            taken = self._take_drive(values["drive"])
            if self.on_drive is not None:
                self.on_drive(ExecutedDrive(self.t_s, values["drive"], taken))
        if "sequence" in values:
            self._values["sequence"] = values["sequence"]
            if taken:
                self._values["echo"] = values["sequence"]
        if not taken and "status" not in self._values:
            raise _Refused(DEVICE_FAILURE)

    def _is_allowed(self, name: str, value: float) -> bool:
        if not math.isfinite(value):
            return False
        if name == "control":
            return value in (self.registers.arm, self.registers.stop)
        if name == "watchdog":
            return 0.0 < value * self.registers.unit_s <= LONGEST_WATCHDOG_S
        if name == "max_drive":
            return 0.0 < value <= self.registers.full
        return True

    # ------------------------------------------------------------------ what may happen to a bench

    def rewire(self, **wiring: Any) -> None:
        """Change ``drive`` and ``sensor`` wiring from now on, as of BenchParameters."""
        self.bench.parameters = replace(self.bench.parameters, **wiring)

    def place(self, y_rad: float, v_rad_per_s: float = 0.0) -> None:
        """Put the shaft somewhere, as a hand would."""
        self.bench.state = self.bench.state._replace(v=v_rad_per_s, y=y_rad)


def _must_hold(name: str, kind: str, ends: list[float]) -> None:
    low, high = RANGES.get(kind, (-math.inf, math.inf))
    if not (low <= min(ends) and max(ends) <= high):
        raise EmulationError(
            f"the emulated device's {name} runs from {min(ends):g} to {max(ends):g}, which {kind} cannot hold\n"
            f"choose another type or scale in daq.modbus.registers.{name}"
        )


def _unpack(layout: str, data: bytes) -> tuple[int, ...]:
    if len(data) != struct.calcsize(layout):
        raise _Refused(ILLEGAL_VALUE)
    return struct.unpack(layout, data)


def _within(count: int, most: int) -> None:
    if not 1 <= count <= most:
        raise _Refused(ILLEGAL_VALUE)


def _words(data: bytes, count: int, n_bytes: int) -> list[int]:
    if n_bytes != 2 * count or len(data) != n_bytes:
        raise _Refused(ILLEGAL_VALUE)
    return list(struct.unpack(f">{count}H", data))
