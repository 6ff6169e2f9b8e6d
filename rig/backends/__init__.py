"""Devices: one folder each, with all that is true of it. ``rig.backends.registry`` finds them by ``daq.driver``."""
