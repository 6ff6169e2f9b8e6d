"""`make emps`: the benchmark EMPS, a real drive, beside its published numbers: docs/evidence/emps.md."""
