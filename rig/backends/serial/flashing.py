"""The `rig flash` command for the board of a config, with every option that the config implies."""

from __future__ import annotations

import shlex

from rig.backends.serial.ports import CHIP_BAUDS, PICO_PORTS, is_emulated
from rig.config.schema import BRIDGES, Experiment

_PICO_COUNTS = 4095  # the Uno's converter has 10 bits
WRONG_BRIDGE = "with the wrong one 0 V can be full drive"


FULL_DUTY = {"uno": 400, "pico": 6250}  # units of the drive, of each board that rig has firmware for


def board_of(e: Experiment) -> str:
    """The board, "uno" or "pico", as far as the config tells: by its converter or its emulated port; else the Uno."""
    return "pico" if e.sensor.counts_max == _PICO_COUNTS or e.daq.port in PICO_PORTS else "uno"


def of_config(e: Experiment) -> dict[str, tuple[str, str | int | bool | None]]:
    """What a config says of the firmware of its board, by option of `rig flash`: the key that says it, and its value.

    None: the config does not say it. Raises ValueError, for people, where the firmware does not speak at its baud rate.
    """
    if e.daq.baud not in CHIP_BAUDS:
        raise ValueError(f"daq.baud is {e.daq.baud}, and the firmware speaks {' or '.join(map(str, CHIP_BAUDS))}")
    encoder = e.sensor.encoder
    told = board_of(e) if encoder is None or e.daq.port in PICO_PORTS else None
    return {
        "board": ("sensor.counts_max", told),
        "port": ("daq.port", None if is_emulated(e) else e.daq.port),
        "usb_serial": ("daq.usb_serial", e.daq.usb_serial),
        "baud": ("daq.baud", e.daq.baud),
        "bridge": ("drive.bridge", e.drive.bridge),
        "tachometer": ("tachometer", e.tachometer is not None),
        "encoder": ("sensor.encoder", encoder is not None),
        "end_switches": ("sensor.encoder.home", True if encoder is not None and encoder.home is not None else None),
    }


def flash_line(e: Experiment, board: str | None = None) -> str:
    """The whole command, for people. If the config does not name the bridge: one command for each bridge.

    board  "uno" or "pico"; None: as far as the config tells, by its converter or its emulated port
    """
    baud = e.daq.baud if e.daq.baud in CHIP_BAUDS else max(CHIP_BAUDS)
    parts = "" if e.tachometer is None else " --tachometer"
    home = None
    if e.sensor.encoder is not None:
        home = e.sensor.encoder.home
        parts += " --encoder" + ("" if home is None else " --end-switches")
    named = " --board pico" if (board or board_of(e)) == "pico" else ""
    port = shlex.quote(e.daq.port or "PORT")
    number = "" if e.daq.usb_serial is None else f" --usb-serial {shlex.quote(e.daq.usb_serial)}"

    def line(bridge: str) -> str:
        return f"rig flash{named} --port {port}{number} --bridge {bridge} --baud {baud}{parts}"

    if e.drive.bridge is not None:
        words = line(e.drive.bridge)
    else:
        words = (
            " or ".join(map(line, BRIDGES)) + f", as the inputs of the bridge are labelled (docs/real-bench.md): "
            f"{WRONG_BRIDGE}; name the same bridge in drive.bridge"
        )
    if baud != e.daq.baud:
        words += f"; set daq.baud to {baud}: the firmware does not speak {e.daq.baud}"
    return (
        f"switch the motor's supply off, then type: {words}; add --supply"
        + (" and --end-switches if these are wired" if home is None else " if it is wired")
        + ": the config does not say"
    )
