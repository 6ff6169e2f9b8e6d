"""What takes a second is done aside, by a process of low priority: a Stop must not wait for it, and no loop either.

``python -m rig.panel.aside MODULE FUNCTION PATH...`` prints as JSON what that function of the panel gives.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import os
import sys
from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from typing import Final, TypeVar

from rig.panel.messages import Refusal, RefusedError
from rig.run_folder.recording.errors import RecordingError

_COMPUTES_S: Final = 60  # of its own time: on a busy machine it gets little of it, and may well come to an answer
_PATIENCE_S: Final = 600.0  # for a disk that hangs
_LESS_URGENT: Final = 10
_Answer = TypeVar("_Answer")


async def answer_of(asked: Callable[..., _Answer], *paths: Path) -> _Answer:
    """What a function gives for these paths. Raises RefusedError if that is nothing of use, or an error."""
    name = paths[-1].name
    process = await asyncio.create_subprocess_exec(
        sys.executable, "-P", "-m", __name__, asked.__module__, asked.__name__, *map(str, paths),
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
        last = " ".join(errors.decode(errors="replace").strip().splitlines()[-1:])
        last = last or f"it was ended without an answer, as is what computes for {_COMPUTES_S} s"
        raise RefusedError(503, f"{name} cannot be read: {last}", "look at it with rig") from None
    if "error" in given:
        raise RefusedError(409, **given["error"])
    answer: _Answer = given
    return answer


def main(module: str, asked: str, *paths: str) -> None:
    """As such a process: print the answer for the paths that were asked for, or what is wrong with a recording."""
    with contextlib.suppress(AttributeError, OSError):  # Windows has no such call
        os.nice(_LESS_URGENT)
    with contextlib.suppress(ImportError, OSError, ValueError):  # nor such a module; or it may compute for less already
        import resource

        resource.setrlimit(resource.RLIMIT_CPU, (_COMPUTES_S, _COMPUTES_S))
    try:
        given: object = getattr(import_module(module), asked)(*map(Path, paths))
    except RecordingError as error:
        given = Refusal(error={"what": f"{error.path}: {error.cause}", "cure": error.cure})
    sys.stdout.write(json.dumps(given, allow_nan=False))


if __name__ == "__main__":
    main(*sys.argv[1:])
