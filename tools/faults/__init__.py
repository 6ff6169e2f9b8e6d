"""The fault matrix: what goes wrong, on every device, at several phases of the limit cycle: docs/fault-table.md."""
