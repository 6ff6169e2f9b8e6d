"""What one tick needs of the link: bytes on the wire, silences, turnaround; and which part of the period it may take.

Beside it what a reading alone needs: that is what can be measured of a device that is not armed.

Serial: the frames of docs/wire.md, and what the USB adapter adds (``serial.usb_adapters``). Modbus: Application
Protocol 1.1b3, section 6 (lengths of requests and replies); over Serial Line 1.02, section 2.5.1 (silence of 3.5
characters, fixed at 1.75 ms above 19200 baud).
"""

from __future__ import annotations

from typing import NamedTuple

from rig.backends.backend import adapter_of
from rig.backends.modbus.section import Modbus, is_tcp, read_in_a_tick, span_of, written_in_a_tick
from rig.backends.serial.usb_adapters import CHIPS, FRAME_S, Adapter, adapter_delay_s
from rig.config.schema import Experiment

LINK_SHARE = 0.8  # of the period that the exchange may take; measured, the whole tick
REPLY_SHARE = 2 / 3  # of daq.timeout_s, after which the serial driver asks for a reading again
BAUD_RATES = (9600, 19200, 38400, 57600, 115200, 230400, 250000, 460800, 500000, 921600, 1_000_000, 2_000_000)

# Wire format version 2: bytes of the body of each frame of one tick (host asks, device tells, host drives)
_BODY_BYTES = {"READ": 0, "STATE": 24, "DRIVE": 2}
# around each body: version, type, seq (4), CRC (2), COBS (1), delimiter (1)
_FRAME_BYTES = 4 + 2 + 1 + 1
_BITS_PER_BYTE = 11  # start, 8 data, stop, and the pause that is seen between bytes
_TURNAROUND_S = 0.001  # the device's 1 ms tick
_STAMPS_S = 1e-4  # a device's own times: a conversion (0.11 ms), a period of the PWM (0.05 ms), an interrupt
_ROUNDED_S = 1e-6  # in the record

# A relay in the device: every 10 of its 1 ms ticks a BLOCK of 10 (reading, drive) comes unasked
_BLOCK_BYTES = 18 + 10 * 4 + _FRAME_BYTES
_BLOCK_S = 0.010

_RTU_BYTES = 1 + 2  # unit and CRC, around the function code and its data
_TCP_BYTES = 7  # the header, unit included
_ETHERNET_BITS_S = 10e6  # the slowest that I/O modules have
_SILENCE_CHARACTERS = 3.5
_FIXED_SILENCE_S = 0.00175
_FIXED_ABOVE_BAUD = 19200


class Transaction(NamedTuple):
    """One request and its reply: bytes of both, framing included."""

    name: str
    request_bytes: int
    reply_bytes: int


class LinkBudget(NamedTuple):
    """The sum of one tick.

    terms    words and seconds; none where the link of the driver is not known
    wire     how the first term comes about, in words
    """

    terms: tuple[tuple[str, float], ...]
    wire: str

    @property
    def total_s(self) -> float:
        """The whole exchange of a tick, s."""
        return sum(s for _, s in self.terms)

    @property
    def written(self) -> str:
        """The sum, for people."""
        (_, wire_s), *others = self.terms
        rest = " ".join(f"+ {_milliseconds(s)} ms {words}" for words, s in others)
        return f"{self.wire} = {wire_s * 1e3:.2f} ms, {rest} = {self.total_s * 1e3:.2f} ms"


def link_budget(experiment: Experiment, baud: int | None = None, adapter: Adapter | None = None) -> LinkBudget:
    """What one tick of this experiment needs; without terms where there is no link, or none that is known.

    baud, adapter   instead of the config's, to see which would do
    """
    daq = experiment.daq
    baud = daq.baud if baud is None else baud
    if daq.driver == "serial":
        return _serial(tuple(_BODY_BYTES), baud, adapter_of(experiment) if adapter is None else adapter)
    if daq.driver == "modbus" and daq.modbus is not None:
        return _modbus(daq.modbus, baud, is_tcp(daq.port), transactions(daq.modbus, tcp=is_tcp(daq.port)))
    return LinkBudget((), "")


def reading_budget(experiment: Experiment) -> LinkBudget:
    """What one reading of a device that is not armed needs, until its reply is there; without terms as ``link_budget``.

    The silence after the reply is not in it: only a request that follows waits for that.
    """
    daq = experiment.daq
    if daq.driver == "serial":
        return _serial(("READ", "STATE"), daq.baud, adapter_of(experiment))
    if daq.driver == "modbus" and daq.modbus is not None:
        tcp = is_tcp(daq.port)
        return _modbus(daq.modbus, daq.baud, tcp, (_reading(daq.modbus, tcp=tcp),), silences=1)
    return LinkBudget((), "")


def link_sum(experiment: Experiment) -> str:
    """The sum of one tick and what it may come to, for people; of a link that is known."""
    period_s = experiment.period_s
    return (
        f"{link_budget(experiment).written}; {LINK_SHARE:.0%} of the period is {LINK_SHARE * period_s * 1e3:.2f} ms, "
        "the rest the host's: to wake, decide and record"
    )


def sample_to_drive_s(experiment: Experiment) -> float:
    """From a sample to the drive that answers it, at most, s: of a serial device whose exchange fits; else 0.

    The reply's way to the host, the drive's way back, and a tick of the device. The host's own part is in none of it.
    """
    if experiment.daq.driver != "serial":
        return 0.0
    asking_s = (_BODY_BYTES["READ"] + _FRAME_BYTES) * _BITS_PER_BYTE / experiment.daq.baud
    return link_budget(experiment).total_s - asking_s


def link_adapter_s(experiment: Experiment) -> float:
    """By how much the adapter makes an exchange longer, at most, s; 0 without one."""
    return adapter_delay_s(adapter_of(experiment))


def times_error_s(experiment: Experiment) -> float:
    """By how much the recorded time of a drive may be wrong against that of a sample, s.

    A serial device stamps both itself. A Modbus device tells no time: both are reckoned, and where within its
    turnaround it takes the one and does the other it does not say.
    """
    daq = experiment.daq
    if daq.driver == "simulated":
        return _ROUNDED_S
    return _STAMPS_S + (0.5 * daq.modbus.turnaround_s if daq.modbus is not None else 0.0)


def block_share(baud: int) -> float:
    """Share of the time for which the samples of a relay in the device are on the wire."""
    return _BLOCK_BYTES * _BITS_PER_BYTE / baud / _BLOCK_S


def block_sum(experiment: Experiment) -> str:
    """How long a block of these samples is on the wire, for people."""
    baud = experiment.daq.baud
    wire_ms, every_ms = 1e3 * block_share(baud) * _BLOCK_S, 1e3 * _BLOCK_S
    return (
        f"BLOCK {_BLOCK_BYTES} bytes x {_BITS_PER_BYTE} bits / {baud} baud = {wire_ms:.2f} ms of every {every_ms:g} ms"
    )


def longest_transaction_s(experiment: Experiment) -> float:
    """The longest of the tick's Modbus transactions, s; 0 for other drivers."""
    daq = experiment.daq
    if daq.driver != "modbus" or daq.modbus is None:
        return 0.0
    tcp = is_tcp(daq.port)
    return max(_modbus(daq.modbus, daq.baud, tcp, (t,)).total_s for t in transactions(daq.modbus, tcp=tcp))


def transactions(modbus: Modbus, *, tcp: bool) -> tuple[Transaction, ...]:
    """What is asked in one tick."""
    reading = _reading(modbus, tcp=tcp)
    _, written = span_of(written_in_a_tick(modbus.registers))
    frame = _TCP_BYTES if tcp else _RTU_BYTES
    if modbus.requests == "read-write":
        return (Transaction("FC23", frame + 10 + 2 * written, reading.reply_bytes),)
    one = written == 1
    return (
        reading,
        Transaction("FC06" if one else "FC16", frame + (5 if one else 6 + 2 * written), frame + 5),
    )


def _reading(modbus: Modbus, *, tcp: bool) -> Transaction:
    """What asks for the position and what stands beside it."""
    _, read = span_of(read_in_a_tick(modbus.registers))
    frame = _TCP_BYTES if tcp else _RTU_BYTES
    name = "FC04" if modbus.registers.position.table == "input" else "FC03"
    return Transaction(name, frame + 5, frame + 2 + 2 * read)


def bits_per_byte(modbus: Modbus) -> int:
    """On an RTU line: start, 8 data, parity, stop."""
    return 1 + 8 + (modbus.parity != "none") + modbus.stop_bits


def silence_s(modbus: Modbus, baud: int) -> float:
    """The pause around a frame on an RTU line, s."""
    if modbus.silence_s is not None:
        return modbus.silence_s
    if baud > _FIXED_ABOVE_BAUD:
        return _FIXED_SILENCE_S
    return _SILENCE_CHARACTERS * bits_per_byte(modbus) / baud


def _serial(kinds: tuple[str, ...], baud: int, adapter: Adapter) -> LinkBudget:
    """The sum of frames of these kinds."""
    frames = {name: _BODY_BYTES[name] + _FRAME_BYTES for name in kinds}
    terms = [_wire(frames, _BITS_PER_BYTE, baud), ("turnaround", _TURNAROUND_S)]
    chip = CHIPS.get(adapter)
    if chip is not None:
        terms += [("USB frames", 2.0 * FRAME_S), (f"{adapter} adapter", chip.wait_s)]
    return LinkBudget(tuple(terms), _words(frames, baud))


def _modbus(
    modbus: Modbus, baud: int, tcp: bool, asked: tuple[Transaction, ...], silences: int | None = None
) -> LinkBudget:
    """The sum of transactions; ``silences``: two for each, unless told."""
    frames: dict[str, int] = {}
    for t in asked:
        frames |= {f"{t.name} request": t.request_bytes, f"{t.name} reply": t.reply_bytes}
    n = len(asked)
    turnaround = ("turnaround" if n == 1 else f"{n} turnarounds", n * modbus.turnaround_s)
    if tcp:
        total = sum(frames.values())
        words = f"{_added(frames)} = {total} bytes x 8 bits / {_ETHERNET_BITS_S / 1e6:g} Mbit/s"
        return LinkBudget((("wire", total * 8 / _ETHERNET_BITS_S), turnaround), words)
    bits = bits_per_byte(modbus)
    count = 2 * n if silences is None else silences
    silence = ("1 silence" if count == 1 else f"{count} silences", count * silence_s(modbus, baud))
    return LinkBudget((_wire(frames, bits, baud), silence, turnaround), _words(frames, baud, bits))


def _wire(frames: dict[str, int], bits: int, baud: int) -> tuple[str, float]:
    return "wire", sum(frames.values()) * bits / baud


def _words(frames: dict[str, int], baud: int, bits: int = _BITS_PER_BYTE) -> str:
    return f"{_added(frames)} = {sum(frames.values())} bytes x {bits} bits / {baud} baud"


def _added(frames: dict[str, int]) -> str:
    return " + ".join(f"{name} {count}" for name, count in frames.items())


def _milliseconds(s: float) -> str:
    """With as many digits as it has, two at most."""
    return f"{round(s * 1e3, 2):g}"
