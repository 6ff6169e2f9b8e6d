"""How much of a motor's law its tests can show: the fall of BIC that is to be expected from it.

The tests are simulated again without noise and steps. The motor is fitted with all its laws but one. What is left over,
in units of the noise that the campaign has, less the price of the law that is missing, is what that law would gain.
"""

from __future__ import annotations

import math

import numpy as np

from campaign_real.kinds import Kind, case
from rig.config.campaign import Campaign
from rig.core.estimators import LEADING
from rig.identification import IdentifyError, identify
from rig.identification.departures import DEPARTURES
from rig.identification.departures.choice import Asked
from rig.identification.departures.departure import Departure
from rig.identification.departures.fit import solve, start
from rig.identification.measurements import measurements
from rig.identification.motor_law import Beginning

ANY = Asked(entry=0.0, stay=0.0, predicts=-math.inf)


def expected_gains(campaign: Campaign, number: int, kinds: tuple[Kind, ...]) -> dict[str, float]:
    """For each law of motor ``number``: the expected gain in BIC of having it beside the motor's other laws.

    A law that no departure of rig has, such as a random force, is left out. Where not even a plain estimate can be
    made, every law's gain is inf.
    """
    names = {kind.law for kind in kinds}
    laws = [law for law in DEPARTURES if law.name in names]
    sensor = campaign.sensor.model_copy(update={"noise_rad": 0.0, "lsb_rad": 0.0})
    recordings = case(campaign.model_copy(update={"sensor": sensor}), number, kinds).recordings()
    sigma_rad = math.hypot(campaign.sensor.noise_rad, campaign.sensor.lsb_rad / math.sqrt(12.0))
    try:
        plain = identify(recordings, (LEADING,), choose_law=False).estimates[LEADING]
    except IdentifyError:
        return {law.name: math.inf for law in laws}
    data = measurements(recordings, with_cycles=True, plain_is_hysteretic=False)
    begun = Beginning.of(data.tests, plain, data.periods_s)
    samples = sum(window.t_s.size for window in begun.whole.windows)

    def left_over(others: list[Departure]) -> float:
        """Sum of squares that a motor with these laws leaves, in units of the noise's variance."""
        chooser = begun.chooser
        motors = [begun.motor]
        if others:
            chooser = type(chooser)(others, chooser.bench, chooser.core, chooser.delay_s, chooser.sigma_rad, asked=ANY)
            motors.append(chooser.choose(begun.whole, begun.motor, begun.cycle_s).fit.motor)
        problem = chooser.problem(begun.whole, others, math.inf)
        ends = [solve(start(problem, motor)).residual_rad for motor in motors]
        return float(min(np.sum(residual**2) for residual in ends)) / sigma_rad**2

    return {
        law.name: left_over([one for one in laws if one is not law]) - len(law.numbers + law.shape) * math.log(samples)
        for law in laws
    }
