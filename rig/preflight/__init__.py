"""Whether an experiment may be run, and what it would do: no device is touched."""

from rig.preflight.file import check
from rig.preflight.plan import notes
from rig.preflight.rehearsal import DataSheet, SheetError, rehearsed
from rig.preflight.rules import Preflight, preflight

__all__ = ["DataSheet", "Preflight", "SheetError", "check", "notes", "preflight", "rehearsed"]
