"""How often the breakaway check names a bridge that lets the motor run free, and one that brakes falsely.

    python tools/free_running_rates.py [--motors N] [--seed SEED]

Random motors, the check's law against the bench's model at the config's period. Prints a table
for docs/decisions.md. A motor that its config's rules refuse, or that ends in a fault, has not
passed.
"""

from __future__ import annotations

import argparse
import random
import tempfile
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from rig.backends.emulated.bench_of_config import bench_parameters
from rig.config.problems import ConfigError
from rig.config.schema import Experiment
from rig.core.faults import Fault
from rig.core.signals import Sample
from rig.model.bench import BenchModel
from rig.run_folder.recording.series import TimeSeries
from rig.running.experiment.free_running import Free, free_running
from rig.running.experiment.stages import breakaway_check
from rig.running.preflight import check

ROOT = Path(__file__).resolve().parent.parent
SENSORS = {"encoder, 3,200 counts a turn": "encoder.yaml", "10 bits, 3 mrad of noise": "quick.yaml"}
TAU_S, K_RAD_S_V, FRICTION_V = (0.04, 0.5), (3.0, 12.0), (0.15, 0.8)
DATA_SHEET = (0.95, 1.3)  # its no-load speed, of the true one
MAX_OVER_FRICTION = 1.9  # breakaway.max_V, of static friction
LATENCY_S = 0.0012


def main() -> None:
    """Print a row for each sensor and bridge."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--motors", type=int, default=10, help="of each sensor and bridge")
    parser.add_argument("--seed", type=int, default=1)
    asked = parser.parse_args()
    print("| sensor | bridge | passed the check | named | largest evidence |\n|---|---|---|---|---|")
    for sensor, config in SENSORS.items():
        for bridge, coasts in (("runs free", True), ("brakes", False)):
            draw = random.Random(asked.seed)  # the same motors behind both bridges
            drawn = [tried(config, draw, asked.seed + k, coasts=coasts) for k in range(asked.motors)]
            found = [one for one in drawn if one is not None]
            largest = f"{max(one.evidence for one in found):.1f}" if found else "-"
            named = sum(one.is_certain for one in found)
            print(f"| {sensor} | {bridge} | {len(found)} of {asked.motors} | {named} | {largest} |", flush=True)


def tried(config: str, draw: random.Random, seed: int, *, coasts: bool) -> Free | None:
    """What the strokes of one random motor show; None if its config is refused or its check ends in a fault."""
    try:
        return shown(experiment(config, draw), seed, coasts=coasts)
    except (ConfigError, Fault):
        return None


def experiment(config: str, draw: random.Random) -> Experiment:
    """A random motor, and a config that suits its friction and its data sheet."""
    told: dict[str, Any] = yaml.safe_load((ROOT / "config" / config).read_text(encoding="utf-8"))
    tau_s = TAU_S[0] * (TAU_S[1] / TAU_S[0]) ** draw.random()
    gain, friction_V = draw.uniform(*K_RAD_S_V), draw.uniform(*FRICTION_V)
    motor = {"tau_s": tau_s, "K_rad_s_V": gain}
    for way in ("plus", "minus"):
        moving_V = friction_V * draw.uniform(0.95, 1.05)
        motor |= {f"fc_{way}_V": moving_V, f"fs_{way}_V": moving_V * draw.uniform(1.0, 1.2)}
    told["daq"] = {"driver": "simulated"}
    told["emulated"]["motor"].update(motor)
    told["breakaway"]["max_V"] = MAX_OVER_FRICTION * max(motor["fs_plus_V"], motor["fs_minus_V"])
    full_V = told["drive"]["supply_V"] - friction_V
    told["motor"]["no_load_speed_rad_s"] = full_V * gain * draw.uniform(*DATA_SHEET)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "bench.yaml"
        path.write_text(yaml.safe_dump(told), encoding="utf-8")
        return check(path)[0]


def shown(e: Experiment, seed: int, *, coasts: bool) -> Free | None:
    """What the strokes of the check show; None if nothing was driven. Raises Fault."""
    assert e.emulated is not None and e.motor is not None
    bench, law = BenchModel(replace(bench_parameters(e.emulated), coasting=coasts), seed), breakaway_check(e)
    bench.arm()
    rows, t_s, full = [], 0.0, bench.parameters.drive_counts
    while not law.finished:
        counts = bench.read_counts()
        u_V = law.step(Sample(t_s, e.sensor.curve.to_rad(counts), counts))
        units = float(round(u_V / e.drive.supply_V * full))
        rows.append((t_s, e.sensor.curve.to_rad(counts), t_s + LATENCY_S, units / full * e.drive.supply_V))
        bench.advance(LATENCY_S)
        bench.pin_counts = units
        bench.advance(e.period_s - LATENCY_S)
        t_s += e.period_s
    series = TimeSeries(*np.array(rows).T)
    lsb_rad = e.sensor.curve.lsb_rad
    return free_running(series, law.noise_rad, lsb_rad, e.drive.supply_V, e.motor.no_load_speed_rad_s)


if __name__ == "__main__":
    main()
