"""Compiles what a run needs and the disk does not hold, before a device is opened, and says how far it is.

``python -m rig.experiment.ready`` does so once, after an installation or a change of the model.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable

from rig.design.ready import make_ready as make_designs_ready
from rig.identify.ready import make_ready as make_fits_ready
from rig.model.compiled import kernel

BEGINS = "rig: compiling the motor's model, once after an installation or an update: a minute, longer on a busy machine"
GOES_ON = "rig: compiling the motor's model, once after an installation or an update: {0:.0f} s so far, {1} loops"
SAY_EVERY_S = 5.0


def make_ready(
    say: Callable[[str], object], *, designs: bool = True, clock: Callable[[], float] = time.monotonic
) -> None:
    """Load each compiled loop of a run, and compile those that are not on disk.

    say      is called with a sentence when the first one is compiled, and about every ``SAY_EVERY_S`` after that; never
             if all are on disk
    designs  whether tests are designed, too: with ``relay.until``
    clock    time, s
    """
    progress = _Progress(say, clock)
    with kernel.compiling(progress.begins):
        make_fits_ready(lambda words: None)
        if designs:
            make_designs_ready()


class _Progress:
    """Says that something is compiled, and then how far it is."""

    def __init__(self, say: Callable[[str], object], clock: Callable[[], float]) -> None:
        self._say, self._clock = say, clock
        self._loops = 0
        self._began_s = self._said_s = 0.0

    def begins(self) -> None:
        """One more loop is compiled."""
        now_s = self._clock()
        self._loops += 1
        if self._loops == 1:
            self._began_s = self._said_s = now_s
            self._say(BEGINS)
        elif now_s - self._said_s >= SAY_EVERY_S:
            self._said_s = now_s
            self._say(GOES_ON.format(now_s - self._began_s, self._loops))


def main() -> None:
    """Compile what is not on disk, with words on standard error."""
    make_ready(lambda words: sys.stderr.write(f"{words}\n"))


if __name__ == "__main__":
    main()
