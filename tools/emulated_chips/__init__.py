"""The emulated chips behind daq.port: emulated-chip and emulated-pico; what is installed has none of them."""
