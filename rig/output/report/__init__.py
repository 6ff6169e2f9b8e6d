"""Figures and the self-contained HTML report of a run folder."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rig.identification import Identification
    from rig.run_folder.recording.recording import Recording


def write_report(
    run_folder: Path, identification: Identification | None = None, known: Recording | None = None
) -> Path:
    """Write ``report.html`` into a run folder, as ``page.write_report`` does; Matplotlib is loaded only now.

    It takes as long to load as all else that drives a motor, and a run needs it when all is over.
    """
    from rig.output.report import page

    return page.write_report(run_folder, identification, known)


__all__ = ["write_report"]
