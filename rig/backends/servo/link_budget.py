"""What one tick of a servo needs on its bus: a read, and a write that is confirmed."""

from __future__ import annotations

from rig.backends.link_budget import LINK_SHARE, LinkBudget
from rig.backends.links.usb_adapters import Adapter, adapter_by_name, adapter_delay_s
from rig.backends.registers.link_budget import Transaction, serial_budget, turnaround_term
from rig.backends.servo.registers import servo_map
from rig.backends.servo.section import EMULATED_PORTS, Servo
from rig.config.schema import Daq

BITS_PER_BYTE = 10  # start, 8 data, stop
TURNAROUND_S = 0.0001  # until its reply begins, without its return delay; assumed, no manual says it
DITHER_S = 0.001  # of a servo that tells no clock: it is asked at another place within its step each time
_REQUEST_BYTES = {"dynamixel": 10, "feetech": 6}  # without parameters
_REPLY_BYTES = {"dynamixel": 11, "feetech": 6}
_ADDRESS_BYTES = {"dynamixel": 2, "feetech": 1}


def adapter_of(daq: Daq, servo: Servo) -> Adapter:
    """The USB adapter: from the config, else from the port's name. `/dev/ttyACM0` is a chip with USB of its own."""
    port = daq.port or ""
    if servo.adapter is not None:
        return servo.adapter
    if port in EMULATED_PORTS:
        return "none"
    found = adapter_by_name(port)
    return "native-usb" if found == "16u2" else found


def transactions(servo: Servo) -> tuple[Transaction, Transaction]:
    """What is asked in one tick."""
    table = servo.table
    kind, found = table.protocol, servo_map(table)
    request, reply, address = _REQUEST_BYTES[kind], _REPLY_BYTES[kind], _ADDRESS_BYTES[kind]
    return (
        Transaction("read", request + 2 * address, reply + found.read.words),
        Transaction("write", request + address + found.written.words, reply),
    )


def tick_budget(daq: Daq, servo: Servo, baud: int | None = None) -> LinkBudget:
    """What one tick needs.

    baud   instead of the config's, to see which would do
    """
    return _sum(daq, servo, daq.baud if baud is None else baud, transactions(servo))


def longest_return_delay_s(daq: Daq, servo: Servo, period_s: float) -> float:
    """The return delay that a servo may keep: what the tick's link still has room for, behind each request, s."""
    asked = transactions(servo)
    spare_s = LINK_SHARE * period_s - _sum(daq, servo, daq.baud, asked).total_s
    return max(spare_s / len(asked), 0.0)


def reading_budget(daq: Daq, servo: Servo) -> LinkBudget:
    """What one reading of a servo that is not armed needs."""
    return _sum(daq, servo, daq.baud, transactions(servo)[:1])


def _sum(daq: Daq, servo: Servo, baud: int, asked: tuple[Transaction, ...]) -> LinkBudget:
    others = [turnaround_term(len(asked), TURNAROUND_S)]
    if "tick" not in servo.table.roles:
        others.append(("up to one step of the servo", DITHER_S))
    delay_s = adapter_delay_s(adapter_of(daq, servo))
    if delay_s > 0.0:
        others.append(("USB adapter", len(asked) * delay_s))
    return serial_budget(asked, BITS_PER_BYTE, baud, *others)
