"""Whether an experiment may be run, and what it would do: no device is touched."""

from rig.running.preflight.plan import notes
from rig.running.preflight.rehearsal import DataSheet, SheetError, rehearsed
from rig.running.preflight.rules import Preflight, check, preflight

__all__ = ["DataSheet", "Preflight", "SheetError", "check", "notes", "preflight", "rehearsed"]
