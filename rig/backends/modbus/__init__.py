"""A Modbus device, on an RTU line or on TCP."""
