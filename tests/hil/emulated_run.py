"""The whole experiment on an emulated chip, in virtual time, as a user runs it."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest
import yaml
from command_line import rig


def run_on(
    port: str, folder: Path, config: dict[str, Any], daq: Mapping[str, object] | None = None, **relay: object
) -> dict[str, Any]:
    """What comes of a config on the chip behind ``port``, with changes of its sections ``daq`` and ``relay``.

    With changes of ``relay`` it does not track.
    """
    config["daq"] |= {"port": port} | dict(daq or {})
    config["limits"]["max_speed_rad_s"] = 4.7 if daq is None else 4.5  # an adapter needs room, too
    config["relay"] |= relay
    if relay:
        del config["tracking"]
    path = folder / "chip.yaml"
    path.write_text(yaml.safe_dump(config), encoding="utf-8")
    result = rig("run", path, "--out", folder / "runs", "--json")
    assert result.exit_code == 0, result.output
    outcome: dict[str, Any] = json.loads(result.stdout)
    return outcome


def finds_the_truth(outcome: dict[str, Any], within: float) -> None:
    """The sampled-data estimate is off by at most this share."""
    estimate, truth = outcome["estimates"]["sampled-data"], outcome["truth"]
    for name in ("tau_s", "K_rad_s_V", "fc_V"):
        assert estimate[name] == pytest.approx(truth[name], rel=within)


def finds_it_undisturbed(outcome: dict[str, Any], within: float) -> None:
    """And is sure of it; the link lost nothing, and no tick was skipped."""
    finds_the_truth(outcome, within)
    assert outcome["estimates"]["sampled-data"]["verdict"] == "ok", outcome["estimates"]["sampled-data"]["reasons"]
    link = outcome["link"]
    assert link["timeouts"] == link["bad_frames"] == link["drives_lost"] == link["stale_replies"] == 0
    assert outcome["loop"]["skipped"] == 0 and not outcome["faults"]
