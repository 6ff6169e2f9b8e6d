"""The exercises print what their page shows, and the class finds in them what the page says."""

from __future__ import annotations

import contextlib
import io
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytestmark = pytest.mark.laws
PAGE = Path(__file__).resolve().parents[2] / "docs/exercises.md"
EXERCISES = re.findall(r"^```python\n(.*?)^```\n\n```\n(.*?)^```", PAGE.read_text(encoding="utf-8"), re.M | re.S)
NUMBER = re.compile(r"\d+(?:\.\d+)?")
TRUTH = {"tau_s": 0.17, "K_rad_s_V": 6.5, "fc_V": 0.48}


@pytest.fixture(scope="module")
def done() -> tuple[dict[str, Any], list[str]]:
    """What the code of the page leaves behind, by name; and what each exercise prints."""
    names: dict[str, Any] = {}
    printed = []
    for code, _ in EXERCISES:
        with contextlib.redirect_stdout(io.StringIO()) as out:
            exec(compile(code, PAGE.name, "exec"), names)
        printed.append(out.getvalue())
    return names, printed


@pytest.mark.evidence
def test_each_prints_what_the_page_shows(done: tuple[dict[str, Any], list[str]]) -> None:
    assert len(EXERCISES) == PAGE.read_text(encoding="utf-8").count("```python") == 3
    for (_, shown), printed in zip(EXERCISES, done[1], strict=True):
        assert NUMBER.sub("#", printed) == NUMBER.sub("#", shown)
        assert [*map(float, NUMBER.findall(printed))] == pytest.approx([*map(float, NUMBER.findall(shown))], rel=0.05)


def test_the_exact_cycle_is_where_faster_relays_tend_to(done: tuple[dict[str, Any], list[str]]) -> None:
    cycles = done[0]["cycles"]
    for key, sine_off in (("period_s", 0.12), ("amplitude_rad", 0.14)):
        exact = cycles["exact"][key]
        off = {name: cycle[key] / exact - 1.0 for name, cycle in cycles.items()}
        assert off["describing function"] == pytest.approx(sine_off, abs=0.01)
        # a relay that decides every T is late by up to T at each of a cycle's switches: longer cycles, never shorter
        assert 0.0 < off["simulated, 1 ms"] < off["simulated, 5 ms"] / 2.0 < off["simulated, 10 ms"] / 3.0
        assert off["simulated, 1 ms"] < 0.012


def test_a_second_amplitude_tells_a_drag_from_another_gain(done: tuple[dict[str, Any], list[str]]) -> None:
    known = done[0]["known"]
    one, two = known["plain", 1], known["plain", 2]
    assert (one.verdict, two.verdict, two.law) == ("doubtful", "ok", ())
    for key, truth in TRUTH.items():
        assert np.ptp(two.ci95[key]) < np.ptp(one.ci95[key]) / 2.5  # twice the rows alone: 1.4
        assert two.u95[key] < one.u95[key] / 3.5
        assert abs(getattr(two, key) - truth) < two.u95[key]
    one, two = known["fan", 1], known["fan", 2]
    assert one.verdict == "doubtful" and one.law == ()
    assert one.rms_rad == pytest.approx(known["plain", 1].rms_rad, rel=0.03)  # the fit does not show it
    assert TRUTH["K_rad_s_V"] - one.K_rad_s_V > 10.0 * np.ptp(one.ci95["K_rad_s_V"])
    assert [law.name for law in two.law] == ["drag"] and two.law[0].ci95[0] < 0.008 < two.law[0].ci95[1]
    assert all(abs(getattr(two, key) - truth) < two.u95[key] for key, truth in TRUTH.items())


def test_friction_that_is_not_compensated_is_the_tracking_error(done: tuple[dict[str, Any], list[str]]) -> None:
    rms_mrad = done[0]["rms_mrad"]
    noise_mrad = 1e3 * np.hypot(0.003, 0.004 / np.sqrt(12.0))
    assert rms_mrad[100] == pytest.approx(noise_mrad, rel=0.2)
    for percent in (0, 50, 150):
        left_V = abs(1.0 - percent / 100.0) * TRUTH["fc_V"]
        steady_mrad = 1e3 * TRUTH["K_rad_s_V"] * left_V / (TRUTH["tau_s"] * 144.0)
        assert 0.85 * steady_mrad < rms_mrad[percent] < steady_mrad
