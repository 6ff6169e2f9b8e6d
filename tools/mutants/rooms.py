"""The rooms that are changed at random, and the survivors that no test can tell from the code."""

from __future__ import annotations

from mutants.sampled import Room

SEED = "rig 11"

ROOMS = (
    Room("rig/control", 24, ("tests/control", "tests/loop/test_loop_runner.py", "tests/loop/test_loop_order.py")),
    Room("rig/loop", 12, ("tests/loop", "tests/replay", "tests/hil/test_hil_device_relay.py")),
    Room("rig/daq", 14, ("tests/daq", "tests/hil/test_hil_device_relay.py", "tests/hil/test_hil_driver.py")),
    Room("rig/recording", 10, ("tests/recording",)),
)

# name of a mutant: why what it does is what the code does
EQUIVALENT: dict[str, str] = {}
