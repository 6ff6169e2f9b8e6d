"""What the bytes of a device go through."""
