"""What keeps an experiment from running on a serial device: port, bridge, adapter, times, a relay in the device."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import PurePosixPath

from rig.backends.link_budget import BAUD_RATES, LINK_SHARE
from rig.backends.links.usb_adapters import Adapter, adapter_delay_s
from rig.backends.serial.flashing import WRONG_BRIDGE
from rig.backends.serial.link_budget import (
    REPLY_SHARE,
    block_share,
    block_sum,
    reading_budget,
    reply_delay_s,
    tick_budget,
)
from rig.backends.serial.ports import CHIP_BAUDS, CHIP_PORTS, EMULATED_PORTS, adapter_of
from rig.config.problems import Problem, wrong
from rig.config.schema import DeviceSetup
from rig.core.signals import percent

_SLACK = 1e-9  # relative


def serial_rules(d: DeviceSetup) -> Iterator[Problem]:
    """The rules that only a serial device has."""
    yield from _keys(d)
    yield from _bridge(d)
    yield from _link_budget(d)
    yield from _reply_time(d)
    if d.runs_relay:
        yield from _device_relay(d)


def _keys(d: DeviceSetup) -> Iterator[Problem]:
    daq = d.daq
    if d.emulated is not None and d.emulated.motor.delay_s is not None and daq.port in EMULATED_PORTS:
        yield wrong("emulated.motor.delay_s", "an emulated board has no such delay", "use driver simulated or modbus")
    if daq.port in CHIP_PORTS and daq.baud not in CHIP_BAUDS:
        yield wrong("daq.baud", f"the board's firmware does not speak {daq.baud} baud", "115200 or 1000000")


def _bridge(d: DeviceSetup) -> Iterator[Problem]:
    """Only the config knows the wiring. rig compares the firmware with it when it opens the port."""
    port = d.daq.port
    if port is None or port.startswith("emulated"):
        return
    if d.drive.bridge is None:
        yield wrong(
            "drive.bridge",
            f"is missing, and a real motor may be behind {port}: it names the inputs of the bridge, and {WRONG_BRIDGE}",
            "pwm-dir where the bridge's label says PWM and DIR, in1-in2 where it says IN1 and IN2 (docs/real-bench.md, "
            "Which bridge); `rig doctor` on this config says which one the firmware is for",
        )


def _fits(d: DeviceSetup, baud: int, adapter: Adapter | None = None) -> bool:
    return tick_budget(d, baud, adapter).fits(d.period_s)


def _quicker_adapter(d: DeviceSetup, fits: Callable[[Adapter], bool]) -> str:
    """The hint to use another adapter, where that would fit; "" where none would."""
    adapter = adapter_of(d)
    if adapter == "ftdi" and fits("ftdi-1ms"):
        device = PurePosixPath(d.daq.port or "").name if (d.daq.port or "").startswith("/dev/tty") else "ttyUSB0"
        timer = (
            f"an FTDI with its latency timer at 1 ms fits: `echo 1 | sudo tee /sys/bus/usb-serial/devices/{device}/"
            "latency_timer`, and daq.adapter: ftdi-1ms"
        )
        return timer if d.daq.adapter is not None else f"set daq.adapter to what `rig doctor` finds there; {timer}"
    if adapter != "none" and d.daq.adapter is None and fits("native-usb"):
        return "set daq.adapter to what `rig doctor` finds there, if it is another"
    return ""


def _link_budget(d: DeviceSetup) -> Iterator[Problem]:
    if _fits(d, d.daq.baud):
        return
    bauds = CHIP_BAUDS if adapter_of(d) == "16u2" or d.daq.port in CHIP_PORTS else BAUD_RATES
    quicker = ""
    for baud in (d.daq.baud, *bauds):
        quicker = _quicker_adapter(d, partial(_fits, d, baud))
        if quicker:
            quicker += "" if baud == d.daq.baud else f", and daq.baud {baud}"
            break
    fitting = [f"daq.baud {baud} fits" for baud in bauds if _fits(d, baud)]
    ways_out = [*([quicker] if quicker else []), *fitting[:1]]
    yield tick_budget(d).too_slow("daq.adapter" if quicker else "daq.baud", d.period_s, ways_out)


def _reply_time(d: DeviceSetup) -> Iterator[Problem]:
    """A run ends after three repeated readings in a row. On a sound link no reading may need repeating."""
    if not _fits(d, d.daq.baud):
        return
    reading = reading_budget(d)
    most_s = REPLY_SHARE * d.daq.timeout_s * (1 + _SLACK)
    if reading.total_s > most_s:
        chip_s = reply_delay_s(d)
        quicker = _quicker_adapter(d, lambda adapter: reading.total_s - chip_s + adapter_delay_s(adapter) <= most_s)
        least_ms = math.ceil(1e4 * reading.total_s / REPLY_SHARE) / 10
        yield wrong(
            "daq.timeout_s",
            f"{1e3 * d.daq.timeout_s:g} ms is too short for a reading: {reading.written}; after two thirds of the "
            "time-out it is asked for again, and three repeated readings in a row end the run",
            f"{least_ms / 1e3:g} seconds and more, or {quicker or 'a higher daq.baud'}",
        )


def _device_relay(d: DeviceSetup) -> Iterator[Problem]:
    if block_share(d.daq.baud) > LINK_SHARE:
        fitting = next(baud for baud in BAUD_RATES if block_share(baud) <= LINK_SHARE)
        yield wrong(
            "daq.baud",
            f"too slow for the samples of a relay in the device: {block_sum(d.daq.baud)}; "
            f"{percent(LINK_SHARE)} may be used",
            f"daq.baud {fitting} fits, or relay.where: host",
        )
    points = d.sensor.points
    (c0, r0), (c1, r1) = points[0], points[-1]
    bend_rad = max(abs(r - r0 - (c - c0) * (r1 - r0) / (c1 - c0)) for c, r in points)
    if bend_rad > 0.5 * d.sensor.curve.lsb_rad:
        yield wrong(
            "sensor.calibration",
            f"bends by {bend_rad / d.sensor.curve.lsb_rad:.1f} counts, but a relay in the device integrates counts",
            "a straight line within half a count, or relay.where: host",
        )
