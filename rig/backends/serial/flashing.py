"""The `rig flash` command for the board of a config, with every option that the config implies."""

from __future__ import annotations

import shlex

from rig.backends.serial.ports import CHIP_BAUDS, PICO_PORTS, is_emulated
from rig.config.schema import BRIDGES, DeviceSetup

_PICO_COUNTS = 4095  # the Uno's converter has 10 bits
WRONG_BRIDGE = "with the wrong one 0 V can be full drive"


FULL_DUTY = {"uno": 400, "pico": 6250}  # units of the drive, of each board that rig has firmware for


def board_of(d: DeviceSetup) -> str:
    """The board, "uno" or "pico", as far as the config tells: by its converter or its emulated port; else the Uno."""
    return "pico" if d.sensor.counts_max == _PICO_COUNTS or d.daq.port in PICO_PORTS else "uno"


def of_config(d: DeviceSetup) -> dict[str, tuple[str, str | int | bool | None]]:
    """What a config says of the firmware of its board, by option of `rig flash`: the key that says it, and its value.

    None: the config does not say it. Raises ValueError, for people, where the firmware does not speak at its baud rate.
    """
    if d.daq.baud not in CHIP_BAUDS:
        raise ValueError(f"daq.baud is {d.daq.baud}, and the firmware speaks {' or '.join(map(str, CHIP_BAUDS))}")
    encoder = d.sensor.encoder
    told = board_of(d) if encoder is None or d.daq.port in PICO_PORTS else None
    return {
        "board": ("sensor.counts_max", told),
        "port": ("daq.port", None if is_emulated(d) else d.daq.port),
        "usb_serial": ("daq.usb_serial", d.daq.usb_serial),
        "baud": ("daq.baud", d.daq.baud),
        "bridge": ("drive.bridge", d.drive.bridge),
        "tachometer": ("tachometer", d.tachometer is not None),
        "encoder": ("sensor.encoder", encoder is not None),
        "end_switches": ("sensor.encoder.home", True if encoder is not None and encoder.home is not None else None),
    }


def flash_line(d: DeviceSetup) -> str:
    """The whole command, for people. If the config does not name the bridge: one command for each bridge."""
    baud = d.daq.baud if d.daq.baud in CHIP_BAUDS else max(CHIP_BAUDS)
    parts = "" if d.tachometer is None else " --tachometer"
    home = None
    if d.sensor.encoder is not None:
        home = d.sensor.encoder.home
        parts += " --encoder" + ("" if home is None else " --end-switches")
    named = " --board pico" if board_of(d) == "pico" else ""
    port = shlex.quote(d.daq.port or "PORT")
    number = "" if d.daq.usb_serial is None else f" --usb-serial {shlex.quote(d.daq.usb_serial)}"

    def line(bridge: str) -> str:
        return f"rig flash{named} --port {port}{number} --bridge {bridge} --baud {baud}{parts}"

    if d.drive.bridge is not None:
        words = line(d.drive.bridge)
    else:
        words = (
            " or ".join(map(line, BRIDGES)) + f", as the inputs of the bridge are labelled (docs/real-bench.md): "
            f"{WRONG_BRIDGE}; name the same bridge in drive.bridge"
        )
    if baud != d.daq.baud:
        words += f"; set daq.baud to {baud}: the firmware does not speak {d.daq.baud}"
    return (
        f"switch the motor's supply off, then type: {words}; add --supply"
        + (" and --end-switches if these are wired" if home is None else " if it is wired")
        + ": the config does not say"
    )
