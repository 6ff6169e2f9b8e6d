"""Whether the device at the port is the one that the config describes."""

from __future__ import annotations

import re
from dataclasses import dataclass

from rig.backends.serial import frames
from rig.backends.serial.frames import Hello
from rig.core.calibration import Scaling
from rig.core.faults import Fault
from rig.core.package import VERSION

_LEAST_FULL_UNITS = 50  # with coarser steps no drive is near the commanded one
_SUPPLY_TOLERANCE = 0.15  # relative: the divider in front of the converter, and a loaded supply


@dataclass(frozen=True)
class Board:
    """The board of a config.

    bridge        the bridge at the board's outputs, a value of ``frames.BRIDGES``; None: not given
    flashing      how to flash it, with the whole command, for people
    runs_strokes  its firmware must run stroke tests: they may be driven in the device
    """

    bridge: str | None = None
    flashing: str = "flash it with the options that its wiring asks for: docs/real-bench.md"
    runs_strokes: bool = False


PLAIN_BOARD = Board()
_OWN_BUILD = re.compile(r"uno (\d\S*)")  # RIG_BUILD of firmware/boards/uno


@dataclass(frozen=True)
class Expected:
    """The device as the config describes it.

    board         the board
    scaling       what its numbers are expected to mean
    emulated      no real motor can be behind it
    """

    board: Board
    scaling: Scaling
    emulated: bool


def other_version(hello: Hello, board: Board) -> str | None:
    """A sentence if the board runs rig's firmware of another version, with what to type; None if it does not.

    It may drive all the same: the protocol has a version of its own, which must be right.
    """
    found = _OWN_BUILD.fullmatch(hello.build_text)
    if found is None or found[1] == VERSION:
        return None
    return f"the board runs the firmware of rig {found[1]}, and this is rig {VERSION}: {board.flashing}"


def check_fit(hello: Hello, expected: Expected) -> None:
    """Raise Fault CONFIG_MISMATCH where config and device do not fit, LINK_HELLO where it is no device at all."""
    if not _LEAST_FULL_UNITS <= hello.drive_full <= 32767:
        raise Fault(
            "LINK_HELLO",
            f"the device reports a full drive of {hello.drive_full} units; it must be {_LEAST_FULL_UNITS} to 32767",
        )
    scaling = expected.scaling
    _check_sensor(hello, expected)
    if scaling.tachometer is not None and not hello.features & frames.FEATURE_TACHOMETER:
        raise Fault("CONFIG_MISMATCH", "the config has a section `tachometer`, but the device has no such channel")
    _check_bridge(hello, expected)
    if expected.board.runs_strokes and not hello.features & frames.FEATURE_STROKES:
        raise Fault(
            "CONFIG_MISMATCH",
            f"relay.where is device, and relay.until drives strokes there, too, but the device's firmware, "
            f"{hello.build_text}, cannot: {expected.board.flashing}; or set relay.where to host",
        )


def _check_sensor(hello: Hello, expected: Expected) -> None:
    scaling, flashing = expected.scaling, expected.board.flashing
    counts_an_encoder = bool(hello.features & frames.FEATURE_ENCODER)
    if scaling.is_encoder != counts_an_encoder:
        has, believed = ("an encoder", "a potentiometer") if counts_an_encoder else ("a potentiometer", "an encoder")
        raise Fault(
            "CONFIG_MISMATCH",
            f"section `sensor` describes {believed}, but the device's firmware is for {has}: {flashing}",
        )
    if counts_an_encoder:
        return
    if scaling.counts_max is not None and hello.counts_max != scaling.counts_max:
        raise Fault(
            "CONFIG_MISMATCH",
            f"sensor.counts_max is {scaling.counts_max}, but the device reads 0 to {hello.counts_max}: "
            "calibrate with this device",
        )
    low, high = scaling.rail_counts
    if not 0 <= low < high <= hello.counts_max:
        raise Fault(
            "CONFIG_MISMATCH",
            f"sensor.rail_counts {low}, {high} must lie within the device's 0 to {hello.counts_max}",
        )


def _check_bridge(hello: Hello, expected: Expected) -> None:
    """With the wrong bridge 0 V can be full drive: so the config must name the bridge that is wired."""
    bridge, believed = frames.BRIDGES.get(hello.bridge), expected.board.bridge
    flashing = expected.board.flashing
    emulated = expected.emulated or hello.board in frames.EMULATED_BOARDS
    if bridge == believed or (believed is None and emulated) or (hello.bridge == 0 and emulated):
        return
    if hello.bridge == 0:
        raise Fault(
            "CONFIG_MISMATCH",
            f"drive.bridge is {believed}, but the device's firmware does not say which bridge it is for, and "
            f"with the wrong one 0 V can be full drive: {flashing}",
        )
    if bridge is None:
        raise Fault(
            "CONFIG_MISMATCH", f"the device drives a bridge of kind {hello.bridge}, which this rig does not know"
        )
    if believed is None:
        raise Fault(
            "CONFIG_MISMATCH",
            f"drive.bridge is missing, and the device's firmware is for {bridge}: switch the motor's supply off, check "
            f"that the bridge is wired so (docs/real-bench.md), then write bridge: {bridge}",
        )
    raise Fault(
        "CONFIG_MISMATCH",
        f"drive.bridge is {believed}, but the device's firmware is for {bridge}, and 0 V can be full drive: {flashing}",
    )


def measured_supply_V(now: Hello, believed_V: float) -> tuple[float, bool]:
    """The motor supply as the device measures it, V; whether it may be higher.

    Raises Fault CONFIG_MISMATCH where it differs much from the config's. A small difference the run reports.
    """
    measured_V = frames.SUPPLY_UNIT_V * now.supply
    at_least = now.supply >= frames.SUPPLY_FULL
    off_V = measured_V - believed_V
    if (max(off_V, 0.0) if at_least else abs(off_V)) > _SUPPLY_TOLERANCE * believed_V:
        raise Fault(
            "CONFIG_MISMATCH",
            f"the device measures a motor supply of {'at least ' if at_least else ''}{measured_V:.1f} V, "
            f"drive.supply_V is {believed_V:g} V: switch it on, or correct the config",
        )
    return measured_V, at_least
