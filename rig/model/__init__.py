"""What is true of motors, with no I/O."""
