"""Motors that are not what the plain model says: a generator of its own, and how `rig identify` does on them."""
