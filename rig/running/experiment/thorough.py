"""What a thorough run adds where the relay tests leave the motor's law open: a third amplitude, and a survey."""

from __future__ import annotations

from rig.control.law import Rest
from rig.core.faults import Fault
from rig.identification import Identification
from rig.running.experiment.stages import REST_S, driving, identify_recorded, test_further
from rig.running.experiment.survey import survey
from rig.running.session import Session

ENOUGH = 0.025  # of tau, K and friction: more uncertainty than that is too much
MOST_TESTS = 2  # relay tests; with more the config gives a third amplitude already
TITLES = {"tau_s": "tau", "K_rad_s_V": "K", "fc_V": "friction"}


def tell_apart(session: Session) -> None:
    """Where the tests so far leave the law open: one more relay test and a survey, then identify all of it again.

    Raises what the loop and the stages raise; without room for sweeps it only notes that.
    """
    identification = session.found.identification
    why = None if identification is None else what_is_open(identification)
    if why is None:
        session.found.notes.append("thorough: the relay tests leave nothing open, so there is no survey")
        return
    pair_V = third_gains_V(session)
    check = session.found.breakaway
    starts = pair_V is not None and check is not None and starts_from_rest(pair_V, max(check.plus_V, check.minus_V))
    added = " and a relay test of a third amplitude were" if starts else " was"
    session.found.notes.append(f"thorough: {why}; a survey{added} added")
    if pair_V is not None and not starts:
        session.found.notes.append(
            f"thorough: no relay test of a third amplitude: {sum(pair_V):.2f} V would not move the shaft from rest"
        )
    elif pair_V is not None:
        # a replay tests with these gains: it does not know what was open
        session.note("further_test", h1_V=pair_V[0], h2_V=pair_V[1])
        test_once_more(session, pair_V)
    try:
        survey(session)
    except Fault as fault:
        if fault.code != "NO_SWEEPS":
            raise
        session.found.notes.append(f"thorough: no survey: {fault.detail}")
    identify_recorded(session)


def test_once_more(session: Session, pair_V: tuple[float, float]) -> None:
    """One more relay test, from rest to rest."""
    with driving(session):
        session.loop.run(Rest(REST_S), "rest")
        test_further(session, pair_V)


def what_is_open(found: Identification) -> str | None:
    """What the tests leave open, as the begin of a sentence; None if nothing."""
    law, estimate = found.motor_law, found.leading
    if law is None or estimate is None:
        return None
    if law.not_told_apart:
        groups = "; ".join(" and ".join(group) for group in law.not_told_apart)
        return f"the tests did not tell {groups.replace('_', ' ')} apart"
    for name, title in TITLES.items():
        share = law.budget.u95[name] / max(abs(getattr(estimate, name)), 1e-9)
        if share > ENOUGH:
            return f"the tests left {title} uncertain by {share:.2g} (u95, relative)"
    return None


def starts_from_rest(pair_V: tuple[float, float], breakaway_V: float) -> bool:
    """Whether the largest drive of these gains moves a shaft that stands: the first two tests go on from a cycle."""
    return sum(pair_V) > breakaway_V


def third_gains_V(session: Session) -> tuple[float, float] | None:
    """Gains of a relay test whose amplitude lies beyond those of the tests so far; None if there were enough."""
    found, e = session.found, session.experiment
    if not 0 < len(found.gains_V) <= MOST_TESTS or found.breakaway is None:
        return None
    if found.further_gains_V is not None:
        return found.further_gains_V
    ratio = e.relay.second_ratio**2
    friction_V = 0.45 * (found.breakaway.plus_V + found.breakaway.minus_V)
    h1_V, h2_V = found.gains_V[0]
    return h1_V * ratio, friction_V + max(h2_V - friction_V, 0.0) * ratio
