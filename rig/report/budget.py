"""The uncertainty budget of a run, in % of its estimate."""

from __future__ import annotations

import math

from rig.estimators import LEADING
from rig.identify.departures import DEPARTURES
from rig.report.source import ReportedRun
from rig.results import known


def budget_shares(run: ReportedRun) -> list[tuple[str, tuple[float, float, float]]]:
    """Lines of the budget, the whole first, in % of tau, K and fc; empty without a budget or an estimate."""
    result = run.result
    estimate = result.with_law or result.estimates.get(LEADING)
    if estimate is None or not result.u95:
        return []
    tau, gain, friction = (known(estimate.value(key)) for key in ("tau_s", "K_rad_s_V", "fc_V"))
    if not all(math.isfinite(v) and v > 0.0 for v in (tau, gain, friction)):
        return []
    titles = {law.name: law.title for law in DEPARTURES}
    lines = [("together", result.u95.get("tau_s"), result.u95.get("K_rad_s_V"), result.u95.get("fc_V"))]
    lines += [(titles.get(e.source, e.source), e.tau_s, e.K_rad_s_V, e.fc_V) for e in result.budget or ()]
    return [
        (source, (100.0 * known(a) / tau, 100.0 * known(b) / gain, 100.0 * known(c) / friction))
        for source, a, b, c in lines
    ]
