"""The safety promises of the Uno's firmware, measured at the pins of its emulated chip: docs/safety-table.md."""
