"""Every target under atheris, two at a time: python -m fuzz [--seconds N] [TARGET...]; inputs that fail are kept.

Exit status 1 where one failed.
"""

from __future__ import annotations

import argparse
import re
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

from fuzz.targets import ROOT, TARGETS

BUILD = ROOT / "build" / "fuzz"
_MAX_LENGTH = 100_000


@dataclass(frozen=True)
class Outcome:
    """What came of one target. ``failure``: the last lines of its error, and the input that brought it; else empty."""

    target: str
    inputs: int
    seconds: float
    edges: int
    failure: str


def fuzz(name: str, seconds: int) -> Outcome:
    """Feed one target for about ``seconds``, from its seeds and what earlier runs found."""
    corpus, failed = BUILD / name / "corpus", BUILD / name / "failed"
    for folder in (corpus, failed):
        folder.mkdir(parents=True, exist_ok=True)
    for number, seed in enumerate(TARGETS[name].seeds()):
        (corpus / f"seed-{number}").write_bytes(seed)
    started = time.monotonic()
    done = subprocess.run(
        [
            sys.executable, "-m", "fuzz.one", name, str(corpus), f"-max_total_time={seconds}",
            f"-artifact_prefix={failed}/", "-print_final_stats=1", f"-max_len={_MAX_LENGTH}", "-timeout=60",
        ],
        capture_output=True, text=True, errors="replace", check=False, cwd=ROOT / "tools",
    )  # fmt: skip
    said = done.stdout + done.stderr
    inputs = re.search(r"stat::number_of_executed_units:\s+(\d+)", said)
    edges = re.findall(r"\bcov: (\d+)", said)
    failure = ""
    if done.returncode != 0 or inputs is None:
        failure = "\n".join(said.splitlines()[-40:])
    return Outcome(
        name, int(inputs[1]) if inputs else 0, time.monotonic() - started, int(edges[-1]) if edges else 0, failure
    )


def main() -> int:
    """Fuzz, and print the counts."""
    options = argparse.ArgumentParser(prog="python -m fuzz", description=__doc__)
    options.add_argument("targets", nargs="*", choices=[*TARGETS, []], default=[], metavar="TARGET")
    options.add_argument("--seconds", type=int, default=60, help="for each target")
    given = options.parse_args()
    names = given.targets or list(TARGETS)
    failed = 0
    with ThreadPoolExecutor(2) as pool:
        for outcome in pool.map(lambda name: fuzz(name, given.seconds), names):
            end = "FAILED" if outcome.failure else "nothing but declared errors"
            print(
                f"{outcome.target:>16}: {outcome.inputs:>9} inputs in {outcome.seconds:.0f} s, "
                f"{outcome.edges} edges seen; {end}",
                flush=True,
            )
            if outcome.failure:
                failed += 1
                print(outcome.failure, file=sys.stderr)
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
