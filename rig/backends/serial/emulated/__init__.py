"""Emulated devices with rig's firmware, compiled for this machine or on the Uno's emulated chip."""
