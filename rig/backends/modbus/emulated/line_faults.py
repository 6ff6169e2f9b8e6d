"""Random damage to the bytes on a Modbus RTU line."""

from __future__ import annotations

from rig.backends.emulated.line_faults import Corruption as Corruption
from rig.backends.emulated.line_faults import CorruptionRate as CorruptionRate
