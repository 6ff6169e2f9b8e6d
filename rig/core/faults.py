"""The one table of faults: a code, what it means, what to do.

Any room may import this module; it imports only ``rig.core.signals``.
"""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import NamedTuple

from rig.core.errors import RigError
from rig.core.signals import plain


class FaultEntry(NamedTuple):
    """One row of the table: the cause in words, and the cure; of some drivers with a sentence more."""

    cause: str
    cure: str
    also: Mapping[str, str] = MappingProxyType({})

    def cure_with(self, driver: str = "") -> str:
        """The cure for a device of this driver; empty: of any."""
        more = self.also.values() if not driver else filter(None, [self.also.get(driver)])
        return ". ".join((self.cure, *more))


FAULTS: dict[str, FaultEntry] = {
    # link
    "LINK_OPEN": FaultEntry(
        "the port could not be opened",
        "check the cable, the port's name (daq.port; a plug-in's in daq.options; PORT of `rig servo`), and that no "
        "other program holds it",
    ),
    "SECOND_MASTER": FaultEntry(
        "somebody else drives this device, too",
        "end the other run, or stop it in its panel; on a Modbus device look for another machine or PLC that writes to "
        "it; then type `rig run CONFIG` again",
    ),
    "OTHER_BOARD": FaultEntry(
        "another board is at this port than the one that the config is for",
        "do what is said here, correct daq.port, or plug the boards in as they were. The limits and the calibration of "
        "one bench are wrong for another: take no number over for a bench that has not been calibrated",
    ),
    "LINK_LOST": FaultEntry(
        "the port died while in use",
        "check the cable and the device's supply; try the link with `rig doctor CONFIG`, which drives nothing; then "
        "start the run again: rig never reopens a port by itself",
    ),
    "LINK_TIMEOUT": FaultEntry(
        "no valid reply within the time-out",
        "check supply, cable, interference and daq.baud; `rig check` prints what the link needs. An emulated device in "
        "real time shares this machine; where it is busy, leave `-realtime` out of daq.port: virtual time waits for it",
        {
            "modbus": "On a Modbus device check daq.modbus.unit and daq.modbus.parity, too",
            "servo": "Of a servo check daq.servo.id, too: `rig servo scan` shows who answers, and at which baud. One "
            "without watchdog may be late for daq.watchdog_s, 0.1 s at most: `rig check` says whether there is room",
        },
    ),
    "LINK_REPLY": FaultEntry(
        "the reply does not fit the request, or is damaged",
        "check cable, shield, termination and daq.baud, and that nothing else talks on this line",
        {"modbus": "On a Modbus device check daq.modbus.registers, too"},
    ),
    "LINK_UNIT": FaultEntry(
        "another unit answered",
        "give each device on the line an id of its own",
        {"modbus": "Put a Modbus device's in daq.modbus.unit", "servo": "Put a servo's in daq.servo.id"},
    ),
    "MODBUS_EXCEPTION": FaultEntry(
        "the device refused a request",
        "read the exception beside this line; correct daq.modbus.registers by the device's manual: rig counts "
        "addresses from 0",
    ),
    "LINK_GAP": FaultEntry(
        "samples of the relay or the stroke test in the device were lost on the way",
        "check cable and plug, close other programs that read the port, or set relay.where to host",
    ),
    "LINK_HELLO": FaultEntry(
        "the device did not introduce itself",
        "flash the firmware (`rig flash`), check daq.port and daq.baud; an Arduino needs two seconds after the port "
        "opens",
    ),
    "LINK_VERSION": FaultEntry(
        "the firmware speaks another version of the protocol",
        "flash the firmware that belongs to this version of rig: type the `rig flash` line given here. Switch the "
        "motor's supply on only when you have measured the voltages of docs/real-bench.md",
    ),
    "LINK_REJECTED": FaultEntry(
        "the device refused a command",
        "read the device's code beside this line, and correct the key that it names: limits.hard_rad, "
        "sensor.rail_counts, drive.max_V or daq.watchdog_s",
    ),
    "CONFIG_MISMATCH": FaultEntry(
        "the device is not the one that the config describes",
        "correct the key named here, or connect the other device and name its port in daq.port",
    ),
    "NO_WATCHDOG": FaultEntry(
        "the device holds its last drive when the host is silent",
        "use a device with a watchdog; or accept the risk with daq.accept_no_watchdog: true, and keep an e-stop at "
        "hand",
    ),
    "LATCHES_NOTHING": FaultEntry(
        "this device does not latch its e-stop, so rig would not see it between two runs of one command",
        "type `rig run` once for each run, without --repeat",
    ),
    "ARM_READBACK": FaultEntry(
        "the device reads back other limits than rig sent",
        "start again. If it comes back, flash the firmware (`rig flash`). On a Modbus device, correct the address and "
        "type of that register in daq.modbus.registers, or give a value that the device can hold",
    ),
    "DEVICE_RESET": FaultEntry(
        "the device restarted during the run, or lost its arming for another reason",
        "check its supply (a motor can pull it down) and its wiring, then start the run again. On a Modbus device, "
        "check that daq.modbus.registers.status is the status register, and name its other values in `faults`",
    ),
    # device, reported by the firmware
    "DEVICE_WATCHDOG": FaultEntry(
        "the device heard nothing from the host within its watchdog time and set 0 V",
        "close programs that load the machine, or raise daq.watchdog_s within what `rig check` allows. The breakaway "
        "check uses a shorter time: `rig check` prints it",
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
        "the device refused the drive: it is not armed",
        "start the run again: rig arms the device anew. If it comes back, check the device's supply, and check with "
        "`rig doctor CONFIG` that it answers",
    ),
    "DEVICE_DRIVE_RANGE": FaultEntry(
        "the host commanded more drive than the device is armed for",
        "lower the drive (relay.gains, relay.search.h_max_V, `rig jog` --u-V), or raise drive.max_V",
    ),
    "DEVICE_ESTOP": FaultEntry(
        "the device's e-stop input is open, and it set 0 V",
        "release the e-stop, then type `rig run CONFIG` again. If you have no e-stop, wire the input to ground",
    ),
    "DEVICE_END_SWITCH": FaultEntry(
        "the shaft is at an end switch, or a switch's wire is broken, and the device set 0 V",
        "bring the shaft inside with `rig jog`, then lower relay.target.amplitude_rad. If it happens at both ends, "
        "check the wires",
    ),
    "DEVICE_ENCODER_LOST": FaultEntry(
        "both channels of the encoder changed at once: counts are lost, and the device set 0 V",
        "look for interference: twist the encoder's wires, away from the motor's, and add 1 nF from each "
        "channel (Uno: D2 and D3; Pico: GP2 and GP3) to ground. Then set zero anew with `rig home`",
    ),
    "DEVICE_ENCODER_RATE": FaultEntry(
        "the encoder's edges came faster than the device can count, and it set 0 V",
        "more than 40,000 edges a second are too fast for an Uno, more than 2,000,000 for a Pico: an encoder with "
        "fewer counts, or a slower shaft. If the shaft was slow, it is interference. Then set zero anew with `rig "
        "home`",
    ),
    "DEVICE_ENCODER_STILL": FaultEntry(
        "one channel of the encoder changed while the other stood still, by a loose wire or a shaft that trembles on "
        "an edge: the device set 0 V and forgot its zero",
        "check the wires of both channels (Uno: D2 and D3; Pico: GP2 and GP3), and the encoder's supply. A shaft that "
        "trembles on an edge of one channel, or interference on one wire, looks the same, also while the drive is off: "
        "turn the shaft a little, or keep it still. Then set zero anew with `rig home`",
    ),
    "DEVICE_NO_ZERO": FaultEntry(
        "the device does not know where its encoder stands, so no travel limit would hold",
        "type `rig home CONFIG`. A reset of the board, a new plug, or a `rig home` that did not end well leaves no "
        "zero. A fault of the encoder ends it, also while the drive is off: a loose wire, or a shaft that trembles on "
        "an edge",
    ),
    "DEVICE_ESTOP_UNTRIED": FaultEntry(
        "without travel limits the device arms only after its e-stop has been tried",
        "press the e-stop and release it, then type `rig run CONFIG` again. A reset of the board asks for it again",
    ),
    "DEVICE_RELAY": FaultEntry(
        "the relay or the stroke test in the device decided otherwise than rig's law on the same counts",
        "flash the firmware of this rig (`rig flash`). If the device has it already, report this run, and set "
        "relay.where to host meanwhile",
    ),
    "RELAY_STOPPED": FaultEntry(
        "the relay or the stroke test in the device drove where the guard forbids it",
        "lower relay.target.amplitude_rad or relay.gains, or widen limits.hard_rad. If it ran well before, check the "
        "motor's wires",
    ),
    # smart servos
    "SERVO_IN_USE": FaultEntry(
        "the servo's torque is on: somebody drives it",
        "end the program that drives it, or switch its torque off there; then type `rig run CONFIG` again",
    ),
    "SERVO_SETUP": FaultEntry(
        "a register of the servo is set so that rig must not drive it",
        "change the register that is named here with the maker's program (DYNAMIXEL Wizard, FD), or do what is said of "
        "it, then type `rig run CONFIG` again",
    ),
    "SERVO_ERROR": FaultEntry(
        "the servo has an error of its hardware",
        "take the load off, let it cool, check its supply; then `rig servo reboot PORT ID`, or cut its supply once",
    ),
    "SERVO_SUPPLY": FaultEntry(
        "the servo's supply is not what the config says, or too weak",
        "measure it at the servo's plug; correct drive.supply_V, or use a stronger supply with a thicker cable",
    ),
    "SERVO_HOT": FaultEntry(
        "the servo is too hot",
        "let it cool; shorten the test or lower drive.max_V. daq.servo.hot_degC bounds it",
    ),
    "SERVO_OVERLOAD": FaultEntry(
        "the servo protects itself: it gives less duty than rig wrote",
        "check that nothing holds the horn; lower drive.max_V; `rig servo reboot PORT ID`, or cut its supply once",
    ),
    "SERVO_REFUSED": FaultEntry(
        "the servo refused an instruction",
        "read its words beside this line; check daq.servo.model, and that no other program talks to it",
    ),
    "SERVO_CHANGED": FaultEntry(
        "rig cannot keep, or put back, what the servo's registers held before",
        "mend the file that is named here, or delete it; `rig servo restore PORT ID` puts back what it holds",
    ),
    "SERVO_UNWATCHED": FaultEntry(
        "no process would stop the servo if this one died",
        "the words beside this line say why its keeper did not start, or ended: too little memory, too few processes "
        "allowed (`ulimit -u`), or somebody ended it. Mend that, and type `rig run CONFIG` again",
    ),
    "SERVO_SWITCH_UNTRIED": FaultEntry(
        "a joint that no watchdog stops is driven only after the switch of its supply has been tried",
        "type `rig run CONFIG` in a terminal, without --json: rig asks you to open the switch, and then to close it "
        "again. Do each within a minute",
    ),
    # guard
    "TRAVEL_HARD": FaultEntry(
        "the position is beyond the hard travel limit",
        "bring the shaft inside with `rig jog`; lower relay.target.amplitude_rad or limits.max_speed_rad_s",
    ),
    "POLARITY": FaultEntry(
        "the shaft moves against the drive",
        "swap the two motor wires, or the two outer wires of the potentiometer, or the two channels of the encoder "
        "(Uno: D2 and D3; Pico: GP2 and GP3). Or change drive.reversed, or sensor.encoder.sign",
    ),
    "SENSOR_RAIL": FaultEntry(
        "the position sensor reads at its rail",
        "check the wiper's wire and the supply of the potentiometer; move the shaft away from the ends: readings "
        "inside sensor.rail_counts are good. On a Modbus device, check type and scale in "
        "daq.modbus.registers.position, and daq.modbus.word_order",
    ),
    "SENSOR_JUMP": FaultEntry(
        "the position jumped farther than the shaft can move in that time",
        "check for a loose wiper, swapped wires or the potentiometer's dead zone, and that limits.max_speed_rad_s is "
        "true",
    ),
    "SENSOR_STUCK": FaultEntry(
        "the reading does not follow the drive: the sensor is frozen or noisy, or the drive is not what rig commanded",
        "check the wiper's wire, the coupling of the potentiometer, the motor's wires, its supply and the bridge; `rig "
        "jog CONFIG --u-V VOLTS` shows whether the reading follows the shaft. An encoder that stood still has lost its "
        "place, and its board does not know: `rig home CONFIG` before the next run",
    ),
    "SAMPLE_STALE": FaultEntry(
        "every reading is of the same instant: the device takes no new samples",
        "power the device off and on. If it comes back, flash its firmware anew (`rig flash`), or correct the times in "
        "the plug-in driver",
    ),
    "LOAD_TURNS": FaultEntry(
        "a load turns the shaft one way, however weakly the motor is driven",
        "take the load off, or balance it, and type `rig run CONFIG` again: rig needs a shaft that stays where it is "
        "at 0 V. Or turn a load that hangs to its lowest point, and start there. A bench that moves more than 0.1 s "
        "after its drive can look the same",
    ),
    "NO_MOTION": FaultEntry(
        "rig saw no motion up to the largest breakaway drive",
        "check the sensor first: switch the motor's supply off, turn the shaft by hand, and watch the reading of `rig "
        "jog --u-V 0` follow it (wiper, coupling). Then check the motor's supply, wires and bridge. Raise "
        "breakaway.max_V only if all that is well, by a fifth at a time: then friction is higher than you thought. "
        "Play between motor and sensor looks the same: strokes of some 10 mrad go to and fro within it. "
        "So does a bench that moves more than 0.1 s after its drive",
    ),
    "DELAY": FaultEntry(
        "the bench acts too late for the room that it has: from a drive to its motion the shaft could travel too far",
        "widen limits.hard_rad, or lower limits.max_speed_rad_s, relay.target.amplitude_rad or daq.watchdog_s; or find "
        "what is late and make it quicker: a filter of the sensor, the scan time of an I/O block, a ramp of the drive",
    ),
    "LATE": FaultEntry(
        "ticks came late: strokes of the breakaway check lasted too long, or the loop reacts later than the room to "
        "stop counts",
        "close programs that load the machine; `rig doctor CONFIG` shows how late ticks come and what helps; then "
        "start the run again",
    ),
    "DRIVE_STUCK_ON": FaultEntry(
        "the shaft moves although the drive is at 0 V",
        "cut the motor's supply: software cannot stop this drive. If the shaft goes on turning, a load turns it: "
        "take it off, or balance it. If it stops, check the H-bridge, the enable pull-down, and that "
        "`rig flash --bridge` named the inputs that your bridge has",
    ),
    "SENSOR_NOISY": FaultEntry(
        "the position sensor is too noisy to see motion",
        "shield the wiper's wire, check the potentiometer's supply, or raise breakaway.motion_rad",
    ),
    "OVERSPEED": FaultEntry(
        "the shaft is faster than limits.max_speed_rad_s",
        "lower relay.gains or relay.target.amplitude_rad, or raise limits.max_speed_rad_s if `rig check` has room to "
        "stop; where the drive was 0 V, check the bridge and the sensor",
    ),
    # loop and recording
    "RECORDER_DEAD": FaultEntry(
        "the recorder stopped taking rows",
        "check free space and permissions of the run folder, or choose a folder on another disk with `rig run --out`. "
        "Where a file was cut short: leave the files of a run alone while it goes on",
    ),
    "INTERRUPTED": FaultEntry(
        "the run was interrupted",
        "start it again. If a relay test had its cycles, `rig identify RUN` can still identify it",
    ),
    "SUSPENDED": FaultEntry(
        "the machine was suspended during the run; its clock stood still, the device's did not",
        "keep it awake and start again: type `rig run CONFIG` behind `systemd-inhibit --what=sleep:idle`, or switch "
        "suspend off. A device with a watchdog was at 0 V meanwhile, one without may have held its last drive",
    ),
    "LAW_FAILED": FaultEntry(
        "the law failed, or asked for a drive that is no number",
        "if the law is your own, mend the line that is named here, or in the traceback in events.jsonl. If it is "
        "rig's, this is a defect: please report it with the run folder (`rig export RUN --to run.json` makes it one "
        "file)",
    ),
    "LAW_TIME": FaultEntry(
        "the law of your own took longer than it may",
        "make its step quicker: do what is slow (imports, files) once, before the run, in its "
        "__init__. A law that needs more time on purpose: raise loop.law_cpu_s. A simulation shows what the law does "
        "without this bound: daq.driver: simulated",
    ),
    "LAW_UNWATCHED": FaultEntry(
        "no process watches the law of your own: one that never returns could not be stopped",
        "the words behind it say why its keeper did not start, or ended: too little memory, too few processes allowed "
        "(`ulimit -u`), or somebody ended it. Mend that, and type `rig run CONFIG` again",
    ),
    "INTERNAL": FaultEntry(
        "the program failed",
        "this is a defect of rig: please report it with the run folder. `rig identify RUN` can still identify what was "
        "recorded",
    ),
    "STOP_UNCONFIRMED": FaultEntry(
        "the device did not confirm the stop",
        "the device's watchdog sets 0 V. If the shaft still turns, cut the motor's supply; then check the cable: `rig "
        "doctor CONFIG` tries it without driving",
    ),
    # experiment
    "NOT_IDENTIFIED": FaultEntry(
        "rig could not identify this recording",
        "see the reason beside this line; `rig identify RUN` says more",
    ),
    "NO_CYCLE": FaultEntry(
        "no settled limit cycle within the search's time",
        "raise relay.search.timeout_s or relay.search.h_max_V, or change relay.target or relay.second_ratio",
    ),
    "NOT_HOME": FaultEntry(
        "rig could not bring the shaft to rest at zero",
        "check for play, a spring or a load that moves the shaft; turn it near the centre by hand or with `rig jog`, "
        "and start again; of `rig home`: check the wires of both end switches, too",
    ),
    "NO_SWEEPS": FaultEntry(
        "the survey has no room, or no time, for its sweeps",
        "see the reason beside this line: widen limits.soft_rad, raise survey.longest_s, or change survey.speeds_rad_s",
    ),
    "NOT_FOLLOWING": FaultEntry(
        "the shaft does not follow the slow sweep of the survey",
        "look for what holds it there, or for a reading that stands still; if it follows faster sweeps, give only "
        "those in survey.speeds_rad_s",
    ),
    "DRIVE_TOO_SMALL": FaultEntry(
        "a hysteretic relay's drive does not move the shaft from rest",
        "raise this d_V in relay.hysteretic above the breakaway level",
    ),
    "NO_SWITCHING": FaultEntry(
        "the hysteretic relay did not switch in time",
        "raise this run's d_V, or lower its eps_rad, in relay.hysteretic",
    ),
    "START_OUTSIDE": FaultEntry(
        "the shaft stands outside the soft limits",
        "bring it inside with `rig jog` or by hand, then start again",
    ),
}


# What a device may have latched before a command opened it, in few words. Any other code: its cause.
_SINCE_THE_LAST_RUN = {
    "DEVICE_ESTOP": "e-stop pressed",
    "DEVICE_WATCHDOG": "the device's watchdog took the drive off",
    "DEVICE_TRAVEL": "the shaft was beyond a hard limit",
    "DEVICE_SENSOR": "the position sensor was at its rail",
    "DEVICE_END_SWITCH": "an end switch opened",
    "DEVICE_ENCODER_STILL": "a loose channel of the encoder, or a shaft that trembled on an edge,",
}


def since_the_last_run(code: str) -> str:
    """One line for people: opening the device cleared this fault, and when it happened."""
    return f"{_SINCE_THE_LAST_RUN.get(code, FAULTS[code].cause)} since the last run: the device had latched {code}"


IN_A_REHEARSAL = (
    "nothing is wired in a rehearsal: the config's numbers do not suit the made-up motor; change these, or give your "
    "motor's by the options of `rig rehearse`. On a bench: "
)


class Fault(RigError):
    """A latched fault: code, cause, cure, and what was seen here.

    code    a key of ``FAULTS``
    detail  the numbers of this case, e.g. "y = 1.52 rad, hard limit 1.50 rad"; may quote what a device said
    """

    def __init__(self, code: str, detail: str = "") -> None:
        entry = FAULTS[code]
        self.code = code
        self.cause = entry.cause
        self.cure = entry.cure_with()
        self.detail = detail = plain(detail)
        super().__init__(f"{code}: {entry.cause}" + (f" ({detail})" if detail else ""))

    def fit(self, driver: str, is_rehearsal: bool = False) -> None:
        """Have the cure say nothing of devices of other drivers, and first what can be done in a rehearsal."""
        self.cure = (IN_A_REHEARSAL if is_rehearsal else "") + FAULTS[self.code].cure_with(driver)

    def as_dict(self) -> dict[str, str]:
        """The fault as ``events.jsonl`` and ``result.json`` hold it."""
        return {"code": self.code, "cause": self.cause, "cure": self.cure, "detail": self.detail}
