"""What the steps compute: from readings to values of the config, or to the reason why not. No device, no question."""
