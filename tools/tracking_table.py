"""docs/evidence/tracking-table.md: tracking with and without the laws that rig finds: ``make tracking``.

Each bench is config/simulated.yaml with another motor. It is identified once. Then its shaft tracks the config's
trajectory with the model of that identification, with its laws and without them, at several seeds of the noise.
"""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from statistics import fmean
from tempfile import TemporaryDirectory
from typing import Any

from rig import config
from rig.config import Experiment
from rig.core.estimators import LEADING
from rig.identification import Identification, identify
from rig.run_folder.recording.reader import read_run
from rig.run_folder.results import TrackingResult, known
from rig.running.experiment import script as experiment
from shared import page

ROOT = Path(__file__).resolve().parent.parent
PAGE = ROOT / "docs/evidence/tracking-table.md"
SEEDS = (1, 2, 3)
# Keys of emulated.motor, and of its section parts.
BENCHES: dict[str, tuple[Mapping[str, float], Mapping[str, float]]] = {
    "none: config/simulated.yaml": ({}, {}),
    "Stribeck friction, 0.2 V at rest, 0.4 rad/s": (
        {"fs_plus_V": 0.70, "fs_minus_V": 0.66, "stribeck_rad_s": 0.4},
        {},
    ),
    "an unbalanced load, 0.1 V": ({}, {"force_sin_V": 0.1}),
    "a supply that sags, 12 % at 1 V": ({}, {"sag_per_V": 0.12}),
    "drag, 0.02 V at 1 rad/s": ({}, {"drag_V_s2_rad2": 0.02}),
    "viscous friction by direction, 20 mV s/rad": ({}, {"viscous_by_direction_V_s_rad": 0.02}),
    "friction over position, 0.1 V": ({}, {"friction_sin_V": 0.1}),
    "a sensor's linearity, 15 mrad": ({}, {"linearity_sin1_rad": 0.015, "linearity_cos2_rad": 0.01}),
}


@dataclass(frozen=True)
class Compared:
    """Tracking with the laws and without them: the outcome at each seed, and the laws that the drive made up for."""

    laws: tuple[str, ...]
    with_laws: tuple[TrackingResult, ...]
    without: tuple[TrackingResult, ...]

    def rms_mrad(self, key: str) -> tuple[float, float]:
        """Mean over the seeds of the RMS error ``key`` (rms_rad or true_rms_rad), mrad: with and without the laws."""
        with_mrad, without_mrad = (
            1e3 * fmean(known(getattr(one, key)) for one in outcomes) for outcomes in (self.with_laws, self.without)
        )
        return with_mrad, without_mrad


def bench(motor: Mapping[str, float], parts: Mapping[str, float]) -> Experiment:
    """config/simulated.yaml with these keys of the emulated motor and its parts; the leading model alone tracks."""
    data: dict[str, Any] = config.load(ROOT / "config/simulated.yaml").model_dump(mode="json")
    data["emulated"]["motor"] |= {**motor, "parts": dict(parts) or None}
    data["tracking"]["methods"] = [LEADING]
    return Experiment.model_validate_json(json.dumps(data))


def compare(
    e: Experiment, folder: Path, seeds: Sequence[int] = SEEDS, known: tuple[Path, Identification] | None = None
) -> Compared:
    """Identify the bench at its own seed, and track with its model at each of ``seeds``; runs go into ``folder``.

    known   a run of the bench and what is identified from it, where that is there already
    """
    run, models = known or identified(e, folder)
    both = [tuple(_tracked(e, models, run, folder, (seed, with_laws)) for seed in seeds) for with_laws in (True, False)]
    return Compared(both[0][0].law or (), both[0], both[1])


def identified(e: Experiment, folder: Path) -> tuple[Path, Identification]:
    """Relay tests of the bench at its own seed, and what is identified from them."""
    run = experiment.run_relay(e, folder).folder
    return run, identify([read_run(run)])


def _tracked(e: Experiment, models: Identification, run: Path, folder: Path, how: tuple[int, bool]) -> TrackingResult:
    seed, with_laws = how
    assert e.tracking is not None
    tracking = e.tracking.model_copy(update={"with_law": with_laws})
    one = e.model_copy(update={"seed": seed, "tracking": tracking})
    outcome = experiment.run_tracking(one, models.as_result(), run, folder)
    if outcome.fault is not None:
        raise outcome.fault
    return outcome.result.tracking[LEADING]


def main() -> int:
    """Run every bench, and write the page."""
    rows = []
    for name, (motor, parts) in BENCHES.items():
        with TemporaryDirectory() as folder:
            found = compare(bench(motor, parts), Path(folder))
        true, measured = found.rms_mrad("true_rms_rad"), found.rms_mrad("rms_rad")
        laws = " and ".join(law.replace("_", " ") for law in found.laws) or "none"
        errors = ["refused" if math.isnan(one) else f"{one:.1f}" for one in (*true[::-1], *measured[::-1])]
        rows.append((name, laws, *errors, "" if math.isnan(true[1]) else f"{true[0] / true[1]:.2f}"))
        sys.stderr.write(f"{' | '.join(rows[-1])}\n")
    page.write(
        PAGE, page.render(Path(__file__).with_name("tracking-table.md.j2"), rows=rows, seeds=SEEDS, date=page.today())
    )
    return 0


if __name__ == "__main__":
    sys.exit(main())
