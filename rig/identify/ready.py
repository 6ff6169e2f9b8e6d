"""Loads the compiled loops of an identification before a device is opened, and compiles those that are not on disk.

``python -m rig.identify.ready`` does so once, after an installation or a change of the model. The set-up of a clone
runs it for ``real`` and ``plain`` at the same time, on two cores.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from contextlib import suppress
from typing import Final

import numpy as np

from rig.identify.noise import Noise, noise_of
from rig.identify.starts import Start
from rig.identify.triple_relay import Features, solve
from rig.model.compiled import kernel
from rig.model.motor import Motor, State
from rig.model.real_motor import Frame, FramedMotor, Pieces, RealMotor, moved, response_and_jacobian
from rig.model.sensitivity import Theta, position, position_and_jacobian
from rig.recording.errors import IdentifyError

WORDS = "rig: compiling the motor's model, once after an installation or an update; it may take a minute"


def _real() -> None:
    """Loops of the motor with its laws: half of the time."""
    t_s, still = 0.01 * np.arange(8.0), np.zeros(8)
    motor = RealMotor(0.2, 5.0, 0.4)
    response_and_jacobian(motor, Frame(), (t_s, still), t_s, Pieces.one(), [0])
    moved(FramedMotor(motor, Frame()), (0.0, 0.0, 0.0, 0.0, 0.0), 0.0, 0.01)


def _plain() -> None:
    """All others."""
    t_s, still = 0.01 * np.arange(8.0), np.zeros(8)
    theta = Theta(0.2, 5.0, 0.4, 0.0, 0.0, 0.0, 0.0)
    position_and_jacobian(theta, t_s, still, t_s)
    position(theta, t_s, still, t_s)
    Motor(0.2, 5.0).response(State(), t_s, t_s, still)
    Noise(0.1, 1.0).whiten(np.ones(8), t_s, [8])
    noise_of(np.ones(8), t_s, [8])
    with suppress(IdentifyError):  # these numbers are no cycle
        solve(Features(0.1, 0.1, 0.1, 0.5, 0.1), 0.4, 0.8, [Start(0.2, 5.0, 0.4)])


HALVES: Final = {"real": _real, "plain": _plain}


def make_ready(say: Callable[[str], object]) -> None:
    """Call each loop once, with next to nothing to do; ``say`` is called once, with a sentence, if one is compiled."""
    told: list[str] = []

    def begins() -> None:
        if not told:
            told.append(WORDS)
            say(WORDS)

    with kernel.compiling(begins):
        for half in HALVES.values():
            half()


def main() -> None:
    """Compile what is not on disk: the half that is named, else both, with words on standard error."""
    if sys.argv[1:]:
        HALVES[sys.argv[1]]()
    else:
        make_ready(lambda words: sys.stderr.write(f"{words}\n"))


if __name__ == "__main__":
    main()
