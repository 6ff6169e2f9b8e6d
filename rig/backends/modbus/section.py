"""The section ``daq.modbus``: how a Modbus device is asked, and which register means what.

What registers say together (contiguous, within one request, no two at one address) is in ``rig.backends.modbus.rules``.
"""

from __future__ import annotations

from typing import Annotated, Literal, Self
from urllib.parse import urlsplit

from pydantic import Field, field_validator, model_validator

from rig.core.faults import FAULTS
from rig.core.section import NonNegative, Positive, Section, not_zero

Address = Annotated[int, Field(ge=0, le=65535)]
Word = Annotated[int, Field(ge=0, le=65535)]
SignedType = Literal["int16", "int32", "float32"]
RegisterType = Literal["int16", "uint16", "int32", "uint32", "float32"]

EMULATED_PORTS = ("emulated", "emulated-tcp", "emulated-realtime", "emulated-tcp-realtime")
TCP_PORT = 502  # unless the address names another
_TCP, _EMULATED_TCP = "tcp://", "emulated-tcp"

_LARGEST = {"int16": 32767, "int32": 2**31 - 1}
_FIRST_FAULT = 2  # of the values of the status register: 0 is off, 1 is armed


class DriveRegister(Section):
    """Where the drive is written."""

    address: Address = Field(description="holding register, counted from 0")
    type: SignedType = Field("int16", description="its type")
    full: Positive = Field(description="value at full duty; negative full is full duty the other way")

    @model_validator(mode="after")
    def _held_by_its_type(self) -> Self:
        if self.type != "float32":
            largest = _LARGEST[self.type]
            if self.full != int(self.full) or not 50 <= self.full <= largest:
                raise ValueError(f"`full` of {self.type} must be a whole number from 50 to {largest}")
        return self


class PositionRegister(Section):
    """Where the position is read: counts = scale x value + offset_counts, rounded."""

    address: Address = Field(description="register, counted from 0")
    type: RegisterType = Field("uint16", description="its type")
    table: Literal["holding", "input"] = Field(
        "holding", description="read by FC03 (or FC23), or by FC04; echo, applied and status are read beside it"
    )
    scale: Annotated[float, not_zero()] = Field(1.0, description="counts for one unit of the register; not 0")
    offset_counts: float = Field(0.0, description="counts where the register is 0")


class SequenceRegisters(Section):
    """A number that goes out with each drive, and comes back once that was executed; uint16."""

    address: Address = Field(description="written with each drive; just before or after it")
    echo: Address = Field(description="where the device copies it when it executes the write")


class AppliedRegister(Section):
    """What really acts at the output, in the drive's units."""

    address: Address = Field(description="register, in the table of the position")
    type: SignedType = Field("int16", description="its type")


class StatusRegister(Section):
    """What the device says of itself, uint16: 0 off, 1 armed, anything else a fault."""

    address: Address = Field(description="register, in the table of the position")
    faults: dict[str, Word] = Field({}, description="code of a DEVICE_ fault: its value, from 2 on")

    @field_validator("faults")
    @classmethod
    def _known(cls, faults: dict[str, int]) -> dict[str, int]:
        known = [code for code in FAULTS if code.startswith("DEVICE_")]
        named: dict[int, str] = {}
        for code, value in faults.items():
            if code not in known:
                raise ValueError(f"no fault {code!r}; known: {', '.join(known)}")
            if value < _FIRST_FAULT:
                raise ValueError(f"{value} is {'armed' if value else 'off'}, not {code}: from {_FIRST_FAULT} on")
            if value in named:
                raise ValueError(f"{value} is given to {named[value]} and to {code}")
            named[value] = code
        return faults


class ControlRegister(Section):
    """Where the device is armed and stopped."""

    address: Address = Field(description="holding register")
    arm: Word = Field(1, description="what is written to arm it")
    stop: Word = Field(0, description="what is written to stop and disarm it; another than `arm`")

    @model_validator(mode="after")
    def _two_values(self) -> Self:
        if self.arm == self.stop:
            raise ValueError(f"`arm` and `stop` are both {self.arm}: what stops the device would arm it")
        return self


class WatchdogRegister(Section):
    """Where the device's output time-out is set, uint16: silence after which it drives 0 V."""

    address: Address = Field(description="holding register; written at arming and read back")
    unit_s: Positive = Field(0.001, description="seconds for one unit of the register")


class PairRegisters(Section):
    """Two bounds of the position, in the units and the type of its register."""

    low: Address = Field(description="holding register of the lower one; written at arming and read back")
    high: Address = Field(description="holding register of the upper one")


class MaxDriveRegister(Section):
    """The largest drive that the device takes, in the units and the type of the drive."""

    address: Address = Field(description="holding register; written at arming and read back")


class Registers(Section):
    """The register map. Addresses count from 0, as on the wire: 40001 in old manuals is holding register 0."""

    drive: DriveRegister = Field(description="where the drive is written")
    position: PositionRegister = Field(description="where the position is read")
    sequence: SequenceRegisters | None = Field(None, description="written with each drive, echoed when executed")
    applied: AppliedRegister | None = Field(
        None, description="drive that acts at the output; without it the commanded one counts as applied"
    )
    status: StatusRegister | None = Field(None, description="off, armed, or which fault")
    control: ControlRegister | None = Field(None, description="arms and stops; without it the drive alone does")
    watchdog: WatchdogRegister | None = Field(None, description="the device's own output time-out")
    limits: PairRegisters | None = Field(None, description="the device's own travel limits: limits.hard_rad")
    max_drive: MaxDriveRegister | None = Field(None, description="the device's own largest drive: drive.max_V")
    rails: PairRegisters | None = Field(None, description="readings of a broken sensor: sensor.rail_counts")


class Modbus(Section):
    """How a Modbus device is asked, and which register means what."""

    unit: Annotated[int, Field(ge=1, le=247)] = Field(1, description="unit (slave) id of the device")
    requests: Literal["read-write", "separate"] = Field(
        "read-write",
        description="of a tick: FC23, which writes the drive and reads the position in one; or FC03 (FC04), then "
        "FC16 (FC06), for a device without FC23",
    )
    parity: Literal["none", "even", "odd"] = Field("none", description="RTU: parity bit")
    stop_bits: Literal[1, 2] = Field(1, description="RTU: stop bits; strict RTU without parity has 2")
    turnaround_s: NonNegative = Field(
        0.0005, description="device's own time from the request's end to its reply, silences apart"
    )
    silence_s: Positive | None = Field(
        None, description="RTU: pause around a frame; left out: 3.5 characters, above 19200 baud 1.75 ms"
    )
    word_order: Literal["high-first", "low-first"] = Field("high-first", description="of 32-bit types")
    device_watchdog_s: Annotated[float, Field(gt=0, le=10.0)] | None = Field(
        None, description="output time-out that is set on the device itself, where no register sets it"
    )
    registers: Registers = Field(description="which register means what")

    @model_validator(mode="after")
    def _one_watchdog(self) -> Self:
        if self.device_watchdog_s is not None and self.registers.watchdog is not None:
            raise ValueError("give `device_watchdog_s` or `registers.watchdog`, not both")
        return self


class ModbusKeys(Section):
    """The keys of section ``daq`` that only a Modbus device has."""

    modbus: Modbus | None = Field(None, description="driver modbus: how the device is asked, and its register map")


def is_tcp(port: str | None) -> bool:
    """Whether a port speaks Modbus TCP; else RTU."""
    return port is not None and port.startswith((_TCP, _EMULATED_TCP))


def tcp_address(port: str) -> tuple[str, int]:
    """Host and port number of tcp://host or tcp://host:port. Raises ValueError, for people, if it is none."""
    found = urlsplit(port)
    try:
        number = found.port
    except ValueError as error:
        raise ValueError(f"{port}: {error}") from error
    if found.scheme != "tcp" or not found.hostname or found.path not in ("", "/") or number == 0:
        raise ValueError(f"{port} is no address: write tcp://192.168.0.5 or tcp://192.168.0.5:502")
    return found.hostname, TCP_PORT if number is None else number
