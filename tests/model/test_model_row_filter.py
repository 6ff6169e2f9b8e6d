"""A linear filter along rows beside scipy's."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lfilter

from rig.model.compiled.row_filter import filtered


def test_each_piece_is_filtered_from_nothing_on() -> None:
    rows = np.random.default_rng(1).normal(size=(90, 3))
    forward, back = (0.4, -0.3, 0.1), (-1.2, 0.5)
    found = filtered(forward, back, rows, np.array([0, 40]))
    for part in (slice(0, 40), slice(40, 90)):
        assert found[part] == pytest.approx(lfilter(forward, (1.0, *back), rows[part], axis=0), rel=1e-12, abs=1e-12)
    assert filtered((0.0, 2.0), (-0.5,), rows) == pytest.approx(lfilter((0.0, 2.0), (1.0, -0.5), rows, axis=0))


def test_rows_that_are_not_there_are_refused() -> None:
    for first in ([0, 5], [-1, 2]):
        with pytest.raises(ValueError, match="increasing rows"):
            filtered((1.0,), (), np.zeros((4, 1)), np.array(first))
    with pytest.raises(ValueError, match="three numbers"):
        filtered((1.0,) * 4, (), np.zeros((4, 1)))
