"""The first config of a smart servo: the ready config of its protocol, with what is known of this one put in."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from difflib import get_close_matches
from typing import Any, Final

from rig.backends.links.usb_adapters import Adapter
from rig.backends.servo.models import MODELS, ServoModel
from rig.config import ready
from rig.config.edit import Value, with_values
from rig.config.new_bench import AnswerError
from rig.config.problems import Path
from rig.config.yaml12 import parse

_READY: Final = {"dynamixel": "servo", "feetech": "servo-sts3215"}
_OWN: Final = {"servo": ("xl330-m288", 5.0, 12.0), "servo-sts3215": ("sts3215", 7.4, 6.0)}  # model, V, rad/s


@dataclass(frozen=True)
class ServoAnswers:
    """What is known of the servo.

    model         its name in rig's tables
    port, baud    where it is; port None: on an emulated bus
    id            on its bus
    supply_V      of it; None: as in the ready config
    no_load_rpm   of the horn at that supply, by its data sheet; None: as in the ready config, of its model alone
    zero_counts   position register where the shaft is to be 0
    adapter       between USB and the bus; None: the config names none
    """

    model: ServoModel
    port: str | None = None
    baud: int = 1_000_000
    id: int = 1
    supply_V: float | None = None
    no_load_rpm: float | None = None
    zero_counts: int = 2048
    adapter: Adapter | None = None


def model_named(name: str, *, is_read: bool = False) -> ServoModel:
    """The model of that name, or the one whose name begins so.

    is_read  the servo itself will tell which: then the first of several will do
    Raises AnswerError where rig knows none, and for several.
    """
    plain = {_letters(one): MODELS[one] for one in sorted(MODELS)}
    asked = _letters(name)
    found = [plain[asked]] if asked in plain else [plain[one] for one in plain if asked and one.startswith(asked)]
    if not found:
        near = [plain[one].name for one in get_close_matches(asked, plain, n=3)]
        series = sorted({one.split("-")[0] for one in MODELS})
        cure = f"did you mean {' or '.join(near)}?" if near else f"a model of one of these: {', '.join(series)}"
        raise AnswerError(f"rig knows no servo {name!r}", cure)
    if len(found) > 1 and not is_read:
        names = " or ".join(one.name for one in found)
        raise AnswerError(
            f"{name} may be {names}", f"name it, such as --servo {found[-1].name}; `rig init` with --port reads it"
        )
    return found[0]


def _letters(name: str) -> str:
    """A name as it is compared: ``STS-3215`` is ``sts3215``."""
    return re.sub(r"[^a-z0-9]", "", name.lower())


def text(answers: ServoAnswers) -> str:
    """The config. Raises AnswerError where its speed without load is not known."""
    model = answers.model
    name = _READY[model.protocol]
    own, supply_V, speed_rad_s = _OWN[name]
    own_V = supply_V
    if answers.supply_V is not None:
        supply_V = answers.supply_V
    if answers.no_load_rpm is not None:
        speed = answers.no_load_rpm * 2.0 * math.pi / 60.0
    elif model.name == own:
        speed = speed_rad_s * supply_V / own_V
    else:
        raise AnswerError(
            f"{model.name}: its speed without load is missing", "give --no-load-rpm, from its data sheet, at its supply"
        )
    written, faster = ready.text(name), speed / speed_rad_s
    example = parse(written, name).data
    by = {
        ("drive", "max_V"): supply_V / own_V,
        ("breakaway", "max_V"): supply_V / own_V,
        ("breakaway", "ramp_V_s"): supply_V / own_V,
        ("limits", "max_speed_rad_s"): faster,
        ("relay", "target", "amplitude_rad"): min(faster, 1.0),  # in the same time
    }
    values: dict[Path, Value] = {
        ("name",): "bench",
        ("daq", "servo", "model"): model.name,
        ("daq", "servo", "id"): answers.id,
        ("daq", "baud"): answers.baud,
        ("sensor", "servo"): {"zero_counts": answers.zero_counts},
        ("drive", "supply_V"): _digits(supply_V, 4),
        ("motor", "no_load_speed_rad_s"): _digits(speed, 3),
        **{path: _digits(factor * _at(example, path), 3) for path, factor in by.items()},
    }
    if answers.port is not None:
        values["daq", "port"] = answers.port
        written = _of_a_real_one(written)
        if answers.adapter is not None:
            values["daq", "servo", "adapter"] = answers.adapter
    return with_values(written, values)


def _of_a_real_one(written: str) -> str:
    """The config without what its comments say of an emulated servo."""
    written = written[: written.index("\nemulated:")] + "\n"
    for said in (
        ", on an emulated bus, in virtual time",
        *re.findall(r"The emulated motor is [^.]*\. |  +# in virtual.*", written),
    ):
        written = written.replace(said, "")
    return written


def _at(data: Any, path: Path) -> float:
    for key in path:
        data = data[key]
    return float(data)


def _digits(value: float, digits: int) -> float:
    return float(f"{value:.{digits}g}")
