"""Whether several runs are of one motor, and how it changes (docs/compare.md)."""
