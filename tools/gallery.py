"""The documentation's gallery: what rig reports of some benches, each run in virtual time. `make docs` makes it.

``python tools/gallery.py FOLDER`` writes one HTML file a bench into the folder, and `titles.json` with their titles.
"""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import yaml

ROOT = Path(__file__).resolve().parent.parent
Changes = dict[str, Any]
# title, config, what is changed in its emulated motor
BENCHES: dict[str, tuple[str, str, Changes]] = {
    "plain": ("A motor that is what the plain model says", "simulated", {}),
    "stribeck": (
        "Friction that falls with speed, and an unbalanced load",
        "simulated",
        {
            "fs_plus_V": 0.68, "fs_minus_V": 0.68, "fc_plus_V": 0.48, "fc_minus_V": 0.48, "stribeck_rad_s": 0.3,
            "bias_V": 0.0, "parts": {"force_sin_V": 0.06, "force_cos_V": 0.03},
        },
    ),
    "late": ("A bench that acts 25 ms later than it says", "simulated", {"delay_s": 0.025}),
    "quick": ("Tests that end when the motor is known, without a limit cycle", "quick", {}),
}  # fmt: skip


def main(folder: Path) -> int:
    """Run the benches; exit status 1 if one failed."""
    folder.mkdir(parents=True, exist_ok=True)
    failed = 0
    for name, (title, config, changes) in BENCHES.items():
        print(f"{title} ...", file=sys.stderr)
        whole = yaml.safe_load((ROOT / "config" / f"{config}.yaml").read_text(encoding="utf-8"))
        whole["name"] = name
        whole["emulated"]["motor"] |= changes
        with tempfile.TemporaryDirectory() as temporary:
            path = Path(temporary) / f"{name}.yaml"
            path.write_text(yaml.safe_dump(whole), encoding="utf-8")
            command = [sys.executable, "-m", "rig", "run", str(path), "--out", temporary, "--json"]
            done = subprocess.run(command, capture_output=True, text=True, check=False)
            if done.returncode:
                print(done.stderr, file=sys.stderr)
                failed = 1
                continue
            report = Path(json.loads(done.stdout)["folder"]) / "report.html"
            (folder / f"{name}.html").write_bytes(report.read_bytes())
    titles = {name: title for name, (title, *_) in BENCHES.items() if (folder / f"{name}.html").exists()}
    (folder / "titles.json").write_text(json.dumps(titles, indent=2) + "\n", encoding="utf-8")
    return failed


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1])))
