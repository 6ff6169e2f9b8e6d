"""What takes a second is done aside, by a process of low priority: a Stop must not wait for it, and no loop either."""

from __future__ import annotations

import asyncio
import contextlib
import json
import os
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Final, Literal, overload

from rig.panel.errors import RefusedError
from rig.panel.messages import Compared, Drawn, Prospect, Refusal
from rig.run_folder.recording.errors import RecordingError

_PATIENCE_S: Final = 60.0
_LESS_URGENT: Final = 10


@overload
async def answer_of(module: Literal["rig.panel.prospect"], *paths: Path) -> Prospect: ...
@overload
async def answer_of(module: Literal["rig.panel.series"], *paths: Path) -> Drawn: ...
@overload
async def answer_of(module: Literal["rig.panel.compared"], *paths: Path) -> Compared: ...
async def answer_of(module: str, *paths: Path) -> Prospect | Drawn | Compared:
    """What ``python -m MODULE PATH...`` gives. Raises RefusedError if that is nothing of use, or an error."""
    name = paths[-1].name
    process = await asyncio.create_subprocess_exec(
        sys.executable, "-P", "-m", module, *map(str, paths),
        stdin=asyncio.subprocess.DEVNULL, stdout=asyncio.subprocess.PIPE, stderr=asyncio.subprocess.PIPE,
    )  # fmt: skip
    try:
        said, errors = await asyncio.wait_for(process.communicate(), _PATIENCE_S)
    except TimeoutError:
        raise RefusedError(503, f"{name}: no answer in {_PATIENCE_S:g} s", "look at it with rig") from None
    finally:
        if process.returncode is None:
            process.kill()
            await process.wait()
    try:
        given = json.loads(said)
    except ValueError:
        last = " ".join(errors.decode(errors="replace").strip().splitlines()[-1:]) or "no answer"
        raise RefusedError(503, f"{name} cannot be read: {last}", "look at it with rig") from None
    if "error" in given:
        raise RefusedError(409, **given["error"])
    answer: Prospect | Drawn | Compared = given
    return answer


def give(answer: Callable[..., Prospect | Drawn | Compared]) -> None:
    """As such a process: print the answer for the paths that were asked for, or what is wrong with a recording."""
    with contextlib.suppress(AttributeError, OSError):  # Windows has no such call
        os.nice(_LESS_URGENT)
    try:
        given: Prospect | Drawn | Compared | Refusal = answer(*map(Path, sys.argv[1:]))
    except RecordingError as error:
        given = {"error": {"what": f"{error.path}: {error.cause}", "cure": error.cure}}
    sys.stdout.write(json.dumps(given, allow_nan=False))
