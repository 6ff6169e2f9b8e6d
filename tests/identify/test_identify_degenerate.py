"""Any log that shows nothing, or next to nothing, is one line or a refusal with its reason; never a traceback.

Warnings are errors in every test, so that none of numpy's gets through either.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
from command_line import rig
from evidence import evidence, examples
from foreign_bench import PAPER, Columns, motor, plain_csv, relay, sampled, ticks
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st

from rig.identification import identify
from rig.identification.identification import METHODS
from rig.run_folder.recording.errors import IdentifyError, RecordingError
from rig.run_folder.recording.reader import read

pytestmark = pytest.mark.long

ROWS = (2, 3, 19, 20, 40, 76, 150, 300, 600)
REAL = sampled(motor(**PAPER), relay(PAPER["fc_V"]), ticks(max(ROWS)), 0.004)

# u(k) and y(k) of row k of n
DRIVES: dict[str, Callable[[np.ndarray, int], np.ndarray]] = {
    "real": lambda k, n: REAL["u_V"][:n],
    "zero": lambda k, n: 0.0 * k,
    "constant": lambda k, n: 0.0 * k + 1.2,
    "two levels": lambda k, n: np.where(k // 20 % 2, 1.0, -1.0),
    "three levels": lambda k, n: np.choose(k // 20 % 4, [1.5, 0.0, -1.5, 0.0]),
    "never switches": lambda k, n: np.where(k < n // 2, 1.5, 0.5),
    "one row": lambda k, n: np.where(k == n // 2, 1.0, 0.0),
    "once": lambda k, n: np.where(k < n // 2, 0.0, 1.0),
    "last row": lambda k, n: np.where(k < 3, 0.0, np.where(k < n - 1, 1.0, -1.0)),
    "dual relay": lambda k, n: np.select([k % 75 < 22, k % 75 < 37, k % 75 < 60], [1.56, 0.44, -1.56], -0.44),
    "equal gains": lambda k, n: np.select([k % 75 < 22, k % 75 < 37, k % 75 < 60], [1.56, 0.0, -1.56], 0.0),
    "chatter": lambda k, n: np.choose(k % 4, [1.56, 0.44, -1.56, -0.44]),
    "one relay": lambda k, n: np.where(k < min(10, n // 3), 0.0, np.where(k // 30 % 2, 1.2, -1.2)),
}
POSITIONS: dict[str, Callable[[np.ndarray, int], np.ndarray]] = {
    "real": lambda k, n: REAL["y_rad"][:n],
    "zero": lambda k, n: 0.0 * k,
    "constant": lambda k, n: 0.0 * k + 0.3,
    "one step": lambda k, n: np.where(k % 2, 0.0041, 0.0),
    "spike": lambda k, n: np.where(k == n // 2, 1.0, 0.0),
    "jump": lambda k, n: np.where(k < n // 2, 0.0, 0.5),
    "ramp": lambda k, n: 0.01 * k,
    "noise": lambda k, n: 0.003 * np.random.default_rng(1).standard_normal(n),
    "backwards": lambda k, n: -REAL["y_rad"][:n],
    "coarse": lambda k, n: 0.4 * np.round(REAL["y_rad"][:n] / 0.4),
    "sine": lambda k, n: 0.5 * np.sin(2.0 * np.pi * k / 75),
}
FACTORS = (1e-300, 1e-160, 1e-13, 1e-9, 1e-3, 1e3, 1e9, 1e13, 1e160, 1e300)


class Stretch(NamedTuple):
    """Rows of one stage: which drive and position, and what they are multiplied by and moved to."""

    rows: int
    drive: str
    position: str
    volts: float = 1.0
    radians: float = 1.0
    seconds: float = 1.0
    offset_rad: float = 0.0

    @property
    def is_real(self) -> bool:
        return self.drive == "real" and self.position in ("real", "backwards", "coarse")

    def columns(self) -> Columns:
        k = np.arange(self.rows)
        t_s = self.seconds * REAL["t_s"][: self.rows]
        return {
            "t_s": t_s,
            "u_V": self.volts * DRIVES[self.drive](k, self.rows),
            "y_rad": self.radians * POSITIONS[self.position](k, self.rows) + self.offset_rad,
            "t_u_s": t_s + 0.004 * self.seconds,
        }


def or_else(usual: float, others: tuple[float, ...]) -> st.SearchStrategy[float]:
    return st.sampled_from((usual,) * 12 + others)


STRETCH = st.builds(
    Stretch,
    st.sampled_from(ROWS),
    st.sampled_from(list(DRIVES)),
    st.sampled_from(list(POSITIONS)),
    or_else(1.0, (-1.0, *FACTORS)),
    or_else(1.0, FACTORS),
    or_else(1.0, FACTORS),
    or_else(0.0, (1.0, 1e3, -1e9, 1e11, 1e15, 1e160, -1e300)),
)
CONSTANT = Stretch(600, "dual relay", "constant")


def one_line(path: Path, others: list[Path], methods: tuple[str, ...] | None, may_be_ok: bool) -> None:
    """An error of one line and its cure, or estimates that are refused or doubted with a reason."""
    try:
        found = identify([read(p) for p in [path, *others]], methods)
    except (RecordingError, IdentifyError) as error:
        assert error.cause
        assert "\n" not in error.cause
        assert error.cure
        return
    for estimate in found.estimates.values():
        assert estimate.verdict == "ok" or estimate.reasons
        assert may_be_ok or estimate.verdict != "ok", (estimate.tau_s, estimate.K_rad_s_V, estimate.fc_V)
        estimate.as_result()


@settings(max_examples=examples(60), suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow])
@given(
    stretches=st.lists(STRETCH, min_size=1, max_size=2),
    methods=st.none() | st.sampled_from(METHODS).map(lambda method: (method,)),
    drive_times=st.booleans(),
)
@example([CONSTANT], None, True)
@example([CONSTANT], ("triple-relay",), False)
@example([CONSTANT, CONSTANT], ("describing-function",), True)
@example([Stretch(600, "dual relay", "sine"), CONSTANT], None, True)
@example([Stretch(600, "one relay", "constant"), Stretch(600, "one relay", "constant", 1.3)], ("least-squares",), True)
@example([Stretch(20, "real", "spike", radians=1e300)], ("describing-function",), True)
@example([Stretch(300, "never switches", "one step", volts=1e160, offset_rad=1e9)], ("sampled-data",), True)
def test_a_degenerate_log_is_a_line_or_a_refusal(
    tmp_path: Path, stretches: list[Stretch], methods: tuple[str, ...] | None, drive_times: bool
) -> None:
    names = ("t_s", "u_V", "y_rad", "t_u_s")[: 4 if drive_times else 3]
    paths = [plain_csv(tmp_path / f"{k}.csv", stretch.columns(), names) for k, stretch in enumerate(stretches)]
    one_line(paths[0], paths[1:], methods, any(stretch.is_real for stretch in stretches))


STAGES = ("breakaway", "search", "relay-1", "relay-2", "hysteretic-1", "hysteretic-2", "track:sampled-data")


@pytest.mark.evidence
@settings(max_examples=25, suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow])
@given(
    stages=st.dictionaries(st.sampled_from(STAGES), STRETCH, min_size=1, max_size=4),
    drive_times=st.booleans(),
)
@example({"relay-1": Stretch(600, "real", "real"), "relay-2": CONSTANT}, True)
@example({"breakaway": Stretch(300, "one row", "constant"), "relay-1": Stretch(600, "real", "real")}, True)
@example({"breakaway": Stretch(300, "one relay", "spike"), "relay-1": Stretch(600, "real", "real")}, True)
def test_a_run_with_a_degenerate_stage_is_a_line_or_a_refusal(
    tmp_path: Path, stages: dict[str, Stretch], drive_times: bool
) -> None:
    names = ("t_s", "u_V", "y_rad", "t_u_s")[: 4 if drive_times else 3]
    lines = [",".join([*names, "stage"])]
    begin_s = 0.0
    for stage, stretch in stages.items():
        columns = stretch._replace(seconds=1.0).columns()  # one clock for all stages
        for row in zip(*(columns[name].tolist() for name in names), strict=True):
            at = [begin_s + value if name.startswith("t") else value for name, value in zip(names, row, strict=True)]
            lines.append(",".join([*map(repr, at), stage]))
        begin_s += 0.01 * stretch.rows
    (tmp_path / "run.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")
    one_line(tmp_path / "run.csv", [], None, any(stretch.is_real for stretch in stages.values()))


@pytest.mark.parametrize("method", [None, *evidence(*METHODS)])
@pytest.mark.parametrize(
    "stretch",
    [
        Stretch(600, "real", "real", 1e300),
        *evidence((CONSTANT,), (Stretch(300, "constant", "ramp"),), (Stretch(600, "zero", "noise"),)),
    ],
    ids=lambda s: f"{s.drive}, {s.position}",
)
def test_the_command_says_it_in_lines_of_its_own(tmp_path: Path, stretch: Stretch, method: str | None) -> None:
    shorter = stretch._replace(rows=stretch.rows - 1)  # not the same file twice
    paths = [plain_csv(tmp_path / f"{s.rows}.csv", s.columns()) for s in (stretch, shorter)]
    result = rig("identify", *paths, *(() if method is None else ("--method", method)))
    assert isinstance(result.exception, SystemExit), result.exception
    assert result.exit_code in (1, 2)
    assert "Traceback" not in result.output
    if result.exit_code == 2:
        assert len(result.stderr.splitlines()) == 2
        assert result.stderr.startswith("rig: ")
    else:
        assert "refused" in result.stdout
