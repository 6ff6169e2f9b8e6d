"""What a run of a config would do: the verdict of `rig check`, and numbers for the page that asks before a start."""

from __future__ import annotations

from pathlib import Path

from rig.config import ConfigError, Experiment, is_campaign, read
from rig.panel.messages import Plan, Prospect
from rig.running import preflight
from rig.running.preflight.plan import lasts_s
from rig.running.preflight.room_to_stop import stopping_rad


def prospect(config: Path) -> Prospect:
    """What a page is told before a start."""
    try:
        document = read(config)
        if is_campaign(document):
            return _refused([f"{config} is the config of a campaign: nothing moves there; `rig campaign` runs it"])
        experiment, found = preflight.check(document)
    except ConfigError as error:
        return _refused(str(error).splitlines())
    lines = [
        {"severity": "note" if line.startswith("note: ") else "ok", "text": line.removeprefix("note: ")}
        for line in found.lines
    ]
    return {"lines": lines, "may_run": True, "plan": _plan(experiment), "digest": document.digest}


def _refused(problems: list[str]) -> Prospect:
    return {"lines": [{"severity": "error", "text": line} for line in problems], "may_run": False, "plan": None}


def _plan(e: Experiment) -> Plan:
    endless = e.limits.is_endless
    return {
        "name": e.name, "largest_drive_V": e.drive.max_V, "jog_V": min(e.breakaway.max_V, e.drive.max_V),
        "stopping_distance_rad": stopping_rad(e.device),
        "soft_rad": None if endless else list(e.limits.soft_rad),
        "hard_rad": None if endless else list(e.limits.hard_rad),
        "max_speed_rad_s": e.limits.max_speed_rad_s, "lasts_s": lasts_s(e),
    }  # fmt: skip
