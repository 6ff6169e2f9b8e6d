"""Defects put in on purpose, one at a time: each must fail a test (`make mutants`, docs/evidence/mutant-table.md)."""
