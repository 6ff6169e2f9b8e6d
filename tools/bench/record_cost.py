"""What recording one row costs the loop: shared memory against a pipe and a flushed CSV line, in one run.

All three record the same row at the same pace, in turn within each tick, so that only their ratios are read: times
belong to the machine and to its load.

    PYTHONPATH=tools python -m bench.record_cost [--rows 1000] [--pace-ms 2] [--folder DIR] [--json]
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from bench.benchmark import options, tell
from rig.core.signals import Sample
from rig.run_folder.recording.layout import ROW
from rig.run_folder.recording.recorder import Recorder
from rig.run_folder.recording.sample_columns import SampleRow, format_row
from shared.table import markdown

BASE = "shared memory"


def measure(rows: int, pace_s: float, folder: Path) -> dict[str, dict[str, float]]:
    """Median and 99th percentile of each way, us, and their ratios to the recorder's."""
    recorder = Recorder(folder, ["relay-1"])
    sink = subprocess.Popen(["cat"], stdin=subprocess.PIPE, stdout=subprocess.DEVNULL, bufsize=0)
    assert sink.stdin is not None
    pipe = sink.stdin
    with (folder / "flushed.csv").open("w") as csv:

        def to_memory(tick: int, t_s: float, y_rad: float) -> None:
            recorder.sample(tick, Sample(t_s, y_rad, 512, seq=tick), "relay-1", 0.1, 0.2, 1.8, 12.0, 1500.0, 0)
            recorder.complete(t_s + 0.0034, 1.75)

        def to_pipe(tick: int, t_s: float, y_rad: float) -> None:
            row = (tick, tick, t_s, y_rad, 512, 0.0, 1.75, 0.1, 0.2, 0, 12.0, 1500.0, 0, t_s + 0.0034, 1.75, 0, 0)
            pipe.write(ROW.pack(*row))

        def to_csv(tick: int, t_s: float, y_rad: float) -> None:
            row = (y_rad, 512, 0.0, 1.75, 0.1, 0.2, "relay-1", 12.0, 1500.0, 0)
            csv.write(format_row(SampleRow(tick, tick, t_s, t_s + 0.0034, *row)))
            csv.flush()

        ways: dict[str, Callable[[int, float, float], None]] = {
            BASE: to_memory,
            "pipe": to_pipe,
            "flushed CSV": to_csv,
        }
        times_us: dict[str, list[float]] = {name: [] for name in ways}
        names = list(ways)
        for tick in range(rows):
            time.sleep(pace_s)
            first = tick % len(names)  # whoever comes first after the sleep pays for cold caches
            for name in names[first:] + names[:first]:
                begin = time.perf_counter_ns()
                ways[name](tick, 0.01 * tick, 0.1 + 1e-6 * tick)
                times_us[name].append((time.perf_counter_ns() - begin) / 1e3)
    pipe.close()
    sink.wait()
    recorder.close()

    quantiles = {name: np.percentile(times, [50, 99]) for name, times in times_us.items()}
    base = quantiles[BASE]
    return {
        name: {
            "median_us": float(median),
            "p99_us": float(p99),
            "median_ratio": float(median / base[0]),
            "p99_ratio": float(p99 / base[1]),
        }
        for name, (median, p99) in quantiles.items()
    }


def main() -> int:
    """Measure and print."""
    parser = options("What recording one row costs the loop.")
    parser.add_argument("--rows", type=int, default=1000)
    parser.add_argument("--pace-ms", type=float, default=2.0)
    parser.add_argument("--folder", type=Path, default=None, help="where to write (default: a temporary folder)")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory(dir=arguments.folder) as folder:
        result = measure(arguments.rows, arguments.pace_ms / 1e3, Path(folder))
    columns = ("median_us", "p99_us", "median_ratio", "p99_ratio")
    rows = ((name, *(f"{way[column]:.3g}" for column in columns)) for name, way in result.items())
    tell(result, as_json=arguments.json, text=markdown(("way", *columns), rows))
    return 0


if __name__ == "__main__":
    sys.exit(main())
