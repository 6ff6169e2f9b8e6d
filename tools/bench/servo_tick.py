"""What a tick on a servo's bus costs beyond its bytes: rig's driver beside a bare client, in one run.

PYTHONPATH=tools python -m bench.servo_tick [--json] [--rounds N]

A tick is two exchanges: the reading of all that a tick needs, and the duty, which an answer confirms. Both clients use
the same open port, with an emulated servo in a process of its own behind it, in turns. The bare one writes finished
bytes and waits for as many as the answer has. The processor's time is that of this thread alone. A Feetech, which tells
no clock, must be asked at another place within its step of 1 ms in each tick, or all times are wrong by as much: both
clients wait so, half a step a tick in the mean.
"""

from __future__ import annotations

import gc
import itertools
import json
import os
import select
import statistics
import sys
import time
from collections.abc import Callable
from pathlib import Path

from bench.benchmark import options, tell
from rig.backends.registry import connect
from rig.backends.servo.bus import bus_of
from rig.backends.servo.line import servo_of
from rig.backends.servo.registers import servo_map
from rig.backends.servo.steps import STEP_S
from rig.config import load

ROOT = Path(__file__).resolve().parents[2]
CONFIGS = {"dynamixel": "servo.yaml", "feetech": "servo-sts3215.yaml"}
EXCHANGES = 2  # of a tick
GOLDEN = 0.618  # its multiples are spread evenly
PAUSE_S = 0.005  # between two ticks of one client
SILENCE_S = 0.9  # that this process may be held up by others
WARM_UP = 50
TIMEOUT_S = 0.9
GOAL_CPU_US, GOAL_OVER_BARE_MS = 60.0, 0.1  # of one exchange

Tick = Callable[[], object]


def bare(descriptor: int, exchanges: list[tuple[bytes, int]], *, asks_elsewhere: bool) -> Tick:
    """Finished bytes out, as many bytes back as the answer has; ``asks_elsewhere``: within the step, each time."""
    place = itertools.count()

    def tick() -> None:
        if asks_elsewhere:
            select.select([descriptor], [], [], STEP_S * (next(place) * GOLDEN % 1.0))
        for request, expected in exchanges:
            os.write(descriptor, request)
            left = expected
            while left > 0:
                if not select.select([descriptor], [], [], TIMEOUT_S)[0]:
                    raise TimeoutError("the emulated servo does not answer the bare client")
                left -= len(os.read(descriptor, 256))

    return tick


def measured(name: str, rounds: int) -> dict[str, dict[str, list[float]]]:
    """Time and processor's time of each tick, us, by client."""
    experiment = load(ROOT / "config" / name)
    daq = experiment.daq.model_copy(update={"port": "emulated-realtime", "watchdog_s": SILENCE_S, "timeout_s": 0.5})
    experiment = experiment.model_copy(update={"daq": daq})
    servo = servo_of(experiment.device)
    bus, read = bus_of(servo.table, servo.id, daq.baud), servo_map(servo.table).read
    drive = servo.table.role("drive")
    answer = len(bus.confirmed())
    finished = [
        (bus.reading(read.address, read.words, "").data, answer + read.words),
        (bus.writing(drive.address, drive.pack(0), "").data, answer),
    ]
    with connect(experiment.device) as line:
        driver = line.driver
        driver.arm(experiment.device.arming)
        descriptor = getattr(driver, "descriptor", None)
        assert isinstance(descriptor, int)

        def ours() -> None:
            driver.read()
            driver.write(0.0)

        asks_elsewhere = "tick" not in servo.table.roles
        ticks = {"rig": ours, "bare": bare(descriptor, finished, asks_elsewhere=asks_elsewhere)}
        taken: dict[str, dict[str, list[float]]] = {who: {"wall": [], "cpu": []} for who in ticks}
        gc.collect()
        gc.disable()
        for k in range(WARM_UP + rounds):
            for who, tick in ticks.items():
                time.sleep(PAUSE_S)
                wall, cpu = time.perf_counter(), time.thread_time()
                tick()
                cpu, wall = time.thread_time() - cpu, time.perf_counter() - wall
                if k >= WARM_UP:
                    taken[who]["wall"].append(1e6 * wall)
                    taken[who]["cpu"].append(1e6 * cpu)
        gc.enable()
        driver.safe_stop()
    return taken


def summary(taken: dict[str, dict[str, list[float]]]) -> dict[str, float]:
    """Medians of one exchange: what the processor and the clock say, and what of it is beyond the bare client's."""
    one = {
        (who, what): statistics.median(us) / EXCHANGES for who, by_kind in taken.items() for what, us in by_kind.items()
    }
    return {
        "cpu_us": one["rig", "cpu"],
        "bare_cpu_us": one["bare", "cpu"],
        "cpu_beyond_bare_us": one["rig", "cpu"] - one["bare", "cpu"],
        "cpu_over_bare": one["rig", "cpu"] / one["bare", "cpu"],
        "wall_ms": 1e-3 * one["rig", "wall"],
        "bare_wall_ms": 1e-3 * one["bare", "wall"],
        "over_bare_ms": 1e-3 * (one["rig", "wall"] - one["bare", "wall"]),
    }


def main() -> int:
    """Both protocols, one after the other."""
    parser = options("A tick on a servo's bus beyond its bytes.")
    parser.add_argument("--rounds", type=int, default=300)
    arguments = parser.parse_args()
    result: dict[str, object] = {
        "rounds": arguments.rounds, "goal_cpu_us": GOAL_CPU_US, "goal_over_bare_ms": GOAL_OVER_BARE_MS,
    }  # fmt: skip
    for protocol, name in CONFIGS.items():
        result[protocol] = summary(measured(name, arguments.rounds))
    tell(result, as_json=arguments.json, text=json.dumps(result, indent=2))
    return 0


if __name__ == "__main__":
    sys.exit(main())
