"""What emulated devices have in common."""
