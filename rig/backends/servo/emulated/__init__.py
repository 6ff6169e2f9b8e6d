"""Emulated servos on a bus, byte-true, in virtual time and behind a pseudo-terminal."""
