"""Smart serial servos: Dynamixel X and MX with protocol 2, Feetech STS."""
