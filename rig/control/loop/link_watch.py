"""Records when something went wrong on the link, so that who looks at the run sees it while it happens."""

from __future__ import annotations

from rig.backends.driver import Driver
from rig.run_folder.recording.sink import RowSink

_WELL = "exchanges"  # of a driver's counts the one that counts no error


class LinkWatch:
    """Writes an event ``link`` whenever the driver has counted more errors of its link than before."""

    def __init__(self, driver: Driver, record: RowSink) -> None:
        self._driver = driver
        self._record = record
        self._errors = 0

    def look(self, now_s: float) -> None:
        """Look at the driver's counts; ``now_s`` is the time of the run. Writes memory only."""
        counts = self._driver.link_statistics
        # a driver of another package may count anything
        errors = {name: n for name, n in counts.items() if name != _WELL and isinstance(n, int) and n > 0}
        total = sum(errors.values())
        if total > self._errors:
            self._errors = total
            worst = max(errors, key=lambda name: errors[name])
            self._record.event(now_s, "link", errors=total, most=worst)
