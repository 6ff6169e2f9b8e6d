"""`make compare`: how often `rig compare` is wrong of simulated motors, and what it finds: docs/compare-table.md."""
