"""What a host must never do to a servo, noted by the servo that it is done to."""

from __future__ import annotations

from typing import NamedTuple


class Violation(NamedTuple):
    """When, to which servo, and what."""

    t_s: float
    id: int
    what: str
