"""Links to the bench: one small interface (`driver`) and one module for each link."""
