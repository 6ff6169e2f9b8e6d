"""What sits between USB and the line behind a port of this machine, and which one it is: by what it says on USB."""

from __future__ import annotations

import json
from fnmatch import fnmatch
from pathlib import Path
from typing import Any, NamedTuple

from rig.backends.links.usb_adapters import CHIPS, Adapter, adapter_by_id, adapter_delay_s
from rig.core.faults import Fault
from rig.core.signals import plain

LATENCY_MS = 1  # of an FTDI's timer, at its best
_ROOT = Path("/")
_BY_ID = Path("/dev/serial/by-id")
_USB_NAMES = ("/dev/ttyUSB*", "/dev/ttyACM*", "/dev/serial/by-id/usb-*", "/dev/tty.usb*")
_NO_NUMBERS = ("", "1")  # 0001: what each CP210x has as it comes
_LONGEST_NUMBER = 126  # that a string of USB holds


class UsbPort(NamedTuple):
    """A port that was looked at.

    vendor, product   its USB ids; None where it has none
    adapter           what they tell; None where they tell nothing
    timer_ms          of an FTDI, as the kernel writes it; None where it says nothing
    serial_number     that tells this one from others; None where it has none, or one that others of its kind have, too
    location          where it is plugged in, as the system names that; its name may change
    """

    device: str
    vendor: int | None = None
    product: int | None = None
    adapter: Adapter | None = None
    timer_ms: str | None = None
    serial_number: str | None = None
    location: str | None = None

    @property
    def vid_is_known(self) -> bool:
        """Whether it is on USB, and plugged in."""
        return self.vendor is not None

    @property
    def words(self) -> str:
        """Port, USB ids and adapter, for people."""
        if self.vendor is None or self.product is None:
            return f"{self.device}: no USB ids"
        ids = f"{self.device}: USB {self.vendor:04x}:{self.product:04x}"
        if self.adapter is None:
            return f"{ids}, not known here"
        timer = f"; its timer is at {self.timer_ms} ms" if self.adapter == "ftdi" and self.timer_ms is not None else ""
        return f"{ids}, {CHIPS[self.adapter].words}{timer}"


def usb_port(device: str, root: Path = _ROOT) -> UsbPort:
    """Look at a port, by its own name or by one that leads to it (/dev/serial/by-id). ``root`` stands for ``/``.

    Opening a port asks an FTDI to wait for 1 ms only: look at it once it is open.
    """
    from serial.tools import list_ports  # not everywhere can it be loaded

    there = Path(device).resolve().name
    port = next((p for p in list_ports.comports() if Path(p.device).name == there), None)
    if port is None:
        return UsbPort(device)
    adapter = adapter_by_id(port.vid, port.pid)
    timer_ms: str | None = None
    if adapter == "ftdi":
        try:
            file = root / f"sys/bus/usb-serial/devices/{there}/latency_timer"
            timer_ms = file.read_text(encoding="utf-8", errors="replace").strip()
        except OSError:
            timer_ms = None
        if timer_ms == str(LATENCY_MS):
            adapter = "ftdi-1ms"
    place = getattr(port, "location", None)
    return UsbPort(device, port.vid, port.pid, adapter, timer_ms, _number_of(port), place)


def is_usb_name(device: str) -> bool:
    """Whether ports of this name are on USB, as far as a name tells."""
    return any(fnmatch(device, pattern) for pattern in _USB_NAMES)


def check_board(device: str, wanted: str | None, key: str = "daq.usb_serial") -> None:
    """Compare the USB serial number behind a port with the one of the config, before the port is opened.

    wanted  None: the config is for any
    Raises Fault OTHER_BOARD, which says where the right one is, and what ``key`` or the port is to be.
    """
    if wanted is None:
        return
    found = usb_port(device).serial_number
    if found == wanted:
        return
    has = "no serial number" if found is None else f"serial number {plain(found)}"
    there = f"{device} has {has} on USB, and this config is for {wanted}"
    if elsewhere := port_of(wanted):
        raise Fault("OTHER_BOARD", f"{there}, which is at {elsewhere} now: daq.port: {elsewhere}")
    new = "leave it out" if found is None else f"{key}: {json.dumps(found)}"
    raise Fault("OTHER_BOARD", f"{there}, which is not plugged in. If the bench has a new board: {new}")


def port_of(serial_number: str) -> str:
    """The port of this machine with this USB serial number, by its lasting name if it has one; "" for none."""
    from serial.tools import list_ports

    device = next((str(port.device) for port in list_ports.comports() if _number_of(port) == serial_number), "")
    lasting = (str(link) for link in sorted(_BY_ID.glob("*")) if link.resolve() == Path(device))
    return next(lasting, device) if device else ""


def _number_of(port: Any) -> str | None:
    """The serial number of one of pyserial's ports, if it is one, and a config takes it: ``daq.usb_serial``."""
    number = str(getattr(port, "serial_number", None) or "").strip()
    fits = number.isascii() and number.isprintable() and len(number) <= _LONGEST_NUMBER
    return number if fits and number.lstrip("0") not in _NO_NUMBERS else None


def check_adapter(device: str, assumed: Adapter, key: str = "daq.adapter") -> None:
    """Compare the adapter of an open port with the one that rig computes its times for.

    A quicker or an unknown adapter passes.
    Raises Fault CONFIG_MISMATCH, which says what ``key`` is to be.
    """
    found = usb_port(device)
    if found.adapter is None or adapter_delay_s(found.adapter) <= adapter_delay_s(assumed):
        return
    timer = f", or its timer to {LATENCY_MS} ms (`rig doctor` has the line)" if found.adapter == "ftdi" else ""
    raise Fault(
        "CONFIG_MISMATCH",
        f"{found.words}, which is slower than the adapter that rig assumes ({assumed}): set {key} to "
        f"{found.adapter}{timer}, then see what `rig check` says",
    )
