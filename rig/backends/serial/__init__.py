"""A device with rig's firmware on a serial port."""
