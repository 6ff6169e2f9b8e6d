"""The page: what was found in the record, beside what its authors published."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from emps.found import FAILS, Found, Prediction, prediction, published
from emps.prediction import moved_by
from emps.record import (
    FORCE_N_V,
    PUBLISHED,
    PUBLISHED_AT,
    PUBLISHED_FORCE_ERROR,
    PUBLISHED_POSITION_ERROR,
    Drive,
)
from shared.page import render, today

TEMPLATE = Path(__file__).with_name("page.md.j2")
DRIVE: tuple[tuple[str, Callable[[Drive], float]], ...] = (
    ("mass M, kg", lambda d: d.mass_kg),
    ("viscous friction, mean of the directions, N s/m", lambda d: d.viscous_N_s_m),
    ("viscous friction, half difference of the directions, N s/m", lambda d: d.viscous_half_N_s_m),
    ("Coulomb friction, N", lambda d: d.friction_N),
)
PREDICTIONS: tuple[tuple[str, Callable[[Prediction], str]], ...] = (
    ("pieces at 0, 4, 8, ... s, from their first 0.1 s", lambda p: f"{1e3 * p.even:.2f}"),
    ("pieces at 2, 6, 10, ... s, from their first 0.1 s", lambda p: f"{1e3 * p.odd:.2f}"),
    ("free run", lambda p: f"{1e3 * p.free:.2f}"),
    ("free run, relative to the motion", lambda p: f"{100.0 * p.share:.1f} %, {'fails' if p.fails else 'holds'}"),
    ("closed loop: force", lambda p: f"{p.loop_force:.2f} %"),
    ("closed loop: position", lambda p: f"{p.loop_position:.4f} %"),
)
HELD_OUT = "pieces at 2, 6, 10, ... s, from their first 0.1 s"


def page(whole: Found, half: Found) -> str:
    """The page as Markdown.

    whole, half   what was found in all of the record, and in every other piece
    """
    record, series = whole.record, whole.record.series
    laws = {name: [dict(one.sizes()).get(name, "-") for one in (whole, half)] for name in _titles(whole, half)}
    theirs = prediction(published(record), record)
    predictions = (theirs, whole.prediction, half.prediction)
    moves = moved_by(half.motor, record, FAILS)
    return render(
        TEMPLATE,
        today=today(),
        published_at=PUBLISHED_AT,
        duration_s=series.t_s[-1] - series.t_s[0],
        travel_mm=1e3 * np.ptp(series.y_rad),
        force_N_V=FORCE_N_V,
        drive=[(name, *(f"{of(one):.2f}" for one in (PUBLISHED, whole.drive, half.drive))) for name, of in DRIVE],
        laws=[(name, *sizes) for name, sizes in laws.items()],
        alike=[line.removeprefix("law: ") for line in whole.law.notes() if "told apart" in line],
        predictions=[(_held_out(name), *map(of, predictions)) for name, of in PREDICTIONS],
        fitted_mm=[1e3 * one.law.growth[0][1] for one in (whole, half)],
        plain_mm=1e3 * whole.plain_rms,
        verdict="Doubtful: its free run fails." if whole.prediction.fails else "Its free run holds.",
        fails=f"{100.0 * FAILS:g}",
        motion_mm=1e3 * float(np.std(series.y_rad)),
        moves_mm=[1e3 * move for move in moves.values()],
        theirs=(PUBLISHED_FORCE_ERROR, PUBLISHED_POSITION_ERROR),
        called=whole.estimate.verdict,
        reasons=whole.estimate.reasons,
    )


def _held_out(name: str) -> str:
    return f"{name} (held out in the last column)" if name == HELD_OUT else name


def _titles(*found: Found) -> list[str]:
    return list(dict.fromkeys(title for one in found for title, _ in one.sizes()))
