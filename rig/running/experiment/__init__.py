"""The experiment.

script   what each command runs: its stages in order, recorded
stages   each stage, on an open session; a replay runs them, too
survey   the stage of slow sweeps: planned, rehearsed, run
thorough what a thorough run adds where the relay tests leave the motor's law open
"""
