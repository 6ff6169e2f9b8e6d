"""Runs every benchmark and writes bench.json: `make bench`, or `PYTHONPATH=tools python -m bench`."""

from __future__ import annotations

import json
import platform
import subprocess
import sys
from pathlib import Path

from rig.run_folder.recording.folder import write_whole

ROOT = Path(__file__).resolve().parents[2]
BENCHMARKS = (
    "device_relay", "identify_speed", "list_speed", "live_view", "modbus_latency", "motor_law_speed", "panel",
    "record_cost", "sampled_data_speed", "servo_loop", "servo_tick", "simulator_speed", "tick", "triple_relay_speed",
    "wake_up",
)  # fmt: skip


def main() -> int:
    """Run them one after the other, each in its own process; exit status 1 if one fails."""
    results: dict[str, object] = {"host": platform.platform(), "python": platform.python_version()}
    for name in BENCHMARKS:
        print(f"{name} ...", flush=True)
        done = subprocess.run(
            [sys.executable, "-m", f"bench.{name}", "--json"], capture_output=True, text=True, check=False
        )
        if done.returncode != 0:
            print(done.stderr, file=sys.stderr)
            return 1
        results[name] = json.loads(done.stdout)
        print(json.dumps(results[name], indent=2))
    write_whole(ROOT / "bench.json", (json.dumps(results, indent=2) + "\n").encode("utf-8"))
    print("written: bench.json")
    return 0


if __name__ == "__main__":
    sys.exit(main())
