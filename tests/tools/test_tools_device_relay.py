"""What a relay at 1 kHz in the device brings against one at 10 ms in the host: same motors, same time."""

from __future__ import annotations

import numpy as np
import pytest

from bench.device_relay import CONFIG, DEVICE_DELAY_S, DEVICE_S, HOST_S, identify, relay_record
from rig.campaign.random_motors import Draw, draw
from rig.config import load_campaign
from rig.identification import triple_relay
from rig.identification.cycles import find_cycle
from rig.run_folder.recording.series import TimeSeries

CAMPAIGN = load_campaign(CONFIG)


def records(number: int) -> tuple[Draw, TimeSeries, TimeSeries]:
    one = draw(CAMPAIGN, number)
    host = relay_record(CAMPAIGN, one, HOST_S, one.delay_s)
    return one, host, relay_record(CAMPAIGN, one, DEVICE_S, DEVICE_DELAY_S)


@pytest.mark.evidence
def test_the_triple_relays_error_is_at_most_a_third_over_50_motors() -> None:
    errors = []
    for number in range(50):
        one, *both = records(number)
        truth = np.array([one.tau_s, one.K_rad_s_V, one.fc_V])
        found = [triple_relay.fit(find_cycle(record)) for record in both]
        errors.append([np.abs(np.array([e.tau_s, e.K_rad_s_V, e.fc_V]) / truth - 1.0).max() for e in found])
    host, device = np.array(errors).T
    assert np.median(device) < np.median(host) / 3.0
    assert device.mean() < host.mean() / 3.0
    assert np.sqrt(np.mean(device**2)) < np.sqrt(np.mean(host**2)) / 3.0


def test_the_sampled_data_interval_is_narrower_for_the_same_time() -> None:
    narrower = 0
    widths = []
    for number in range(8):
        one, host, device = records(number)
        # the same seconds, to a sample at each end
        assert abs((host.t_s[-1] - host.t_s[0]) - (device.t_s[-1] - device.t_s[0])) <= 2 * HOST_S
        found = [identify(one, record) for record in (host, device)]
        widths.append([f.interval for f in found])
        narrower += found[1].interval < found[0].interval
    at_host, at_device = np.median(widths, axis=0)
    assert narrower >= 7
    assert at_device < at_host
