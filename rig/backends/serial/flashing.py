"""What has to be typed to flash the board of a config: every option of `rig flash` that the config tells."""

from __future__ import annotations

import shlex

from rig.backends.serial.ports import CHIP_BAUDS
from rig.config.schema import BRIDGES, Experiment

WRONG_BRIDGE = "with the wrong one 0 V can be full drive"


def flash_line(e: Experiment) -> str:
    """The command for people to type, whole; where the config does not name the bridge, that of each."""
    baud = e.daq.baud if e.daq.baud in CHIP_BAUDS else max(CHIP_BAUDS)
    tachometer = "" if e.tachometer is None else " --tachometer"

    port = shlex.quote(e.daq.port or "PORT")

    def line(bridge: str) -> str:
        return f"rig flash --port {port} --bridge {bridge} --baud {baud}{tachometer}"

    if e.drive.bridge is not None:
        words = line(e.drive.bridge)
    else:
        words = (
            " or ".join(map(line, BRIDGES)) + f", as the inputs of the bridge are labelled (docs/real-bench.md): "
            f"{WRONG_BRIDGE}, and drive.bridge is to name it, too"
        )
    if baud != e.daq.baud:
        words += f"; set daq.baud to {baud}: the firmware does not speak {e.daq.baud}"
    return (
        f"switch the motor's supply off, then type: {words}; add --supply and --end-switches where these are wired, "
        "which the config does not tell"
    )
