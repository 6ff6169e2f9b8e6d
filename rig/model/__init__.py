"""Models of the motor and of the bench around it. Nothing here reads or writes a file or a device."""
