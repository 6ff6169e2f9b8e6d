"""Distribution functions beside scipy's."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import special

from rig.identification.chance import (
    chi_squared_beyond,
    chi_squared_quantile,
    log_normal_below,
    normal_below,
    student_975,
)

FREEDOMS = (0.7, 1.0, 2.0, 3.4, 10.0, 29.9, 30.0, 55.5, 1e3, 1e6)


def test_normal() -> None:
    x = np.concatenate((-np.geomspace(1e-3, 300.0, 200), np.geomspace(1e-3, 300.0, 200))).reshape(4, 100)
    assert normal_below(x) == pytest.approx(special.ndtr(x), rel=1e-12, abs=1e-300)
    assert log_normal_below(x) == pytest.approx(special.log_ndtr(x), rel=1e-9, abs=1e-15)


@pytest.mark.parametrize("freedom", FREEDOMS)
def test_student_and_chi_squared(freedom: float) -> None:
    assert student_975(freedom) == pytest.approx(float(special.stdtrit(freedom, 0.975)), rel=1e-7)
    for square in freedom * np.array([0.0, 0.01, 0.5, 0.99, 1.01, 1.5, 3.0, 20.0]):
        wanted = float(special.chdtrc(freedom, square))
        assert chi_squared_beyond(freedom, float(square)) == pytest.approx(wanted, rel=1e-8, abs=1e-14)
    for chance in (1e-6, 0.01, 0.5, 0.99):
        assert chi_squared_quantile(freedom, chance) == pytest.approx(float(special.chdtri(freedom, chance)), rel=1e-7)
