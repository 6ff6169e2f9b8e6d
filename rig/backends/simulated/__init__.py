"""The motor on this machine, in virtual time: no device."""
