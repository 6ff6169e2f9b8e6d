"""A config of a survey on a bench with an unbalanced load and a Stribeck effect, or other parts."""

from __future__ import annotations

from pathlib import Path

import yaml

ROOT = Path(__file__).resolve().parents[1]
# An unbalanced load and a Stribeck effect: what the map is to show.
FRICTION = {"fc_plus_V": 0.48, "fc_minus_V": 0.48, "fs_plus_V": 0.54, "fs_minus_V": 0.54, "stribeck_rad_s": 0.4}
PARTS = {"force_sin_V": 0.08, "half_travel_rad": 1.0}


def written(folder: Path, parts: dict[str, float] | None = None, **sections: object) -> Path:
    """config/quick.yaml with given gains, no tracking, this motor, and further sections."""
    config = yaml.safe_load((ROOT / "config/quick.yaml").read_text(encoding="utf-8"))
    config.pop("tracking")
    config["relay"] = {"gains": [{"h1_V": 0.42, "h2_V": 0.84}], "cycles": 6}
    config["survey"] = {"speeds_rad_s": [0.7, 0.4, 0.2], "longest_s": 60}
    motor = config["emulated"]["motor"]
    motor |= FRICTION
    if parts is not None:
        motor["parts"] = parts
        for name in ("fs_plus_V", "fs_minus_V", "stribeck_rad_s"):
            motor.pop(name)
    else:
        motor["parts"] = PARTS
    path = folder / "survey.yaml"
    path.write_text(yaml.safe_dump(config | sections), encoding="utf-8")
    return path
