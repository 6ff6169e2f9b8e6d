"""Emulated devices in virtual time, each a ``Transport`` and a ``Clock`` in one, and what may go wrong with them.

The firmware compiled for this machine, the Uno's on its emulated chip, a Modbus I/O block on RTU or TCP.
"""

from rig.backends.emulated.bench import bench_parameters
from rig.backends.modbus.emulated.line_faults import Corruption
from rig.backends.modbus.emulated.reply_faults import ReplyFault
from rig.backends.modbus.emulated.rtu_slave import Disturbance
from rig.backends.modbus.emulated.virtual_io_block import VirtualIoBlock
from rig.backends.modbus.emulated.virtual_tcp_block import VirtualTcpBlock
from rig.backends.modbus.opening import emulated_io_block
from rig.backends.serial.emulated.behind_usb import BehindUsb
from rig.backends.serial.emulated.virtual_board import VirtualBoard
from rig.backends.serial.emulated.virtual_chip import VirtualChip
from rig.backends.serial.opening import emulated_chip

__all__ = [
    "BehindUsb",
    "Corruption",
    "Disturbance",
    "ReplyFault",
    "VirtualBoard",
    "VirtualChip",
    "VirtualIoBlock",
    "VirtualTcpBlock",
    "bench_parameters",
    "emulated_chip",
    "emulated_io_block",
]
