"""Control laws without I/O: each takes a sample in `step` and returns volts. And the guard, which limits them."""
