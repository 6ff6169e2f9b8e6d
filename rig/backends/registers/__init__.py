"""What devices on a register bus share: Modbus and smart servos."""
