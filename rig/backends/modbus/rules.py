"""The rules of a Modbus device's keys: one request each way, no two registers in one place.

And the notes about what such a device cannot report.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from itertools import combinations

from rig.backends.link_budget import BAUD_RATES
from rig.backends.modbus.link_budget import longest_transaction_s, tick_budget
from rig.backends.modbus.registers import Register, RegisterMap
from rig.backends.modbus.section import Modbus, is_tcp, tcp_address
from rig.config.problems import Problem, wrong
from rig.config.schema import DeviceSetup

_MOST_READ = 125  # registers of one reply
_REGISTERS = 65536
_SLACK = 1e-9
_HOST = re.compile(r"\d{1,3}(\.\d{1,3}){3}(:\d+)?")  # as one writes it without tcp://


def modbus_rules(d: DeviceSetup) -> Iterator[Problem]:
    """The rules that only a Modbus device has."""
    yield from _address(d.daq.port or "")
    if d.runs_relay:
        yield wrong(
            "relay.where",
            "`driver: modbus` has no relay in the device",
            "set it to host, or daq.driver to serial with a port",
        )
    modbus = d.daq.modbus
    if modbus is None:
        yield wrong("daq.modbus", "`driver: modbus` needs this section", "see config/modbus-rtu.yaml")
        return
    yield from _map(modbus)
    yield from _times(d, modbus)
    yield from _link_budget(d, modbus)
    if d.tachometer is not None:
        yield wrong("tachometer", "no register of `driver: modbus` holds a velocity", "leave it out")


def modbus_notes(d: DeviceSetup) -> Iterator[str]:
    """What a Modbus device may not report of a pause, in which it is disarmed; and addresses as manuals count them."""
    if d.daq.modbus is None:
        return
    r = d.daq.modbus.registers
    told = RegisterMap.of(d.daq.modbus)
    if words := _as_in_a_manual((*told.written.registers, *told.read.registers, *told.set_when_armed)):
        yield words
    if r.status is None:
        yield (
            "daq.modbus.registers has no status: rig does not see an e-stop that you press and release in a pause; "
            "wire it so that it cuts the motor's supply"
        )
    elif "DEVICE_ESTOP" not in r.status.faults:
        yield (
            "daq.modbus.registers.status.faults names no DEVICE_ESTOP: rig sees an e-stop in a pause only while it is "
            "open, and only if it changes the status; wire it so that it cuts the motor's supply"
        )
    if r.watchdog is None and r.limits is None and r.rails is None and r.max_drive is None:
        yield (
            "daq.modbus.registers has none of watchdog, limits, rails and max_drive, which rig reads back when it arms "
            "the device again: rig would not notice a power cycle in a pause"
        )


def _address(port: str) -> Iterator[Problem]:
    if "://" in port or port.startswith("tcp"):
        try:
            tcp_address(port)
        except ValueError as error:
            yield wrong("daq.port", str(error))
    elif _HOST.fullmatch(port):
        yield wrong("daq.port", f"{port} is an address, not a serial port", f"tcp://{port}")


def _map(m: Modbus) -> Iterator[Problem]:
    told = RegisterMap.of(m)
    written, read, armed = told.written.registers, told.read.registers, told.set_when_armed
    for one in (*written, *read, *armed):
        if one.address + one.words > _REGISTERS:
            yield _register(_key(one), f"{one.words} registers from {one.address} on end beyond the last one, 65535")
    in_holding = told.position.table == "holding"
    yield from _apart([*written, *armed, *(read if in_holding else ())])
    if not in_holding:
        yield from _apart(read)
    if told.written.words > sum(one.words for one in written):
        drive, sequence = written
        yield _register(
            "sequence.address",
            f"{sequence.address} is not beside the drive, {_registers(drive)}: one request writes both",
            f"{drive.address + drive.words}, or {drive.address - 1}",
        )
    first, count = told.read.address, told.read.words
    if count > _MOST_READ:
        farthest = max(read, key=lambda one: abs(one.address - told.position.address))
        yield _register(
            _key(farthest),
            f"a tick would read {count} registers, {first} to {first + count - 1}; one request can read {_MOST_READ}",
            _as_in_a_manual(read) or "move them together, or leave it out",
        )
    if m.requests == "read-write" and not in_holding:
        yield _register(
            "position.table", "FC23 reads holding registers only", "table: holding, or daq.modbus.requests: separate"
        )


def _apart(registers: Iterable[Register]) -> Iterator[Problem]:
    for a, b in combinations(registers, 2):
        if a.address < b.address + b.words and b.address < a.address + a.words:
            lie = "lies" if b.words == 1 else "lie"
            yield _register(_key(b), f"{_registers(b)} {lie} in the place of {_key(a)}, {_registers(a)}")


def _times(d: DeviceSetup, m: Modbus) -> Iterator[Problem]:
    daq = d.daq
    watchdog = m.registers.watchdog
    longest_s = longest_transaction_s(daq, m)
    if daq.timeout_s > d.period_s * (1 + _SLACK):
        yield wrong(
            "daq.timeout_s",
            f"{daq.timeout_s:g} s is longer than the period of {d.period_s:g} s: a reply could come in the next tick",
            f"at most {d.period_s:g} seconds",
        )
    elif daq.timeout_s < longest_s <= d.period_s:  # a longer one is too slow for the period
        yield wrong(
            "daq.timeout_s",
            f"{daq.timeout_s * 1e3:g} ms is shorter than a transaction, {longest_s * 1e3:.2f} ms",
            f"up to {d.period_s:g} seconds",
        )
    if watchdog is None and m.device_watchdog_s is None and not daq.accept_no_watchdog:
        yield wrong(
            "daq.modbus",
            "nothing sets 0 V when the host is silent: the config gives neither the register of the device's output "
            "time-out nor that time",
            "give registers.watchdog; or device_watchdog_s, as set on the device; or daq.accept_no_watchdog: true, and "
            "keep the motor's supply switch in reach",
        )
    elif watchdog is not None:
        units = daq.watchdog_s / watchdog.unit_s
        if not (
            0.5 <= units <= 65535.5 and abs(round(units) * watchdog.unit_s - daq.watchdog_s) <= 0.05 * daq.watchdog_s
        ):
            yield wrong(
                "daq.watchdog_s",
                f"{daq.watchdog_s:g} s is {units:g} units of the watchdog's register, "
                "which takes whole numbers from 1 to 65535",
                "within 5 %, or correct daq.modbus.registers.watchdog.unit_s",
            )


def _link_budget(d: DeviceSetup, m: Modbus) -> Iterator[Problem]:
    if tick_budget(d.daq, m).fits(d.period_s):
        return
    if RegisterMap.of(m).read.words > _MOST_READ:
        return  # refused by its register: no such request can be made, so its time says nothing
    bauds = () if is_tcp(d.daq.port) else BAUD_RATES
    fitting = [f"daq.baud {baud} fits" for baud in bauds if tick_budget(d.daq, m, baud).fits(d.period_s)]
    key = "period_s" if is_tcp(d.daq.port) else "daq.baud"
    yield tick_budget(d.daq, m).too_slow(key, d.period_s, fitting[:1])


def _as_in_a_manual(registers: Iterable[Register]) -> str:
    """What the first address that looks like a manual's, 4xxxx or 3xxxx, is in a map; "" where none does.

    Manuals write the table in front and count from 1 (Modbus application protocol 1.1b3, section 4.4: PDU from 0).
    """
    for register in registers:
        for first, table in ((40001, "holding"), (30001, "input")):
            if first <= register.address < first + 9999:
                at = register.address
                return f"addresses count from 0: {at} in a manual is {table} register {at - first}"
    return ""


def _registers(one: Register) -> str:
    last = one.address + one.words - 1
    return f"register {one.address}" if one.words == 1 else f"registers {one.address} and {last}"


def _key(one: Register) -> str:
    """Its key below ``registers``."""
    return "sequence.echo" if one.name == "echo" else one.name if "." in one.name else f"{one.name}.address"


def _register(key: str, message: str, hint: str = "") -> Problem:
    return wrong(f"daq.modbus.registers.{key}", message, hint)
