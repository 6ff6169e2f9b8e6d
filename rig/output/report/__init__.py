"""Figures and the self-contained HTML report of a run folder."""

from __future__ import annotations

from pathlib import Path

from rig.identification import Identification
from rig.run_folder.recording.recording import Recording

__all__ = ["write_report"]


def write_report(
    run_folder: Path, identification: Identification | None = None, known: Recording | None = None
) -> Path:
    """``rig.output.report.page.write_report``, loaded when it is called: matplotlib takes longer than many runs."""
    from rig.output.report.page import write_report as write

    return write(run_folder, identification, known)
