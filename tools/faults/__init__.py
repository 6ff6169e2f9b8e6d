"""The fault matrix: what goes wrong, on every device, at several phases of the limit cycle.

Its pages are docs/fault-table.md, the summary, and docs/fault-rows.md.
"""
