"""The parameters of the emulated I/O block's process, already parsed, so that it starts without loading the config."""

from __future__ import annotations

from dataclasses import dataclass

from rig.backends.emulated.line_faults import CorruptionRate
from rig.backends.modbus.emulated.io_block_registers import BlockRegisters
from rig.backends.modbus.emulated.reply_faults import ReplyFault
from rig.backends.modbus.emulated.rtu_slave import LineTimes
from rig.model.bench import BenchParameters


@dataclass(frozen=True)
class Device:
    """The block and its line.

    registers, unit   what is at which address, and its unit id
    bench, seed       what is behind it, and of its noise
    polarity          +1: positive drive raises the position register; -1: lowers it
    line              times of an RTU line; of TCP its turnaround alone counts
    tcp_port          TCP on this port, 0: on a free one; None: RTU
    reply_fault, corruption   of the block, of an RTU line
    """

    registers: BlockRegisters
    unit: int
    bench: BenchParameters
    seed: int
    polarity: int
    line: LineTimes
    tcp_port: int | None = None
    reply_fault: ReplyFault | None = None
    corruption: CorruptionRate | None = None
