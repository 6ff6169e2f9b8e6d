"""Where an emulated shaft really was: read from the trace of a board, and told by the simulated driver."""

from __future__ import annotations

from pathlib import Path

import pytest
from simulated_bench import LIMITS, RAD_PER_COUNT, simulated_bench

from rig import config
from rig.backends.emulated.shaft import ShaftPath, traced
from rig.backends.registry import connect
from rig.control.law import Constant

ROOT = Path(__file__).resolve().parents[2]


def test_a_trace_is_read_while_it_grows(tmp_path: Path) -> None:
    trace = tmp_path / "truth.csv"
    trace.write_text("")
    assert traced(trace) == ShaftPath((), ())
    trace.write_text("t_s,drive_V,y_rad,v_rad_per_s,fault\n10.00,0.0,0.25,0.0,0\n10.01,1.0,0.26,0.5,0\n10.02,1.0,0.2")
    assert traced(trace) == ShaftPath([10.0, 10.01], [0.25, 0.26])


def test_the_simulated_driver_tells_the_shaft_at_each_reading() -> None:
    bench = simulated_bench()
    with bench.loop.armed(LIMITS):
        bench.loop.run(Constant(0.9, 0.3), "push")
    t_s, y_rad = bench.driver.shaft()
    rows = bench.record.rows
    assert len(t_s) == len(y_rad) >= len(rows)  # a last reading tells when the last drive acted
    assert y_rad[-1] > y_rad[0] + 0.02
    for row, y in zip(rows, y_rad, strict=False):
        assert abs(row["y_rad"] - 0.02 - y) < 5 * 0.003 + RAD_PER_COUNT  # noise and steps; its zero is 20 mrad off


def test_a_bench_tells_the_shaft_only_where_it_is_emulated() -> None:
    with connect(config.load(ROOT / "config/quick.yaml").device) as bench:
        assert bench.shaft is not None
        assert bench.shaft() == ShaftPath(bench.shaft().t_s, bench.shaft().y_rad)


@pytest.mark.parametrize("port", ["emulated", pytest.param("emulated-realtime", marks=pytest.mark.realtime)])
def test_an_emulated_board_tells_its_shaft_too(port: str) -> None:
    e = config.load(ROOT / "config/demo.yaml")
    with connect(e.model_copy(update={"daq": e.daq.model_copy(update={"port": port})}).device) as bench:
        assert bench.shaft is not None
        bench.driver.read()
        path = bench.shaft()
        assert len(path.t_s) == len(path.y_rad) > 0
        assert abs(path.t_s[-1] - bench.clock.now_s()) < 1.0
