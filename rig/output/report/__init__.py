"""Figures and the self-contained HTML report of a run folder."""

from rig.output.report.page import write_report

__all__ = ["write_report"]
