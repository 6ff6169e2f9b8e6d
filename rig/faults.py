"""The one table of faults: a code, what it means, what to do.

Any room may import this module; it imports only ``rig.signals``.
"""

from __future__ import annotations

from typing import NamedTuple

from rig.errors import RigError
from rig.signals import plain


class FaultEntry(NamedTuple):
    """One row of the table: the cause in words, and the cure."""

    cause: str
    cure: str


FAULTS: dict[str, FaultEntry] = {
    # link
    "LINK_OPEN": FaultEntry(
        "the port could not be opened",
        "check the cable, the port's name in daq.port (a plug-in's in daq.options), and that no other program holds it",
    ),
    "LINK_LOST": FaultEntry(
        "the port died while in use",
        "check the cable and the device's supply; `rig doctor CONFIG` tries the link without driving; then start the "
        "run "
        "again: a port is never reopened by itself",
    ),
    "LINK_TIMEOUT": FaultEntry(
        "no valid reply within the time-out",
        "check supply, cable, daq.baud, a Modbus device's daq.modbus.unit and daq.modbus.parity, and interference; "
        "`rig check` prints what the link needs; an emulated device shares this machine: try when it is less busy",
    ),
    "LINK_REPLY": FaultEntry(
        "the reply does not fit the request, or is damaged",
        "check cable, shield, termination and daq.baud, and that nothing else talks on this line; "
        "then daq.modbus.registers",
    ),
    "LINK_UNIT": FaultEntry(
        "another unit answered",
        "give each device on the line a unit id of its own, and the right one to daq.modbus.unit",
    ),
    "MODBUS_EXCEPTION": FaultEntry(
        "the device refused a request",
        "read the exception beside this line; correct daq.modbus.registers by the device's manual, "
        "addresses counted from 0",
    ),
    "LINK_GAP": FaultEntry(
        "samples of the relay in the device got lost on the way",
        "check cable and plug, close what else reads the port, or set relay.where to host",
    ),
    "LINK_HELLO": FaultEntry(
        "the device did not introduce itself",
        "flash the firmware (`rig flash`), check daq.port and daq.baud; an Arduino needs two seconds after the port "
        "opens",
    ),
    "LINK_VERSION": FaultEntry(
        "the firmware speaks another version of the protocol",
        "flash the firmware that belongs to this version of rig: type the `rig flash` line that is named here, and "
        "switch the motor's supply on only when the voltages of docs/real-bench.md are there",
    ),
    "LINK_REJECTED": FaultEntry(
        "the device refused a command",
        "read the device's code beside this line; correct limits.hard_rad, sensor.rail_counts, drive.max_V or "
        "daq.watchdog_s, whichever it names",
    ),
    "CONFIG_MISMATCH": FaultEntry(
        "the device is not the one that the config describes",
        "correct the key that is named here, or connect the other device, by daq.port",
    ),
    "NO_WATCHDOG": FaultEntry(
        "the device holds its last drive when the host is silent",
        "use a device with a watchdog, or accept the risk with daq.accept_no_watchdog: true and an e-stop at hand",
    ),
    "LATCHES_NOTHING": FaultEntry(
        "between two runs of one command nobody would see this device's e-stop: it latches none",
        "give `rig run` once for each run, without --repeat",
    ),
    "ARM_READBACK": FaultEntry(
        "the limits read back from the device are not those that were sent",
        "start again; if it persists, flash the firmware (`rig flash`); a Modbus device: correct address and type of "
        "that "
        "register in daq.modbus.registers, or give a value that the device can hold",
    ),
    "DEVICE_RESET": FaultEntry(
        "the device restarted during the run, or is not armed for another reason",
        "check its supply (a motor can pull it down) and wiring, then start the run again; a Modbus device: check that "
        "daq.modbus.registers.status is that register, and name its other values in `faults`",
    ),
    # device, reported by the firmware
    "DEVICE_WATCHDOG": FaultEntry(
        "the device heard nothing from the host within its watchdog time and set 0 V",
        "close programs that load the machine, or raise daq.watchdog_s within what `rig check` allows; in the "
        "breakaway check that time is shorter: `rig check` prints it",
    ),
    "DEVICE_TRAVEL": FaultEntry(
        "the device saw the position beyond the hard limit and set 0 V",
        "bring the shaft inside with `rig jog`, then lower relay.target.amplitude_rad or the speed",
    ),
    "DEVICE_SENSOR": FaultEntry(
        "the device saw the position sensor at its rail and set 0 V",
        "check the wiper's wire and the pull-down; the reading must stay inside sensor.rail_counts",
    ),
    "DEVICE_NOT_ARMED": FaultEntry(
        "the device refused drive because it is not armed",
        "start the run again, which arms it anew; if that persists, see by `rig doctor CONFIG` whether it answers, "
        "and check "
        "its supply",
    ),
    "DEVICE_DRIVE_RANGE": FaultEntry(
        "the device was commanded more drive than it was armed for",
        "lower the drive (relay.gains, relay.search.h_max_V, `rig jog` --u-V), or raise drive.max_V",
    ),
    "DEVICE_ESTOP": FaultEntry(
        "the device's e-stop input is open, and it set 0 V",
        "release the e-stop, then type `rig run CONFIG` again; without one, the input must be wired to ground",
    ),
    "DEVICE_END_SWITCH": FaultEntry(
        "the shaft is at an end switch, or a switch's wire is broken, and the device set 0 V",
        "bring the shaft inside with `rig jog`, then lower relay.target.amplitude_rad; at both ends, check the wires",
    ),
    "DEVICE_RELAY": FaultEntry(
        "the relay in the device decided otherwise than the law does on the same counts",
        "flash the firmware of this rig (`rig flash`); if it is that, report this run, and set relay.where to host "
        "meanwhile",
    ),
    "RELAY_STOPPED": FaultEntry(
        "the relay in the device drove where the guard does not let it",
        "lower relay.target.amplitude_rad or relay.gains, or widen limits.hard_rad; where it ran well before, check "
        "the "
        "motor's wires",
    ),
    # guard
    "TRAVEL_HARD": FaultEntry(
        "the position is beyond the hard travel limit",
        "bring the shaft inside with `rig jog`; lower relay.target.amplitude_rad or limits.max_speed_rad_s",
    ),
    "POLARITY": FaultEntry(
        "the shaft moves against the drive",
        "swap the two motor wires, or the two outer wires of the potentiometer, or change drive.reversed",
    ),
    "SENSOR_RAIL": FaultEntry(
        "the position sensor reads at its rail",
        "check the wiper's wire and the supply of the potentiometer; centre the shaft away from the ends; readings "
        "inside "
        "sensor.rail_counts are good; a Modbus device: check type and scale in daq.modbus.registers.position, and "
        "daq.modbus.word_order",
    ),
    "SENSOR_JUMP": FaultEntry(
        "the position jumped farther than the shaft can move in that time",
        "check for a loose wiper, swapped wires or the potentiometer's dead zone; limits.max_speed_rad_s must be true",
    ),
    "SENSOR_STUCK": FaultEntry(
        "the reading does not do what the drive must make it do: it is frozen or noisy, or the drive is not as told",
        "check the wiper's wire, the coupling of the potentiometer, the motor's wires, its supply and the bridge; "
        "`rig jog CONFIG --u-V VOLTS` shows whether the reading follows the shaft",
    ),
    "SAMPLE_STALE": FaultEntry(
        "readings come, but all of the same instant: the device takes no new samples",
        "power the device off and on; if that comes again flash its firmware anew (`rig flash`), or mend the plug-in "
        "driver's times",
    ),
    "NO_MOTION": FaultEntry(
        "no motion was seen up to the largest breakaway drive",
        "prove the sensor before anything else: supply off, turn the shaft by hand, and see the reading of "
        "`rig jog --u-V 0` follow it (wiper, coupling). Then check the motor's supply, wires and bridge. Only where "
        "all that is well is friction higher than thought: then raise breakaway.max_V, by a fifth at a time",
    ),
    "LATE": FaultEntry(
        "strokes of the breakaway check lasted longer than they may, since ticks came late",
        "close programs that load the machine; `rig doctor CONFIG` shows how late its ticks come and what helps; then "
        "start the run again",
    ),
    "DRIVE_STUCK_ON": FaultEntry(
        "the shaft moves although the drive is at 0 V",
        "cut the motor's supply; check the H-bridge, the enable pull-down, and that `rig flash --bridge` was told the "
        "inputs "
        "that it has. Software cannot stop such a drive",
    ),
    "SENSOR_NOISY": FaultEntry(
        "the position sensor is too noisy to see motion",
        "shield the wiper's wire, check the potentiometer's supply, or raise breakaway.motion_rad",
    ),
    "OVERSPEED": FaultEntry(
        "the shaft is faster than limits.max_speed_rad_s",
        "lower relay.gains or relay.target.amplitude_rad, or raise limits.max_speed_rad_s if `rig check` has room to "
        "stop; "
        "where the drive was 0 V, check the bridge and the sensor",
    ),
    # loop and record
    "RECORDER_DEAD": FaultEntry(
        "the recorder stopped taking rows",
        "check the disk's free space and permissions of the run folder, or name a folder on another disk with `rig "
        "run --out`",
    ),
    "INTERRUPTED": FaultEntry(
        "the run was interrupted",
        "start it again; a relay test that had its cycles can be identified: `rig identify RUN`",
    ),
    "LAW_FAILED": FaultEntry(
        "the law failed, or asked for a drive that is no number",
        "of a law of your own, mend the line that is named here, or that events.jsonl names in its traceback; of rig's "
        "own this is a defect: please report it with the run folder, which `rig export RUN --to run.json` makes one "
        "file",
    ),
    "INTERNAL": FaultEntry(
        "the program failed",
        "this is a defect of rig: please report it with the run folder; what was recorded can be identified: "
        "`rig identify RUN`",
    ),
    "STOP_UNCONFIRMED": FaultEntry(
        "the device did not confirm the stop",
        "its watchdog sets 0 V; cut the motor's supply if the shaft still turns, then check the cable; `rig doctor "
        "CONFIG` "
        "tries it without driving",
    ),
    # experiment
    "NOT_IDENTIFIED": FaultEntry(
        "the record cannot be identified",
        "see the reason beside this line; `rig identify RUN` says more",
    ),
    "NO_CYCLE": FaultEntry(
        "no settled limit cycle within the search's time",
        "raise relay.search.timeout_s or relay.search.h_max_V, or ask for another relay.target",
    ),
    "NOT_HOME": FaultEntry(
        "the shaft could not be brought to rest at zero",
        "check for play, a spring or a load that moves it; turn it near the centre by hand or by `rig jog`, and start "
        "again",
    ),
    "DRIVE_TOO_SMALL": FaultEntry(
        "a hysteretic relay's drive does not move the shaft from rest",
        "raise that d_V in relay.hysteretic above the breakaway level",
    ),
    "NO_SWITCHING": FaultEntry(
        "the hysteretic relay did not switch in time",
        "raise its d_V, or lower its eps_rad, in relay.hysteretic",
    ),
    "START_OUTSIDE": FaultEntry(
        "the shaft stands outside the soft limits",
        "bring it inside with `rig jog` or by hand, then start again",
    ),
}


# what a device may have latched before a command opened it, in few words; of any other its cause
_SINCE_THE_LAST_RUN = {
    "DEVICE_ESTOP": "e-stop pressed",
    "DEVICE_WATCHDOG": "the device's watchdog took the drive off",
    "DEVICE_TRAVEL": "the shaft was beyond a hard limit",
    "DEVICE_SENSOR": "the position sensor was at its rail",
    "DEVICE_END_SWITCH": "an end switch opened",
}


def since_the_last_run(code: str) -> str:
    """What it means that opening a device has cleared this fault, for the person who gave the command."""
    return f"{_SINCE_THE_LAST_RUN.get(code, FAULTS[code].cause)} since the last run: the device had latched {code}"


class Fault(RigError):
    """A latched fault: code, cause, cure, and what was seen here.

    code    a key of ``FAULTS``
    detail  the numbers of this case, e.g. "y = 1.52 rad, hard limit 1.50 rad"; in it may be what a device said
    """

    def __init__(self, code: str, detail: str = "") -> None:
        entry = FAULTS[code]
        self.code = code
        self.cause = entry.cause
        self.cure = entry.cure
        self.detail = detail = plain(detail)
        super().__init__(f"{code}: {entry.cause}" + (f" ({detail})" if detail else ""))

    def as_dict(self) -> dict[str, str]:
        """The fault as ``events.jsonl`` and ``result.json`` hold it."""
        return {"code": self.code, "cause": self.cause, "cure": self.cure, "detail": self.detail}
