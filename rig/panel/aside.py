"""What takes a second is done aside, by a process of low priority: a Stop must not wait for it, and no loop either."""

from __future__ import annotations

import asyncio
import contextlib
import json
import os
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

from rig.panel.errors import RefusedError

_PATIENCE_S: Final = 60.0
_LESS_URGENT: Final = 10


async def answer_of(module: str, *paths: Path) -> dict[str, Any]:
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
        answer = json.loads(said)
    except ValueError:
        last = " ".join(errors.decode(errors="replace").strip().splitlines()[-1:]) or "no answer"
        raise RefusedError(503, f"{name} cannot be read: {last}", "look at it with rig") from None
    if "error" in answer:
        raise RefusedError(409, str(answer["error"]["what"]), str(answer["error"]["cure"]))
    return dict(answer)


def give(answer: Callable[..., dict[str, Any]]) -> None:
    """As such a process: print the answer for the paths that were asked for."""
    with contextlib.suppress(AttributeError, OSError):  # Windows has no such call
        os.nice(_LESS_URGENT)
    sys.stdout.write(json.dumps(answer(*map(Path, sys.argv[1:])), allow_nan=False))
