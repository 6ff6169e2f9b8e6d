"""What goes wrong with emulated devices."""

from __future__ import annotations

from rig.core.errors import RigError


class EmulationError(RigError):
    """Firmware or emulated device could not be built or started; the text says why and what to do."""
