"""The safety promises of the Uno's firmware, measured at its emulated pins: docs/evidence/safety-table.md."""
