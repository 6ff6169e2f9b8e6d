"""`make compare`: how often `rig compare` is wrong of simulated motors: docs/evidence/compare-table.md."""
