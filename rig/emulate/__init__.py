"""Emulated devices: the compiled firmware with a simulated bench behind it."""
