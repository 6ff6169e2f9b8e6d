"""The laws that a real motor may have beyond the plain one (docs/theory.md 12): ``laws`` has a row for each."""

from __future__ import annotations

from rig.identification.departures.laws import BY_NAME as BY_NAME
from rig.identification.departures.laws import DEPARTURES as DEPARTURES
