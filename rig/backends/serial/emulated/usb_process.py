"""A USB adapter in real time: a process between the port of an emulated device and a pseudo-terminal of its own.

``usb_board`` starts it. It prints ``port NAME`` when it is ready, and ends with the device.
"""

from __future__ import annotations

import argparse
import contextlib
import gc
import math
import os
import select
import sys
import time
from pathlib import Path

from rig.backends.emulated.device_process import ORPHAN_S, fail, linked, open_pty, signals, take_priority
from rig.backends.links.usb_adapters import CHIPS
from rig.backends.serial.emulated.usb_chip import UsbChip

_BYTES = 4096


def main() -> None:
    """Run until a signal, or until standard input ends where that was asked for."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--device", required=True, help="port of the emulated device")
    parser.add_argument("--adapter", required=True, choices=list(CHIPS))
    parser.add_argument("--link", type=Path)
    parser.add_argument("--exit-with-stdin", action="store_true")
    asked = parser.parse_args()
    ends = signals()
    try:
        device = os.open(asked.device, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
        host, name = open_pty()
        with contextlib.ExitStack() as stack:
            if asked.link is not None:
                stack.enter_context(linked(asked.link, name))
            sys.stdout.write(f"port {name}\n")
            sys.stdout.flush()
            take_priority()
            gc.freeze()
            _run(UsbChip(asked.adapter), device, host, ends, watches_stdin=asked.exit_with_stdin)
    except OSError as error:
        fail(str(error))


def _run(chip: UsbChip, device: int, host: int, ends: int, *, watches_stdin: bool) -> None:
    start_s, end_s, stdin = time.monotonic(), math.inf, sys.stdin.fileno()
    now_s = 0.0
    while now_s < end_s:
        files = [ends, device, host, *([stdin] if watches_stdin else [])]
        until_s = min(chip.next_s(), end_s)
        ready = select.select(files, [], [], max(until_s - now_s, 0.0) if math.isfinite(until_s) else None)[0]
        now_s = time.monotonic() - start_s
        if ends in ready:
            return
        if stdin in ready and not os.read(stdin, 64):
            watches_stdin, end_s = False, now_s + ORPHAN_S
        if host in ready:
            chip.from_host(os.read(host, _BYTES), now_s)
        if device in ready:
            chip.from_device(os.read(device, _BYTES), now_s)
        _write(device, chip.for_device(now_s))
        _write(host, chip.for_host(now_s))


def _write(file: int, data: bytes) -> None:
    with contextlib.suppress(BlockingIOError):  # nobody reads
        if data:
            os.write(file, data)


if __name__ == "__main__":
    main()
