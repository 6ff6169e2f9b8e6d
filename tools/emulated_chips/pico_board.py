"""The Raspberry Pi Pico's emulated chip in real time: a process behind a pseudo-terminal."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from rig.backends.emulated.board_process import BoardProcess

if TYPE_CHECKING:
    from rig.core.strict_json import JsonObject


class PicoBoard(BoardProcess):
    """The very .uf2 that is flashed, on rp2040js, with the bench behind it. Opening the port does not reset it.

    The chip runs after real time in steps of 1 ms, and whenever bytes come. A stall of this machine of more than ten
    seconds is not caught up.
    """

    def start(self, parameters: JsonObject, link: Path | None = None, trace: Path | None = None) -> str:
        """Start the process and return the name of its port.

        parameters  as ``pico_parameters`` gives them
        link, trace  as of HostBoard; the trace has ``led`` (lit: armed) instead of the fault
        Raises EmulationError where it does not start.
        """
        self._must_not_run()
        tools = str(Path(__file__).parents[1])
        begin = f"import sys; sys.path.append({tools!r}); from emulated_chips.pico_process import main; main()"
        program = (sys.executable, "-P", "-c", begin)
        return self._launch(program, {"chip": json.dumps(parameters)}, link, trace)
