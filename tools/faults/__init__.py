"""Fault injection: every fault on every emulated device, at several phases of the limit cycle.

Its pages are docs/evidence/fault-table.md, the summary, and docs/evidence/fault-rows.md.
"""
