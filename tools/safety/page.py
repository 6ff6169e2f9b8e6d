"""docs/safety-table.md, from what was measured."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

from rig.preflight.rules import preflight
from safety.driven_chip import DRIVE_FULL, EXPERIMENT, SETUP, Way, steady
from safety.garbage import Errors, Guesses, Thrown
from safety.promises import Measured
from shared.table import markdown

_CONDITIONS = """\
# What stops the drive, and how soon

Made by `make safety`, {made}:
the very `.hex` on its emulated chip, in virtual time, the drive read at the pins. Each row is {phases} random
phases, both directions; the worst of them is shown, to some 10 us. A tick is 1 ms. The command fails if a bound is
broken. It is in [tools/safety](../tools/safety).

Bench, limits and watchdog ({watchdog_ms} ms) are those of [config/demo.yaml](../config/demo.yaml). The shaft turns at
{speed:.2f} rad/s, the largest speed below `limits.max_speed_rad_s`, with the drive that keeps it there; *full drive*:
at that speed, and `drive.max_V` as long as it is on. *Host*: the host sends a DRIVE every {period_ms:g} ms. *Device*:
the relay in the device drives, the host sends a KEEP every {period_ms:g} ms. *Flood*: it fills the wire with garbage
besides. After the event the host goes on, where it is not silent, and nothing may drive again. Unless something else
is said, 115200 baud and `BRIDGE=PWM_DIR`.

*Coast* is how far the shaft goes on after the drive is off, terminals shorted (a bridge that opens in a reset lets it
go farther); *in all*, from the event until it stands. A hang stops the program, or the interrupt named, for good. A
hung main loop means silence to the tick, which goes on and takes the drive off after the watchdog's time, but where it
hangs while it holds the tick back: then, and in all other hangs, the hardware watchdog resets the chip. The emulated
one takes 128 ms, a real one has an oscillator of its own that no crystal holds. The resets are the emulator's: at which
voltage a brown-out comes is the chip's fuse.
"""

_FULL = """\
At full drive the shaft gains speed until the watchdog acts: {full_rad:.2f} rad in all. The stopping distance of
`rig check`,

    {stopping}

counts {counted_rad:.2f} rad for watchdog and coasting, at `limits.max_speed_rad_s` throughout: while the host lives its
guard ends anything faster, and what the drive adds once the host is dead depends on the motor's K and tau, which nobody
knows before the experiment. On this bench full drive uses up the other terms, too. The hard limit in the chip does not
rest on that sum: it ends such a drive within 2 ms of the crossing.
"""

_GARBAGE = """\
## Garbage never moves the drive

Noise, frames with one to four wrong bits, frames cut short, frames run into one another and bursts of wrong bytes, at
a chip that is armed and stands at 0 V:

{thrown}

What remains is the CRC. Of all {errors:,} errors of one bit and of two bits on the wire in {frames:,} DRIVE frames,
{taken} gave a valid frame. Worse damage passes with the probability of 2^-16, one in 65,536 damaged frames: of
{guesses:,} DRIVE frames with a CRC drawn at random the chip took {guessed} ({expected:.1f} are to be expected). To move
the drive such a frame must besides decode to just 8 bytes, with version 1 and type DRIVE, at an armed device, with no
more than the largest drive ({max_drive} of {full} units) and inward if it recovers: for 8 random bytes
{random_drive:.0e} in all. It then drives until the next DRIVE, a period later, and the reply before that shows the
host that it was not its own.
"""

_CHIP_HEAD = """\
## What the firmware takes of the chip
"""

_CHIP = """\
`make -C firmware size BAUD={baud}`: idle, then a relay with a KEEP every 10 ms, then a host that asks for everything as
fast as the wire carries it, first without and then with a relay:

```
{text}
```
"""

_CHIP_WORDS = """\
The control tick is an interrupt of the clock, with all checks and the relay (*tick*); it lets the other interrupts in,
or it would keep received bytes waiting. *1 kHz* adds the interrupts of clock and converter: the work of every
millisecond. *relay* and *flood* are the worst millisecond with the serial port's interrupts besides: at 1 Mbaud a whole
block goes out within one, and a full wire is 100 bytes a millisecond each way. *masked*: the longest time in which no
interrupt could come; *held*: in which the tick could not, while the main loop acted on a request. What the emulator
leaves out, the four cycles to enter an interrupt, is added. *lost* are bytes that the chip's receiver, two bytes deep,
had no room for.

A host that fills the wire at 1 Mbaud for long outruns the main loop: behind the receiver 255 bytes wait, and what comes
then is dropped. A frame with a hole fails its CRC, and every promise above holds (*flood*).
"""


class Found(NamedTuple):
    """All that the page shows.

    made       when and from what, in words
    chip       output of `make size` by baud rate
    """

    made: str
    promises: Sequence[Measured]
    thrown: Sequence[Thrown]
    errors: Errors
    guesses: Guesses
    chip: Mapping[int, str]


def is_kept(found: Found) -> bool:
    """Whether nothing is broken."""
    late = sum(row.late for row in found.promises)
    return late == 0 and found.errors.taken == 0 and all(thrown.moves == 0 for thrown in found.thrown)


def _way(way: Way) -> str:
    words: list[str] = [way.where]
    words += ["full drive"] if way.full else []
    words += ["flood"] if way.floods else []
    words += [f"{way.baud // 1_000_000} Mbaud"] if way.baud >= 1_000_000 else []
    words += ["IN1_IN2"] if way.bridge == "IN1_IN2" else []
    return ", ".join(words)


def _bound(bound_s: float) -> str:
    return f"{1e3 * bound_s:.0f} ms"


def _time(time_s: float) -> str:
    return f"{1e3 * time_s:.2f} ms" if time_s >= 1e-4 else f"{1e6 * time_s:.0f} us"


def row(measured: Measured) -> tuple[str, ...]:
    """One line of the table."""
    promise = measured.promise
    late = f" **late: {measured.late}**" if measured.late else ""
    rad = (f"{measured.coast_rad:.2f}", f"{measured.travel_rad:.2f}")
    return promise.what, _way(promise.way), _bound(promise.bound_s), f"{_time(measured.off_s)}{late}", *rad


def table(rows: Sequence[Measured]) -> str:
    """The table of promises."""
    head = ("what happens", "driven by", "off within", "worst", "coast, rad", "in all, rad")
    return markdown(head, map(row, rows))


def render(found: Found) -> str:
    """The page."""
    errors, guesses, limits = found.errors, found.guesses, EXPERIMENT.limits
    stopping = next(line for line in preflight(EXPERIMENT).lines if line.startswith("stopping"))
    random_drive = 2.0**-16 * 2.0**-8 * 2.0**-8 * (2 * SETUP.max_drive + 1) / 2.0**16
    parts = [
        _CONDITIONS.format(
            made=found.made,
            phases=min(row.phases for row in found.promises),
            watchdog_ms=SETUP.watchdog_ms,
            speed=max(abs(steady(direction)[1]) for direction in (1, -1)),
            period_ms=1e3 * EXPERIMENT.period_s,
        ),
        table(found.promises) + "\n",
        _FULL.format(
            full_rad=max(row.travel_rad for row in found.promises if row.promise.way.full),
            stopping=stopping.removeprefix("stopping ").split(";")[0],
            counted_rad=limits.max_speed_rad_s * (EXPERIMENT.daq.watchdog_s + limits.coast_tau_s),
        ),
        _GARBAGE.format(
            thrown=markdown(("baud", "pieces", "moves of the drive"), found.thrown),
            errors=errors.errors,
            frames=errors.frames,
            taken=errors.taken or "none",
            guesses=guesses.frames,
            guessed=guesses.taken,
            expected=guesses.frames / 2.0**16,
            max_drive=SETUP.max_drive,
            full=DRIVE_FULL,
            random_drive=random_drive,
        ),
        _CHIP_HEAD,
        *(_CHIP.format(baud=baud, text=text.strip()) for baud, text in found.chip.items()),
        _CHIP_WORDS,
    ]
    return "\n".join(parts)
