"""The emulated Modbus I/O block in virtual time."""

from __future__ import annotations

import math
from collections.abc import Mapping

from rig.backends.emulated.line_faults import Disturbance
from rig.backends.emulated.virtual_time import InVirtualTime, WireInVirtualTime
from rig.backends.modbus.emulated.io_block import ExecutedDrive, IoBlock, IoBlockTruth
from rig.backends.modbus.emulated.reply_faults import ReplyFault
from rig.backends.modbus.emulated.rtu_slave import LineTimes, RtuSlave
from rig.backends.modbus.section import Modbus
from rig.config.schema import Emulated
from rig.model.bench import DriveWiring, SensorWiring


class BlockInVirtualTime(InVirtualTime):
    """The block of a config, powered on at virtual time 0, and its clock; what leads to it passes the time.

    modbus, emulated  sections of the config
    seed              of the noise
    polarity          +1: positive drive raises the position register; -1: lowers it
    executed          drives that were written, in order
    outputs           (time s, drive at the output V) at each change of it, from (0, 0) on
    Raises EmulationError where a register cannot hold what it is for.
    """

    def __init__(self, modbus: Modbus, emulated: Emulated, seed: int, polarity: int) -> None:
        InVirtualTime.__init__(self)
        self.executed: list[ExecutedDrive] = []
        self.outputs: list[tuple[float, float]] = [(0.0, 0.0)]
        self.block = IoBlock.of(
            modbus,
            emulated,
            seed,
            polarity=polarity,
            on_drive=self.executed.append,
            on_output=lambda t_s, u_V: self.outputs.append((t_s, u_V)),
        )

    def rewire(self, drive: DriveWiring = "ok", sensor: SensorWiring = "ok") -> None:
        """Change the wiring from now on."""
        self.block.rewire(drive=drive, sensor=sensor, fault_after_s=-math.inf)

    def place(self, y_rad: float, v_rad_per_s: float = 0.0) -> None:
        """Put the shaft somewhere, as a hand would."""
        self.block.place(y_rad, v_rad_per_s)

    def power_cycle(self) -> None:
        """Its supply fails for a moment: 0 V, and nothing that was written is left."""
        self.block.power_cycle()

    def truth(self) -> IoBlockTruth:
        """What is really the case now."""
        return self.block.truth()


class VirtualIoBlock(WireInVirtualTime, BlockInVirtualTime):
    """The block behind an RTU line, as a ``Transport`` that is a ``Clock`` too.

    modbus, emulated, seed, polarity   as of ``BlockInVirtualTime``
    baud              of the line
    reply_fault, disturbance   of the device, of the line; may be set at any time
    """

    def __init__(
        self,
        modbus: Modbus,
        emulated: Emulated,
        seed: int = 1,
        *,
        baud: int = 115200,
        polarity: int = 1,
        reply_fault: ReplyFault | None = None,
        disturbance: Disturbance | None = None,
    ) -> None:
        BlockInVirtualTime.__init__(self, modbus, emulated, seed, polarity)
        self.line = LineTimes.of(modbus, baud)
        self._slave = RtuSlave(self.block, self.line, reply_fault, disturbance)
        WireInVirtualTime.__init__(self, self._slave, "virtual I/O block")

    def inject(self, reply_fault: ReplyFault | None) -> None:
        """From now on the replies have this fault; None: no fault."""
        self._slave.reply_fault = reply_fault

    def disturb(self, disturbance: Disturbance | None) -> None:
        """From now on the line has this disturbance; None: none."""
        self._slave.disturbance = disturbance

    @property
    def requests(self) -> Mapping[str, int]:
        """Requests so far: executed, damaged (dropped), of other units (ignored)."""
        return {"executed": self._slave.frames, "damaged": self._slave.damaged, "foreign": self._slave.foreign}
