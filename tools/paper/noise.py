"""Remarks 3.1 and 3.2: measurement noise, averaged over N periods; a relay that chatters, and its equivalent edge."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.signal import butter, lfilter

from paper import surviving
from paper.drawing import PARAMETERS, Array, course, finish, new_figure, zero
from paper.page import Claim, Comparison, Paragraph, Remark, Section
from rig.identification import triple_relay
from rig.identification.cycles import find_cycle
from rig.identification.mean_cycle import Cycle, average
from rig.identification.starts import ridge_starts
from rig.identification.triple_relay import Features
from rig.model.friction import coulomb
from rig.model.limit_cycle import limit_cycle
from rig.model.motor import Motor, State
from rig.model.sampled_relay import Disturbance, SimulatedRelayTest, relay_test
from rig.output.report.style import Picture
from rig.run_folder.recording.errors import IdentifyError
from rig.run_folder.recording.series import TimeSeries
from shared.page import listed
from shared.table import Cell, Table, number, significant

SAMPLING_S = 0.0002
NOISE_RAD = 0.003
PERIODS = (1, 2, 5, 10, 20)
FEWEST, MOST = surviving.AVERAGED_PERIODS  # the paper recommends as many
CUTOFF_HZ = 25.0
SEED = 7
EQUATIONS = "five equations (24)–(29)"  # edges taken for crossings, the extremum read off the averaged curve
PROGRAM = "the program's fit of the averaged curve"
FORMS = (EQUATIONS, PROGRAM)


@dataclass(frozen=True)
class Chatter:
    """RB's edge in one period and in the mean of many, times from the RC edge before it.

    t_s                   times about the edge
    one_V, mean_V         drive of one period and averaged over ``periods``
    position_rad          position as read in that one period
    equivalent_s, crossing_s   where a single step has the staircase's area; where the exact cycle crosses zero
    switchings            of RB in one half period, mean
    """

    t_s: Array
    one_V: Array
    mean_V: Array
    position_rad: Array
    periods: int
    equivalent_s: float
    crossing_s: float
    switchings: float


@dataclass(frozen=True)
class Averaged:
    """Whole periods from RC's upward step on: position as read in one, rad, and averaged; drive, V; exact position."""

    t_s: Array
    one_rad: Array
    means_rad: dict[int, Array]
    mean_V: Array
    exact_rad: Array


@dataclass(frozen=True)
class Result:
    """Relative errors of tau, K, fc by the number of periods averaged.

    errors          FORMS -> (PERIODS, trials, 3); nan where there was no solution
    without_noise   FORMS -> (3,) with the largest number of periods
    filtered        FORMS -> (trials, 3), the position low-pass filtered instead, one period
    """

    errors: dict[str, Array]
    without_noise: dict[str, Array]
    filtered: dict[str, Array]
    chatter: Chatter
    averaged: Averaged

    def rms(self, form: str) -> Array:
        """(PERIODS, 3) RMS over the trials."""
        return np.asarray(np.sqrt(np.nanmean(self.errors[form] ** 2, axis=1)))

    def errors_at(self, form: str, periods: int) -> float:
        """``worst`` with so many periods."""
        return float(self.worst(form)[PERIODS.index(periods)])

    def worst(self, form: str) -> Array:
        """(PERIODS,) RMS of the worst parameter, per cent."""
        return np.asarray(100.0 * self.rms(form).max(axis=1))


def compute(trials: int = 12) -> Result:
    """Relay tests with noise on the position, and what the triple-relay equations make of them."""
    most = max(PERIODS)
    errors = {form: np.full((len(PERIODS), trials, 3), np.nan) for form in FORMS}
    filtered = {form: np.full((trials, 3), np.nan) for form in FORMS}
    low_pass = butter(2, 2.0 * CUTOFF_HZ * SAMPLING_S)
    for trial in range(trials):
        test = _relay_test(NOISE_RAD, SEED + trial)
        raw = find_cycle(_record(test, test.y_rad))
        smooth = find_cycle(_record(test, lfilter(*low_pass, test.y_rad)))
        for form in FORMS:
            for k, periods in enumerate(PERIODS):
                errors[form][k, trial] = _errors(raw, periods, form)
            filtered[form][trial] = _errors(smooth, 1, form)
    quiet_test = _relay_test(0.0, SEED)
    quiet = find_cycle(_record(quiet_test, quiet_test.y_rad))
    return Result(
        errors, {form: _errors(quiet, most, form) for form in FORMS}, filtered,
        _chatter(_relay_test(NOISE_RAD, SEED)), _averaged(_relay_test(NOISE_RAD, SEED)),
    )  # fmt: skip


def _motor() -> Motor:
    tau, K, fc = surviving.MOTOR
    return Motor(tau, K, coulomb(fc))


def _relay_test(noise_rad: float, seed: int) -> SimulatedRelayTest:
    """A test of the first pair of gains, long enough for the largest number of periods and the settling."""
    gains = surviving.GAINS[0]
    cycle = limit_cycle(*surviving.MOTOR, *gains)
    rows = math.ceil((max(PERIODS) + 8) * cycle.period_s / SAMPLING_S)
    noise = noise_rad * np.random.default_rng(seed).standard_normal(rows)
    start = State(0.0, -0.8 * cycle.amplitude_rad)
    t_s = np.arange(rows) * np.float64(SAMPLING_S)
    return relay_test(_motor(), gains.h1_V, gains.h2_V, t_s, 0.0, disturbance=Disturbance(noise), start=start)


def _record(test: SimulatedRelayTest, y_rad: Array) -> TimeSeries:
    return TimeSeries(test.t_s, y_rad, test.t_u_s, test.u_V, name="simulated")


def _errors(cycle: Cycle, periods: int, form: str) -> Array:
    """Relative errors of tau, K, fc from the first ``periods`` settled periods; nan without a solution."""
    part = average(
        cycle.waves[:periods], cycle.h1_V, cycle.h2_V, cycle.period_sampling_s, cycle.resolution_rad, cycle.rows
    )
    starts = ridge_starts(part.omega_rad_s, part.amplitude_rad, part.h1_V, part.h2_V)
    try:
        if form == EQUATIONS:
            seen = Features(part.t1_s, part.t2_s, part.t3_s, part.y_extremum_rad, part.y_rc_rad)
            found = triple_relay.solve(seen, part.h1_V, part.h2_V, starts)
        else:
            found = triple_relay.solve_cycle(part, starts)
    except IdentifyError:
        return np.full(3, np.nan)
    return np.asarray(np.array(found.theta) / np.array(surviving.MOTOR) - 1.0)


def _rising(test: SimulatedRelayTest) -> NDArray[np.intp]:
    """Samples at which RC steps up, once it has settled."""
    outer = np.flatnonzero(np.abs(test.u_V) > surviving.GAINS[0].h2_V)
    rising = outer[1:][(test.u_V[outer[1:]] > 0.0) & (test.u_V[outer[:-1]] < 0.0)]
    return np.asarray(rising[4:])


def _averaged(test: SimulatedRelayTest) -> Averaged:
    """Position and drive over a period, point by point from RC's step on."""
    exact = limit_cycle(*surviving.MOTOR, *surviving.GAINS[0])
    rows = round(exact.period_s / SAMPLING_S)
    begins = _rising(test)
    begins = begins[begins + rows <= test.t_s.size][: max(PERIODS)]
    y = np.array([test.y_rad[k : k + rows] for k in begins])
    u = np.array([test.u_V[k : k + rows] for k in begins])
    return Averaged(
        np.arange(rows) * np.float64(SAMPLING_S), y[0],
        {n: y[:n].mean(axis=0) for n in surviving.AVERAGED_PERIODS}, u.mean(axis=0),
        course(exact, rows)["y"],
    )  # fmt: skip


def _chatter(test: SimulatedRelayTest) -> Chatter:
    """The averaged staircase about the RB edge; RC's own edges align the periods."""
    h1, h2 = surviving.GAINS[0]
    rising = _rising(test)
    exact = limit_cycle(*surviving.MOTOR, h1, h2)
    crossing = sum(exact.durations_s[:2])
    rows = round(0.25 * exact.period_s / SAMPLING_S) + round(0.12 * exact.period_s / SAMPLING_S)
    rising = rising[rising + rows < test.t_s.size]
    drives = np.array([test.u_V[k : k + rows] for k in rising])
    mean = drives.mean(axis=0)
    t = SAMPLING_S * np.arange(rows)
    before, after = h1 + h2, h2 - h1
    # t_s = t_a + integral of (mean - after) / (before - after): t_a = 0 here
    equivalent = float(np.sum((mean - after) / (before - after)) * SAMPLING_S)
    switchings = float(np.mean(np.count_nonzero(np.diff(drives, axis=1), axis=1)))
    chosen = int(np.argmax(np.count_nonzero(np.diff(drives, axis=1), axis=1)))
    y = test.y_rad[rising[chosen] : rising[chosen] + rows]
    near = np.abs(t - crossing) < 0.004
    return Chatter(t[near], drives[chosen][near], mean[near], y[near], rising.size, equivalent, crossing, switchings)


def section(result: Result) -> Section:
    """Its part of the page."""
    c = result.chatter
    rms, ours = result.worst(EQUATIONS), result.worst(PROGRAM)
    trials = result.errors[EQUATIONS].shape[1]
    quiet = {form: 100.0 * float(np.abs(result.without_noise[form]).max()) for form in FORMS}
    filtered = 100.0 * float(np.sqrt(np.nanmean(result.filtered[EQUATIONS] ** 2, axis=0)).max())
    blocks = (
        Paragraph(
            f"The same motor and gains, the relay now sampled every {1e3 * SAMPLING_S:.1f} ms and the position read "
            f"with {1e3 * NOISE_RAD:.0f} mrad of white noise, {trials} trials. Noise makes the relay "
            f"chatter and blurs the extremum. Remark 3.1: average N = {FEWEST} to {MOST} periods point by point, do "
            "not low-pass "
            "filter. Remark 3.2: where the averaged relay signal is a staircase, take the edge at which a single step "
            "has its area."
        ),
        Remark(
            "chosen",
            "Noise level and sampling of the paper's simulation did not survive: "
            f"{1e3 * NOISE_RAD:.0f} mrad and {1e3 * SAMPLING_S:.1f} ms. N = {FEWEST} to {MOST} is the paper's.",
        ),
        _averaged_figure(result),
        _chatter_figure(result),
        Paragraph(
            f"Here RB switches {c.switchings:.1f} times at each of its edges instead of once; counted as crossings, "
            f"they would make {c.switchings:.1f} half periods of each. The equivalent edge lies "
            f"{1e3 * c.equivalent_s:.3f} ms after RC's, the exact cycle's {1e3 * c.crossing_s:.3f} ms. "
            f"The two are {abs(c.equivalent_s - c.crossing_s) / SAMPLING_S:.1f} samples apart: a sampled relay acts "
            "up to "
            "one late."
        ),
        _table(result),
        _figure(result),
        _averaging_remark(result, EQUATIONS),
        _averaging_remark(result, PROGRAM),
        Remark(
            filter_hurts(result).agreement,
            f"Do not low-pass filter, says the paper: {CUTOFF_HZ:.0f} Hz on one period give "
            f"{significant(filtered, 2)} % "
            f"by the {EQUATIONS}, {filter_hurts(result).says('more', 'not more')} than the "
            f"{significant(rms[0], 2)} % of one period as it is. Without any noise "
            f"{significant(quiet[EQUATIONS], 2)} % "
            "are left.",
        ),
        Remark(
            "ours",
            "The program's triple relay does not read the extremum off the curve: it fits the steady motion between "
            "the "
            "recorded edges to the whole averaged curve.",
        ),
    )
    comparison = Comparison(
        "4.2, Rem. 3.1",
        f"averaging N = {FEWEST} to {MOST} periods against noise",
        "recommended",
        f"worst parameter's RMS error {listed([f'{significant(float(e), 2)} %' for e in rms])} for N = "
        f"{listed([str(n) for n in PERIODS])}",
        averaging_helps(result, EQUATIONS).agreement,
        f"{_course_words(result, EQUATIONS)}, {_course_words(result, PROGRAM)} with the program's fit "
        f"({significant(ours[0], 2)} % to {significant(ours[-1], 2)} %); {1e3 * NOISE_RAD:.0f} mrad of noise, chosen",
    )
    return Section("noise", "Noise", "Measurement noise: Remarks 3.1 and 3.2", blocks, (comparison,))


def averaging_helps(result: Result, form: str) -> Claim:
    """The error falls from one period to the fewest that the paper recommends, and on to the most."""
    one, fewest, most = (result.errors_at(form, n) for n in (1, FEWEST, MOST))
    return Claim(most < fewest < one)


def filter_hurts(result: Result) -> Claim:
    """One period, filtered, is worse than the same period as it is, by the five equations."""
    filtered = 100.0 * float(np.sqrt(np.nanmean(result.filtered[EQUATIONS] ** 2, axis=0)).max())
    return Claim(filtered > result.errors_at(EQUATIONS, 1))


def _course_words(result: Result, form: str) -> str:
    """Which way the error goes up to the fewest periods, and on from there to the most."""
    one, fewest, most = (result.errors_at(form, n) for n in (1, FEWEST, MOST))
    first = "falls" if fewest < one else "rises"
    then = "falls" if most < fewest else "rises"
    if first == then:
        return f"{first} from N = {PERIODS[0]} to {MOST}"
    return f"{first} from N = {PERIODS[0]} to {FEWEST}, {then} from there to {MOST}"


def _averaging_remark(result: Result, form: str) -> Remark:
    values = listed([f"{significant(result.errors_at(form, n), 2)} % with {n}" for n in (1, FEWEST, MOST)])
    return Remark(
        averaging_helps(result, form).agreement,
        f"By {form if form.startswith('the ') else 'the ' + form} the worst parameter's RMS error "
        f"{_course_words(result, form)}: {values}.",
    )


def _table(result: Result) -> Table:
    trials = result.errors[EQUATIONS].shape[1]
    rows = []
    for k, periods in enumerate(PERIODS):
        cells = [number(100.0 * float(v), 2) for form in FORMS for v in result.rms(form)[k]]
        rows.append((Cell(f"N = {periods}"), *cells))
    low = [100.0 * float(v) for form in FORMS for v in np.sqrt(np.nanmean(result.filtered[form] ** 2, axis=0))]
    rows.append((Cell(f"N = {PERIODS[0]}, low-pass {CUTOFF_HZ:.0f} Hz"), *(number(v, 2) for v in low)))
    quiet = [100.0 * abs(float(v)) for form in FORMS for v in result.without_noise[form]]
    rows.append((Cell(f"N = {PERIODS[-1]}, no noise"), *(number(v, 2) for v in quiet)))
    lost = sum(int(np.isnan(result.errors[form]).any(axis=2).sum()) for form in FORMS)
    return Table(
        ("", "equations: τ, %", "K, %", "f<sub>c</sub>, %", "the program: τ, %", "K, %", "f<sub>c</sub>, %"),
        tuple(rows),
        f"RMS errors over {trials} trials (no noise: one) of the five equations as in the paper, and of the program's "
        f"triple relay. {lost or 'No'} trial{'' if lost == 1 else 's'} without a solution.",
    )


def _averaged_figure(result: Result) -> Picture:
    a = result.averaged
    figure = new_figure(5.2)
    top, middle, bottom = figure.subplots(3, 1, sharex=True, height_ratios=(1.6, 1.6, 1.0))
    top.plot(a.t_s, a.one_rad, ".", ms=1.5, color="#9aa3ad", label="one period, as read")
    middle.plot(a.t_s, 1e3 * (a.one_rad - a.exact_rad), ".", ms=1.2, color="#b9bfc7", label="one period, as read")
    for (n, mean), ink in zip(a.means_rad.items(), ("#D55E00", "#0072B2"), strict=True):
        middle.plot(a.t_s, 1e3 * (mean - a.exact_rad), color=ink, lw=1.0, label=f"mean of {n} periods")
    top.plot(a.t_s, a.exact_rad, "--", color="#009E73", lw=1.1, label="exact cycle, no noise, no sampling")
    for axes in (top, middle):
        low, high = axes.get_ylim()
        axes.set_ylim(low, high + 0.35 * (high - low))
        axes.legend(loc="upper left", ncols=3)
    bottom.step(a.t_s, a.mean_V, where="post", color="#0072B2", lw=1.1)
    for axes in (top, middle, bottom):
        zero(axes)
    top.set_ylabel("position y, rad")
    middle.set_ylabel("less the exact, mrad")
    bottom.set(ylabel=f"drive u, V\n(mean of {MOST})", xlabel="time since RC stepped up, s")
    return finish(
        figure,
        "One period of the limit cycle with noise, averaged over several periods, and the exact one.",
        "The noisy limit cycle and its averages (Remark 3.1): position as read in one period, averaged point by point "
        f"over {FEWEST} and {MOST} periods from RC's step on, less the exact cycle; below, the averaged drive.",
    )


def _chatter_figure(result: Result) -> Picture:
    c = result.chatter
    figure = new_figure(3.4)
    top, bottom = figure.subplots(2, 1, sharex=True, height_ratios=(1.0, 1.6))
    ms = 1e3 * c.t_s
    top.plot(ms, 1e3 * c.position_rad, ".-", ms=4.0, lw=0.6, color="#4a4f57")
    zero(top)
    top.set_ylabel("y as read, mrad")
    bottom.step(ms, c.one_V, where="post", color="#b9bfc7", lw=1.0, label="one period")
    bottom.step(ms, c.mean_V, where="post", color="#0072B2", lw=1.6, label=f"mean of {c.periods} periods")
    bottom.axvline(1e3 * c.equivalent_s, color="#D55E00", lw=1.3, label="equivalent edge")
    bottom.axvline(1e3 * c.crossing_s, color="#009E73", lw=1.3, ls="--", label="RB in the exact cycle")
    bottom.set(ylabel="drive u, V", xlabel="time after the RC edge, ms")
    bottom.legend(loc="lower left")
    return finish(
        figure,
        "The relay chatters around its RB edge; the averaged drive is a staircase.",
        "RB's edge under noise: position as read and drive in one period, the averaged drive, and the equivalent edge "
        "of Remark 3.2 beside that of the exact cycle without noise.",
    )


def _figure(result: Result) -> Picture:
    figure = new_figure(3.3)
    panels = figure.subplots(1, 2, sharey=True)
    guide = np.array([PERIODS[0], PERIODS[-1]], dtype=float)
    for axes, form in zip(panels, FORMS, strict=True):
        errors, rms = result.errors[form], result.rms(form)
        for k, (name, ink, mark) in enumerate(PARAMETERS):
            axes.loglog(PERIODS, 100.0 * rms[:, k], mark + "-", ms=5.0, color=ink, label=name)
            at = np.repeat(np.array(PERIODS, dtype=float) * (0.93 + 0.07 * k), errors.shape[1])
            axes.loglog(at, 100.0 * np.abs(errors[:, :, k]).ravel(), mark, ms=2.2, alpha=0.35, color=ink, mew=0)
        axes.loglog(guide, 100.0 * rms[0].mean() / np.sqrt(guide), ":", color="#6a737d", label="1/√N")
        axes.set_xticks(PERIODS, [str(n) for n in PERIODS])
        axes.minorticks_off()
        axes.set(title=form, xlabel="periods averaged, N")
    panels[0].set_ylabel("error, %")
    panels[0].legend(loc="lower left", ncols=4)
    return finish(
        figure,
        "Error of the triple-relay estimate over the number of periods averaged, in both forms.",
        "Error over the number of periods averaged: every trial (small) and the RMS of all, for the five equations as "
        "in the paper and for the program's fit of the averaged curve.",
    )
