"""What every section of a config is, and the kinds of numbers in it."""

from __future__ import annotations

from typing import Annotated

from pydantic import AfterValidator, BaseModel, ConfigDict, Field


def _rising(interval: tuple[float, float]) -> tuple[float, float]:
    low, high = interval
    if not low < high:
        raise ValueError(f"must be [low, high] with low < high, not [{low:g}, {high:g}]")
    return interval


def not_zero(why: str = "") -> AfterValidator:
    """A number of any sign but 0, which raises ValueError; ``why``: in its words, behind a colon."""

    def checked(number: float | None) -> float | None:
        if number == 0.0:
            raise ValueError(f"must not be 0{why and ': '}{why}")
        return number

    return AfterValidator(checked)


Positive = Annotated[float, Field(gt=0)]
NonNegative = Annotated[float, Field(ge=0)]
Interval = Annotated[tuple[float, float], AfterValidator(_rising)]


class Section(BaseModel):
    """Strict: an unknown key is an error, numbers are finite, objects are frozen."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False, defer_build=True)
