"""The old name of ``rig.testing.conformance``."""

from rig.testing.conformance import suite

__all__ = ["suite"]
