"""Emulated devices in virtual time, each a ``Transport`` and a ``Clock`` in one, and their faults.

The devices: the firmware compiled for this machine, a Modbus I/O block on RTU or TCP,
 and smart servos on a bus.
"""

from rig.backends.emulated.bench_of_config import bench_parameters as bench_parameters
from rig.backends.emulated.line_faults import Corruption as Corruption
from rig.backends.emulated.line_faults import Disturbance as Disturbance
from rig.backends.modbus.emulated.reply_faults import ReplyFault as ReplyFault
from rig.backends.modbus.emulated.virtual_io_block import VirtualIoBlock as VirtualIoBlock
from rig.backends.modbus.emulated.virtual_tcp_block import VirtualTcpBlock as VirtualTcpBlock
from rig.backends.modbus.opening import emulated_io_block as emulated_io_block
from rig.backends.serial.emulated.behind_usb import BehindUsb as BehindUsb
from rig.backends.serial.emulated.virtual_board import VirtualBoard as VirtualBoard
from rig.backends.servo.emulated.virtual_bus import VirtualServoBus as VirtualServoBus
from rig.backends.servo.line import emulated_bus as emulated_bus
