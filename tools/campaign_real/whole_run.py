"""A row of the campaign from all that a run of rig records: breakaway check, gain search and both relay tests."""

from __future__ import annotations

import time
from dataclasses import fields

from campaign_real.kinds import Case, case
from campaign_real.rows import Row, _identified, _without, kinds_of  # that file's rows are kept by its bytes
from rig.config.campaign import Campaign
from rig.identification import IdentifyError
from rig.run_folder.recording.recording import Recording


class _Run(Case):
    """A motor whose records are those of one run."""

    def recordings(self) -> list[Recording]:
        """The one run."""
        return [self.run()]


def row_of_run(campaign: Campaign, number: int, pair: bool) -> Row:
    """The row of motor ``number``, its two relay tests those of ``rows.row``. An exception becomes its verdict."""
    began = time.perf_counter()
    kinds = kinds_of(number, pair, campaign.seed)
    names = tuple(kind.name for kind in kinds)
    try:
        one = case(campaign, number, kinds, whole_run=True)
        return _identified(_Run(*(getattr(one, field.name) for field in fields(one))), number, names)
    except IdentifyError as error:
        return _without(number, names, "refused", error.cause, began)
    except Exception as error:  # noqa: BLE001 - no error of one motor may end the thousands of others
        return _without(number, names, "failed", f"{type(error).__name__}: {error}", began)
