"""What leaves rig: the report of a run, a run as one file, the comparison of runs."""
