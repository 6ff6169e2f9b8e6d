"""`make emps`: a real drive, the field's benchmark EMPS, identified beside its published numbers: docs/emps.md."""
