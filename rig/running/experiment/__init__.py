"""The experiment.

script   what each command runs: its stages in order, recorded
stages   each stage, on an open session; a replay runs them, too
survey   the stage of slow sweeps: planned, rehearsed, run; and a thorough run, which adds it where the law is open
"""
