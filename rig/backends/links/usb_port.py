"""What sits between USB and the line behind a port of this machine: by its USB ids, and an FTDI's timer."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

from rig.backends.links.usb_adapters import CHIPS, Adapter, adapter_by_id, adapter_delay_s
from rig.faults import Fault

LATENCY_MS = 1  # of an FTDI's timer, at its best
_ROOT = Path("/")


class UsbPort(NamedTuple):
    """A port that was looked at.

    vendor, product   its USB ids; None where it has none
    adapter           what they tell; None where they tell nothing
    timer_ms          of an FTDI, as the kernel writes it; None where it says nothing
    """

    device: str
    vendor: int | None = None
    product: int | None = None
    adapter: Adapter | None = None
    timer_ms: str | None = None

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
    return UsbPort(device, port.vid, port.pid, adapter, timer_ms)


def check_adapter(device: str, assumed: Adapter, key: str = "daq.adapter", root: Path = _ROOT) -> None:
    """Compare the adapter of an open port with the one that rig computes its times for.

    A quicker or an unknown adapter passes.
    Raises Fault CONFIG_MISMATCH, which says what ``key`` is to be.
    """
    found = usb_port(device, root)
    if found.adapter is None or adapter_delay_s(found.adapter) <= adapter_delay_s(assumed):
        return
    timer = f", or its timer to {LATENCY_MS} ms (`rig doctor` has the line)" if found.adapter == "ftdi" else ""
    raise Fault(
        "CONFIG_MISMATCH",
        f"{found.words}, which is slower than the adapter that rig assumes ({assumed}): set {key} to "
        f"{found.adapter}{timer}, then see what `rig check` says",
    )
