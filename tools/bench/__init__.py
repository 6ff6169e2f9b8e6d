"""Times as ratios to a peer in the same run: `make bench`, or one of them, `PYTHONPATH=tools python -m bench.tick`."""
