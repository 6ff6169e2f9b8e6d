"""What one tick of a Modbus device needs: its transactions, the silences around them, and its own time.

Application Protocol 1.1b3, section 6 (lengths of requests and replies); over Serial Line 1.02, section 2.5.1 (silence
of 3.5 characters, fixed at 1.75 ms above 19200 baud).
"""

from __future__ import annotations

from rig.backends.link_budget import LinkBudget, added
from rig.backends.modbus.registers import RegisterMap
from rig.backends.modbus.section import Modbus, is_tcp
from rig.backends.registers.link_budget import Transaction, frames_of, serial_budget, turnaround_term
from rig.config.schema import Daq

_RTU_BYTES = 1 + 2  # unit and CRC, around the function code and its data
_TCP_BYTES = 7  # the header, unit included
_ETHERNET_BITS_S = 10e6  # the slowest that I/O modules have
_SILENCE_CHARACTERS = 3.5
_FIXED_SILENCE_S = 0.00175
_FIXED_ABOVE_BAUD = 19200


def tick_budget(daq: Daq, modbus: Modbus, baud: int | None = None) -> LinkBudget:
    """What one tick needs.

    baud   instead of the config's, to see which would do
    """
    tcp = is_tcp(daq.port)
    return _sum(modbus, daq.baud if baud is None else baud, tcp, transactions(modbus, tcp=tcp))


def reading_budget(daq: Daq, modbus: Modbus) -> LinkBudget:
    """What one reading of a device that is not armed needs, until its reply is there.

    The silence after the reply is not in it: only a request that follows waits for that.
    """
    tcp = is_tcp(daq.port)
    return _sum(modbus, daq.baud, tcp, (_reading(modbus, tcp=tcp),), silences=1)


def longest_transaction_s(daq: Daq, modbus: Modbus) -> float:
    """The longest of the tick's transactions, s."""
    tcp = is_tcp(daq.port)
    return max(_sum(modbus, daq.baud, tcp, (t,)).total_s for t in transactions(modbus, tcp=tcp))


def transactions(modbus: Modbus, *, tcp: bool) -> tuple[Transaction, ...]:
    """What is asked in one tick."""
    reading = _reading(modbus, tcp=tcp)
    written = RegisterMap.of(modbus).written.words
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
    read = RegisterMap.of(modbus).read.words
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


def _sum(
    modbus: Modbus, baud: int, tcp: bool, asked: tuple[Transaction, ...], silences: int | None = None
) -> LinkBudget:
    """Of transactions; ``silences``: two for each, unless told."""
    n = len(asked)
    turnaround = turnaround_term(n, modbus.turnaround_s)
    if tcp:
        frames = frames_of(asked)
        total = sum(frames.values())
        words = f"{added(frames)} = {total} bytes x 8 bits / {_ETHERNET_BITS_S / 1e6:g} Mbit/s"
        return LinkBudget((("wire", total * 8 / _ETHERNET_BITS_S), turnaround), words)
    count = 2 * n if silences is None else silences
    silence = ("1 silence" if count == 1 else f"{count} silences", count * silence_s(modbus, baud))
    return serial_budget(asked, bits_per_byte(modbus), baud, silence, turnaround)
