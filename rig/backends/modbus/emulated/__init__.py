"""An emulated Modbus I/O block, on an RTU line or on TCP."""
