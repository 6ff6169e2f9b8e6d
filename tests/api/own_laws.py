"""Laws as a user would write them: this one file adds them."""

from __future__ import annotations

from rig.core.signals import Sample


class Spring:
    """Pulls the shaft to a place, as a spring does, and damps it."""

    def __init__(self, to_rad: float = 0.3, stiffness_V_rad: float = 4.0, damping_V_s_rad: float = 0.3) -> None:
        if stiffness_V_rad <= 0.0:
            raise ValueError(f"stiffness_V_rad must be > 0, not {stiffness_V_rad:g}")
        self.yd_rad = to_rad
        self.stiffness_V_rad = stiffness_V_rad
        self.damping_V_s_rad = damping_V_s_rad
        self._last: Sample | None = None

    def step(self, sample: Sample) -> float:
        """Drive for this sample, V."""
        before, self._last = self._last, sample
        speed_rad_s = 0.0 if before is None else (sample.y_rad - before.y_rad) / (sample.t_s - before.t_s)
        return self.stiffness_V_rad * (self.yd_rad - sample.y_rad) - self.damping_V_s_rad * speed_rad_s


class Stumbles:
    """A law with a mistake in it: it divides by zero at its 30th sample."""

    def __init__(self) -> None:
        self._left = 30

    def step(self, sample: Sample) -> float:
        """Drive for this sample, V."""
        self._left -= 1
        return 3.0 / self._left


class Holds:
    """A law that must be told where."""

    def __init__(self, to_rad: float) -> None:
        self.yd_rad = to_rad

    def step(self, sample: Sample) -> float:
        """Drive for this sample, V."""
        return 4.0 * (self.yd_rad - sample.y_rad)


NO_LAW = object
