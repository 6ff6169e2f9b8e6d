"""Theorem 2.1's "only one set of positive solutions", and where the cycle exists, is stable, and how soon it is there.

Dimensionless: gains and friction in h2, time in tau, so that a = h1 / h2 and b = fc / h2 are all that the shape depends
on (which is checked here, too).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure

from paper import switching
from paper.drawing import Array, finish, new_figure
from paper.ideal_relay import Relay, ideal_relay, settled_cycle
from paper.page import Claim, Comparison, Heading, Paragraph, Remark, Section
from rig.model.friction import coulomb
from rig.model.limit_cycle import LimitCycle, NoLimitCycle, limit_cycle
from rig.model.motor import Motor, State
from rig.output.report.style import Picture
from shared.table import Cell, Table, significant

A_RANGE = (0.05, 3.0)  # h1 / h2
A_FARTHEST = 300.0  # of the scan beyond the map
A_SOLVED = 1000.0  # h1 / (h2 - fc) up to which the conditions are above rounding: t1 falls as its square
A_TICKS = (0.05, 0.1, 0.3, 1.0, 3.0)
B_MOST = 0.96  # largest fc / h2 of those below 1
B_BEYOND = (1.0, 1.1)  # where Property 3.1 allows no cycle
SETTLED = 0.01  # of the distance at the start
TOLERANCE = 1e-8  # of a simulated cycle that has settled, from one half period to the next
AGREED = 1e-5  # relative, of durations
FACTORS = (0.01, 10.0)  # random initial states, in the cycle's own largest v, y, z
MOST_HALF_PERIODS = 2000
TRAPPED = (3.0, 0.2, (0.0, 0.5, 20.0))  # a, b; v, y, z in the cycle's own: rest beside the cycle
SCALES = ((0.17, 6.5, 1.0), (0.35, 3.0, 1.35), (2.0, 0.4, 7.0))  # tau, s, K, (rad/s)/V, h2, V
COUNTED = ListedColormap(["#d9b8b8", "#8fc9a8", "#9a1b1b"])  # none, one, more
SEED = 21


@dataclass(frozen=True)
class Place:
    """One pair of a and b.

    scan, search    the conditions' positive solutions, by both methods
    cycle           of ``rig.model.limit_cycle``; None where it says that there is none
    difference      of its durations from the search's only solution, relative; nan without one
    """

    a: float
    b: float
    scan: switching.Scan
    search: switching.Search
    cycle: LimitCycle | None
    difference: float

    @property
    def unique(self) -> bool:
        """One solution by either method, the same, and no additional switching."""
        return self.scan == (1, 1) and len(self.search.solutions) == 1 and self.difference < AGREED

    @property
    def none(self) -> bool:
        """No solution by any method."""
        return self.scan.crossings == 0 and not self.search.solutions and self.cycle is None

    @property
    def radius(self) -> float:
        """Largest magnitude of an eigenvalue of the half period's map."""
        return math.nan if self.cycle is None else float(np.abs(self.cycle.eigenvalues()).max())

    @property
    def cycles_to_settle(self) -> float:
        """Periods until a small distance has fallen to ``SETTLED`` of it."""
        return math.log(SETTLED) / (2.0 * math.log(self.radius))


@dataclass(frozen=True)
class Visit:
    """The loop itself at one pair of a and b, by the event-driven simulator.

    starts, arrived   initial states, and how many came to the simple cycle of Theorem 2.1
    rested            how many came to rest, or were still switching ever faster
    worst             largest relative difference of the settled durations from the theorem's
    derivative        eigenvalues of the map from one switching of RC to the next, by differences, (2,)
    predicted         those of J (Theorem 2.2), without the one along the plane, (2,)
    """

    a: float
    b: float
    starts: int
    arrived: int
    rested: int
    worst: float
    derivative: Array
    predicted: Array

    @property
    def share(self) -> float:
        """Of the initial states that came to the cycle."""
        return self.arrived / self.starts

    @property
    def holds_the_position(self) -> bool:
        """h1 > h2 + fc: the position's relay alone overcomes the integral's and friction."""
        return self.a > 1.0 + self.b


@dataclass(frozen=True)
class Result:
    """The map.

    places     in rows of constant b
    far        beyond the map, up to ``A_FARTHEST``
    visits     likewise, on a coarser grid
    searches   arrivals that each random search waited for
    scaling    largest relative difference of the dimensionless numbers between motors
    trapped    how a run from ``TRAPPED`` ends
    """

    a: Array
    b: Array
    places: tuple[tuple[Place, ...], ...]
    far: tuple[Place, ...]
    visits: tuple[tuple[Visit, ...], ...]
    searches: int
    scaling: float
    trapped: str

    @property
    def below(self) -> list[Place]:
        """Where h2 > fc."""
        return [place for row in self.places for place in row if place.b < 1.0]

    @property
    def beyond(self) -> list[Place]:
        """Where h2 <= fc."""
        return [place for row in self.places for place in row if place.b >= 1.0]

    @property
    def visited(self) -> list[Visit]:
        """All of them."""
        return [visit for row in self.visits for visit in row]

    def visited_where(self, holds: bool) -> list[Visit]:
        """Those with h1 > h2 + fc, or the others."""
        return [visit for visit in self.visited if visit.holds_the_position == holds]


def compute(side: int = 15, searches: int = 10, visits: int = 7, starts: int = 8) -> Result:
    """The map of ``side`` by about as many pairs, as many beyond it, the loop itself on a grid of ``visits`` squared.

    searches   random starts of the equations that must end in a solution at each pair
    starts     random initial states of the loop at each
    """
    rng = np.random.default_rng(SEED)
    a = np.geomspace(*A_RANGE, side)
    b = np.concatenate((np.linspace(0.0, B_MOST, side), B_BEYOND))
    places = tuple(tuple(_place(x, y, searches, rng) for x in a.tolist()) for y in b.tolist())
    a_far, b_far = np.geomspace(A_RANGE[1], A_FARTHEST, side + 1)[1:], np.linspace(0.0, B_MOST, side)
    pairs = [(x, y) for y in b_far.tolist() for x in a_far.tolist() if x / (1.0 - y) <= A_SOLVED]
    far = tuple(_place(x, y, searches, rng) for x, y in pairs)
    a_visited, b_visited = np.geomspace(*A_RANGE, visits), np.linspace(0.0, 0.9, visits)
    seen = tuple(tuple(_visit(x, y, starts, rng) for x in a_visited.tolist()) for y in b_visited.tolist())
    return Result(a, b, places, far, seen, searches, _scaling(a[:: max(1, side // 4)]), _trapped())


def _place(a: float, b: float, searches: int, rng: np.random.Generator) -> Place:
    search = switching.from_random_starts(a, b, searches, rng)
    try:
        cycle = limit_cycle(1.0, 1.0, b, a, 1.0)
    except NoLimitCycle:
        cycle = None
    difference = math.nan
    if cycle is not None and search.solutions:
        difference = max(
            abs(ours / theirs - 1.0) for ours, theirs in zip(cycle.durations_s, search.solutions[0], strict=True)
        )
    return Place(a, b, switching.by_scan(a, b), search, cycle, difference)


def _sizes(cycle: LimitCycle) -> Array:
    """Largest v, y and z of the cycle."""
    return np.asarray(np.abs(cycle.states).max(axis=0))


def _visit(a: float, b: float, starts: int, rng: np.random.Generator) -> Visit:
    cycle = limit_cycle(1.0, 1.0, b, a, 1.0)
    motor = Motor(1.0, 1.0, coulomb(b))
    arrived = rested = 0
    worst = 0.0
    for _ in range(starts):
        factors = np.exp(rng.uniform(math.log(FACTORS[0]), math.log(FACTORS[1]), 3)) * rng.choice((-1.0, 1.0), 3)
        start = State(*(factors * _sizes(cycle)).tolist())
        try:
            half = settled_cycle(motor, a, 1.0, start, TOLERANCE, MOST_HALF_PERIODS)
        except NoLimitCycle:
            rested += 1
            continue
        if half.is_simple:
            arrived += 1
            pairs = zip(half.durations_s, cycle.durations_s, strict=True)
            worst = max(worst, *(abs(ours / theory - 1.0) for ours, theory in pairs))
    predicted = cycle.eigenvalues()[:2].real
    return Visit(a, b, starts, arrived, rested, worst, _derivative(motor, Relay(a, 1.0), cycle), predicted)


def _derivative(motor: Motor, relay: Relay, cycle: LimitCycle, step: float = 1e-5) -> Array:
    """Eigenvalues of the one-return map of (v, y) from one switching of RC to the next, by differences."""
    v, y, _ = cycle.states[0].tolist()
    scale = np.array([cycle.speed_rad_s, cycle.amplitude_rad])

    def next_one(shift: Array) -> Array:
        start = State(v + float(shift[0] * scale[0]), y + float(shift[1] * scale[1]), 0.0)
        run = ideal_relay(motor, relay, start, 0.8 * cycle.period_s, (-1.0, -1.0))
        state = next(event.state for event in run.events if event.kind == "integral")
        return np.asarray(np.array([state.v, state.y]) / scale)

    columns = [(next_one(step * unit) - next_one(-step * unit)) / (2.0 * step) for unit in np.eye(2)]
    values = np.linalg.eigvals(np.column_stack(columns))
    return np.asarray(values[np.argsort(-np.abs(values))].real)


def _scaling(a: Array) -> float:
    """Largest relative difference of durations / tau, positions / (K tau h2) and the largest eigenvalue."""
    worst = 0.0
    for ratio in a.tolist():
        for b in (0.0, 0.4, 0.8):
            one = limit_cycle(1.0, 1.0, b, ratio, 1.0)
            for tau, K, h2 in SCALES:
                other = limit_cycle(tau, K, b * h2, ratio * h2, h2)
                pairs = [
                    *zip(other.durations_s, (tau * t for t in one.durations_s), strict=True),
                    (other.amplitude_rad, K * tau * h2 * one.amplitude_rad),
                    (np.abs(other.eigenvalues()).max(), np.abs(one.eigenvalues()).max()),
                ]
                worst = max(worst, *(abs(float(x) / float(y) - 1.0) for x, y in pairs))
    return worst


def _trapped() -> str:
    """What becomes of the run from ``TRAPPED``: the simulator's words."""
    a, b, factors = TRAPPED
    cycle = limit_cycle(1.0, 1.0, b, a, 1.0)
    start = State(*(np.array(factors) * _sizes(cycle)).tolist())
    return ideal_relay(Motor(1.0, 1.0, coulomb(b)), Relay(a, 1.0), start, 100.0).end


def unique(result: Result) -> Claim:
    """Theorem 2.1: one set of positive solutions wherever h2 > fc, by the scan and from random starts alike."""
    return Claim(all(place.unique for place in (*result.below, *result.far)))


def none_beyond(result: Result) -> Claim:
    """Property 3.1: no solution where h2 <= fc."""
    return Claim(all(place.none for place in result.beyond))


def stable(result: Result) -> Claim:
    """Every cycle of the map is locally stable."""
    return Claim(all(place.radius < 1.0 for place in result.below))


def derived(result: Result) -> Claim:
    """The loop's own one-return derivative has the eigenvalues of Theorem 2.2."""
    return Claim(all(np.abs(visit.derivative - visit.predicted).max() < 1e-3 for visit in result.visited))


def reached(result: Result) -> Claim:
    """Every random initial state comes to the one cycle where h1 <= h2 + fc."""
    return Claim(all(v.arrived == v.starts and v.worst < AGREED for v in result.visited_where(False)))


def section(result: Result) -> Section:
    """Its part of the page."""
    below, beyond = result.below, result.beyond
    fastest = min(below, key=lambda place: place.radius)
    slowest = max(below, key=lambda place: place.radius)
    solved, tried = (sum(getattr(place.search, count) for place in below) for count in ("arrived", "tried"))
    apart = max(place.difference for place in (*below, *result.far))
    one = unique(result)
    exceptions = [place for place in (*below, *result.far) if not place.unique]
    exceptions_below = [place for place in below if not place.unique]
    blocks = (
        Paragraph(
            "Theorem 2.1 has three equations for t<sub>1</sub>, t<sub>2</sub>, t<sub>3</sub> and says that they have "
            "only one set of positive solutions. Time in τ and drive in h<sub>2</sub> leave two numbers, a = "
            "h<sub>1</sub>"
            "/h<sub>2</sub> and b = f<sub>c</sub>/h<sub>2</sub>: for "
            f"{len(SCALES)} motors of other τ, K and h<sub>2</sub> durations/τ, positions/(Kτh<sub>2</sub>) and "
            f"eigenvalues are the same to {significant(result.scaling, 1)}. So a map over a and b is one over all "
            "motors "
            "and gains."
        ),
        Heading("Existence and uniqueness"),
        Paragraph(
            "Two ways to look for solutions, with nothing of the program's own solver in them. A scan goes through "
            f"every t<sub>3</sub> from {_plain(switching.SCANNED_TAU[0])} to {_plain(switching.SCANNED_TAU[1])} τ on "
            "a fine grid, finds every t<sub>2</sub> for which v(t<sub>1</sub>) = 0 and y(t<sub>1</sub> + "
            "t<sub>2</sub>) "
            "= 0, and counts where z(0) changes sign along them. And Powell's method solves the three equations from "
            f"random starts, every duration from {_plain(switching.START_TAU[0])} to "
            f"{_plain(switching.START_TAU[1])} τ, "
            f"until {result.searches} of them have come to a solution or {switching.MOST_STARTS} have been tried: of "
            f"{tried} starts where h<sub>2</sub> &gt; f<sub>c</sub> {solved} came to one, the others to none."
        ),
        _count_table(result),
        Remark(
            one.agreement,
            f"{one.says('Only one set of positive solutions', 'Not one set of positive solutions')} at "
            f"{len(below) - len(exceptions_below)} of {len(below)} pairs of a and b with h<sub>2</sub> &gt; "
            f"f<sub>c</sub>, a from {A_RANGE[0]:g} to {A_RANGE[1]:g} and b from {result.b[0]:g} to {B_MOST:g}, and at "
            f"{sum(place.unique for place in result.far)} of {len(result.far)} beyond, to a = {A_FARTHEST:g}, where "
            f"h<sub>1</sub>/(h<sub>2</sub> − f<sub>c</sub>) is at most {A_SOLVED:g} (with more, t<sub>1</sub> is lost "
            f"in rounding){_exception_words(exceptions)}. The program's own solver differs from it by at most "
            f"{significant(apart, 1)}, and no relay switches additionally there. This is a computation, not a proof.",
        ),
        Remark(
            none_beyond(result).agreement,
            "Where h<sub>2</sub> ≤ f<sub>c</sub> "
            f"{none_beyond(result).says('there is no solution', 'there are solutions')} at any of {len(beyond)} "
            f"pairs (b = {' and '.join(f'{b:g}' for b in B_BEYOND)}): Property 3.1. With a "
            f"static friction f<sub>s</sub> ≥ h<sub>1</sub> + h<sub>2</sub> the motor sticks: {_sticking_words()}.",
        ),
        Heading("Stability and convergence"),
        Remark(
            stable(result).agreement,
            f"{stable(result).says('Every', 'Not every')} cycle of the map is stable: the largest eigenvalue of the "
            "half "
            f"period is {significant(fastest.radius, 3)} (a = {significant(fastest.a, 2)}, b = "
            f"{significant(fastest.b, 2)}) to {significant(slowest.radius, 3)} (a = {significant(slowest.a, 2)}, b = "
            f"{significant(slowest.b, 2)}) in magnitude, which is {fastest.cycles_to_settle:.1f} to "
            f"{slowest.cycles_to_settle:.0f} periods until a small distance has fallen to {100.0 * SETTLED:g} %.",
        ),
        _map_figure(result),
        _derivative_remark(result),
        Heading("From any initial state?"),
        Paragraph(_reach_words(result)),
        _reach_remark(result),
    )
    return Section("theorem-2-1", "Theorem 2.1", "Theorem 2.1: one cycle, where, and how soon", blocks,
                   _comparisons(result))  # fmt: skip


def _plain(value: float) -> str:
    return f"{value:g}"


def _exception_words(exceptions: list[Place]) -> str:
    if not exceptions:
        return ""
    named = [f"(a = {p.a:.3g}, b = {p.b:.3g}: {p.scan.crossings} by scan, {len(p.search.solutions)} by search)"
             for p in exceptions]  # fmt: skip
    return "; not at " + ", ".join(named)


def _sticking_words() -> str:
    """What the program says of gains whose sum does not exceed static friction."""
    try:
        limit_cycle(1.0, 1.0, 0.5, 0.4, 1.0, 1.5)
    except NoLimitCycle as reason:
        return f"“{reason}”"
    return "yet the program finds a cycle"


def _derivative_remark(result: Result) -> Remark:
    largest = max(float(np.abs(visit.derivative - visit.predicted).max()) for visit in result.visited)
    claim = derived(result)
    return Remark(
        claim.agreement,
        f"The loop itself, switched at its very crossings, {claim.says('returns', 'does not return')} as Theorem 2.2 "
        "says: "
        f"the derivative of its map from one switching of RC to the next, by differences at {len(result.visited)} "
        "pairs, "
        f"has the eigenvalues of J within {significant(largest, 1)}.",
    )


def _reach_words(result: Result) -> str:
    return (
        "Uniqueness of the solution and local stability do not say that the loop gets there. At "
        f"{len(result.visited)} pairs it runs from {result.visited[0].starts} random initial states each, v, y and z "
        f"{FACTORS[0]:g} to {FACTORS[1]:g} times the cycle's own, of either sign."
    )


def _reach_remark(result: Result) -> Remark:
    weak, strong = result.visited_where(False), result.visited_where(True)
    worst = max(visit.worst for visit in weak)
    claim = reached(result)
    a, b, factors = TRAPPED
    trapped = {"chatter": "comes to rest on y = 0", "held": "is held by friction", "time": "still moves"}[
        result.trapped
    ]
    return Remark(
        "ours",
        f"Where h<sub>1</sub> ≤ h<sub>2</sub> + f<sub>c</sub> {_counted(weak)} come to the cycle of Theorem 2.1 "
        f"(durations within {significant(worst, 1)}). Where h<sub>1</sub> &gt; h<sub>2</sub> + f<sub>c</sub> "
        f"{_counted(strong)} do, and from {sum(visit.rested for visit in strong)} the loop comes to rest or switches "
        "ever "
        "faster without RC: the position's relay alone can hold the shaft at y = 0, where the integral stands still. "
        "For "
        f"instance with a = {a:g}, b = {b:g} the loop {trapped} from (v, y, z) = "
        f"({', '.join(f'{f:g}' for f in factors)}) times the cycle's own. The theorem says where the cycle is, not "
        "that "
        f"every start leads to it; with h<sub>1</sub> ≤ h<sub>2</sub> + f<sub>c</sub> every start here "
        f"{claim.says('did', 'did not')}.",
    )


def _counted(visits: list[Visit]) -> str:
    return f"{sum(v.arrived for v in visits)} of {sum(v.starts for v in visits)} initial states"


def _comparisons(result: Result) -> tuple[Comparison, ...]:
    below = result.below
    weak, strong = result.visited_where(False), result.visited_where(True)
    return (
        Comparison(
            "Theorem 2.1",
            "only one set of positive solutions",
            "as stated",
            f"one at {sum(place.unique for place in (*below, *result.far))} of {len(below) + len(result.far)} pairs "
            f"with h<sub>2</sub> &gt; f<sub>c</sub>, to h<sub>1</sub>/h<sub>2</sub> = {A_FARTHEST:g}; none "
            f"at {sum(place.none for place in result.beyond)} of {len(result.beyond)} with "
            "h<sub>2</sub> ≤ f<sub>c</sub>",
            Claim(unique(result).holds and none_beyond(result).holds).agreement,
            "by a scan and from random starts; not a proof",
        ),
        Comparison(
            "Theorem 2.2",
            "stable",
            "a condition",
            f"{sum(place.radius < 1.0 for place in below)} of {len(below)} stable",
            Claim(stable(result).holds and derived(result).holds).agreement,
            f"the loop's own derivative agrees at {len(result.visited)} pairs",
        ),
        Comparison(
            "Theorem 2.1",
            "initial states that come to the cycle",
            "",
            f"{_counted(weak)} where h<sub>1</sub> ≤ h<sub>2</sub> + f<sub>c</sub>, {_counted(strong)} elsewhere",
            "not comparable",
            f"the theorem does not say; {sum(visit.rested for visit in strong)} of the latter come to rest",
        ),
    )


def _whole(count: int) -> Cell:
    return Cell(str(count), float(count))


def _count_table(result: Result) -> Table:
    groups = (
        ("h<sub>2</sub> &gt; f<sub>c</sub>", result.below),
        ("h<sub>2</sub> ≤ f<sub>c</sub>", result.beyond),
    )
    rows = []
    for name, places in groups:
        scans = sorted({place.scan.crossings for place in places})
        searched = sorted({len(place.search.solutions) for place in places})
        rows.append((
            Cell(name), _whole(len(places)), Cell(" or ".join(map(str, scans)), float(max(scans))),
            Cell(" or ".join(map(str, searched)), float(max(searched))),
            _whole(sum(place.search.arrived for place in places)),
            _whole(sum(place.cycle is not None for place in places)),
        ))  # fmt: skip
    return Table(
        ("", "pairs (a, b)", "solutions by scan", "solutions from random starts", "starts that came to one",
         "cycles without additional switching"),
        tuple(rows),
        "How many sets of positive durations satisfy the switching conditions.",
    )  # fmt: skip


def _map_figure(result: Result) -> Picture:
    figure = new_figure(7.4)
    panels = figure.subplots(2, 2)
    a, b = result.a, result.b
    counts = np.array([[min(place.scan.crossings, 2) for place in row] for row in result.places], dtype=float)
    radius = np.array([[place.radius for place in row] for row in result.places])
    settle = np.array([[place.cycles_to_settle for place in row] for row in result.places])
    _shown(figure, panels[0, 0], a, b, counts, "sets of positive solutions", COUNTED, (-0.5, 2.5), (0, 1, 2))
    _shown(figure, panels[0, 1], a, b, radius, "largest |eigenvalue| of a half period", "viridis", (0.5, 1.0))
    _shown(figure, panels[1, 0], a, b, np.log10(settle), "log10 of the periods to 1 %", "magma", None)
    visits = result.visits
    share = np.array([[visit.share for visit in row] for row in visits])
    a_seen = np.array([visit.a for visit in visits[0]])
    b_seen = np.array([row[0].b for row in visits])
    _shown(
        figure, panels[1, 1], a_seen, b_seen, share, "share of initial states that come to it", "cividis", (0.0, 1.0)
    )
    line = np.linspace(0.0, B_MOST, 50)
    for axes in panels.flat:
        axes.plot(1.0 + line, line, "--", color="#1f2328", lw=1.3)
        axes.axhline(1.0, color="#9a1b1b", lw=1.2)
        if axes is not panels[0, 0]:
            axes.axhspan(1.0, 1.2, color="#d9d3d3", lw=0)  # no cycle; a cell may reach over the line
        axes.set_xlim(*A_RANGE)
        axes.set_xticks(A_TICKS, [f"{tick:g}" for tick in A_TICKS])
        axes.minorticks_off()
        axes.set_ylim(-0.04, 1.14)
    for axes in panels[1]:
        axes.set_xlabel("a = h1 / h2")
    for axes in panels[:, 0]:
        axes.set_ylabel("b = f_c / h2")
    return finish(
        figure,
        "Maps over h1/h2 and fc/h2: number of solutions, largest eigenvalue, periods to settle, share of starts.",
        "Over a = h1/h2 (logarithmic) and b = f_c/h2, which stand for all gains and motors: how many sets of positive "
        "durations there are (none above the red line, h2 = f_c); the largest eigenvalue of the half period; how many "
        f"periods it takes until a small distance is {100.0 * SETTLED:g} % of itself, as a power of ten; the share "
        "of random initial "
        "states from which the loop came to the cycle. Dashes: h1 = h2 + f_c.",
    )


def _shown(figure: Figure, axes: Axes, a: Array, b: Array, values: Array, title: str, colours: str | ListedColormap,
           limits: tuple[float, float] | None, ticks: tuple[float, ...] | None = None) -> None:  # fmt: skip
    low, high = limits if limits is not None else (float(np.nanmin(values)), float(np.nanmax(values)))
    axes.set_facecolor("#d9d3d3")
    image = axes.pcolormesh(a, b, np.ma.masked_invalid(values), cmap=colours, vmin=low, vmax=high, shading="nearest",
                            rasterized=True)  # fmt: skip
    axes.set_xscale("log")
    axes.grid(visible=False)
    axes.set_title(title)
    figure.colorbar(image, ax=[axes], pad=0.02, ticks=ticks)
