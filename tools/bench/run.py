"""Runs every benchmark of this folder and writes bench.json: ratios against a peer in the same run.

python tools/bench/run.py
"""

from __future__ import annotations

import json
import platform
import subprocess
import sys
from pathlib import Path

from rig.recording.folder import write_whole

HERE = Path(__file__).resolve().parent
ROOT = HERE.parent.parent
NO_BENCHMARKS = (Path(__file__).name, "solver_peer.py", "late_ticks.py")


def main() -> int:
    """Run them one after the other; exit status 1 if one fails."""
    results: dict[str, object] = {"host": platform.platform(), "python": platform.python_version()}
    scripts = sorted(path for path in HERE.glob("*.py") if path.name not in NO_BENCHMARKS)
    for script in scripts:
        print(f"{script.stem} ...", flush=True)
        done = subprocess.run([sys.executable, str(script), "--json"], capture_output=True, text=True, check=False)
        if done.returncode != 0:
            print(done.stderr, file=sys.stderr)
            return 1
        results[script.stem] = json.loads(done.stdout)
        print(json.dumps(results[script.stem], indent=2))
    write_whole(ROOT / "bench.json", (json.dumps(results, indent=2) + "\n").encode("utf-8"))
    print("written: bench.json")
    return 0


if __name__ == "__main__":
    sys.exit(main())
