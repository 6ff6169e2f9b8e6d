"""`make tune`: loops that are tuned on identified motors, tried on the true ones."""
