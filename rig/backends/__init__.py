"""Devices, one folder each. ``rig.backends.registry`` finds them by ``daq.driver``."""
