"""The report of a campaign: the figure as PNG, and one self-contained page with figure and table."""

from __future__ import annotations

import base64
import math
from pathlib import Path

from rig.campaign import picture
from rig.campaign.results import Table
from rig.campaign.summary import MAIN, ParameterSums, Summary, Sums
from rig.config import Campaign, dump
from rig.output.report.style import rendered
from rig.run_folder.recording.folder import write_whole

PICTURE = "campaign.png"
REPORT = "report.html"

NAMES = {
    "tau_s": ("tau", "s"),
    "K_rad_s_V": ("K", "(rad/s)/V"),
    "fc_V": ("f_c", "V"),
    "asym_V": ("asymmetry", "V"),
    "delay_s": ("delay", "s"),
}
HEADINGS = ("", "RMS error", "bound", "RMS/bound", "RMS ratio", "median", "95 %", "largest", "coverage, %")


def write_report(folder: Path, campaign: Campaign, table: Table, found: Summary) -> None:
    """Write campaign.png and report.html into the campaign's folder. Raises CannotWriteError."""
    image = picture.draw(campaign, table)
    write_whole(folder / PICTURE, image)
    page = rendered(
        "rig.campaign",
        "report.html.j2",
        campaign=campaign,
        found=found,
        headings=HEADINGS,
        tables=[
            (f"{found['ok']['number']} experiments called ok", table_rows(found["ok"])),
            (f"all {found['estimated']['number']} that have an estimate", table_rows(found["estimated"])),
        ],
        sentences=sentences(found),
        fewest_in_cell=picture.FEWEST_IN_CELL,
        picture=base64.b64encode(image).decode("ascii"),
        config=dump(campaign),
    )
    write_whole(folder / REPORT, page.encode("utf-8"))


def table_rows(sums: Sums) -> list[tuple[str, ...]]:
    """A row of text for each parameter, under ``HEADINGS``. Errors are in per cent of the truth, or in the unit."""
    rows = []
    for name, values in sums["parameters"].items():
        symbol, unit = NAMES[name]
        sizes = _sizes(values, name)
        share, scatter = 100.0 * values["coverage"], 100.0 * values["coverage_error"]
        rows.append(
            (
                f"{symbol}, {unit}",
                *(_number(values[key], "{:.3g}") for key in ("rms_error", "rms_bound")),
                *(_number(values[key], "{:.3f}") for key in ("rms_over_bound", "rms_ratio")),
                *(_number(100.0 * s, "{:.2f} %") if name in MAIN else _number(s, "{:.2g}") for s in sizes),
                f"{share:.1f} ± {scatter:.1f}" if math.isfinite(share) else "–",
            )
        )
    return rows


def sentences(found: Summary) -> list[str]:
    """Sentences beside the table: verdicts, reasons, outliers, the second test, speed."""
    verdicts = ", ".join(f"{count} {verdict}" for verdict, count in found["verdicts"].items())
    off = found["ok_but_off"]
    lines = [
        f"{found['number']} experiments: {verdicts}",
        f"called ok with an error above 5 % in tau, K or f_c: {len(off)}{_named(off)}",
    ]
    failed = found["failed"]
    if failed:
        lines.append(
            f"failed, by a defect of the program: {len(failed)}{_named(failed)}; repeat the first: {found['repeat']}"
        )
    if found["far"]:
        far = found["far"]
        lines.append(f"an error above 5 times its bound, whatever the verdict: {len(far)}{_named(far)}")
    if "second" in found:
        second = found["second"]
        lines.append(
            "second test, predicted but never fitted: residual "
            f"{second['median']:.3f} times the true motor's (median; 95 %: {second['p95']:.3f}, "
            f"largest {second['max']:.2f})"
        )
    session = found["session"]
    if session["experiments"]:
        each_ms = 1e3 * found["seconds"]["median"]
        lines.append(
            f"{session['experiments']} done now in {session['seconds']:.1f} s: {session['experiments_per_s']:.1f} "
            f"a second ({session['backend']}, {session['workers']}; median {each_ms:.0f} ms each in its worker)"
        )
    return lines


def _sizes(values: ParameterSums, name: str) -> tuple[float, float, float]:
    """Median, 95 % and largest error."""
    if name in MAIN:
        return values["relative_median"], values["relative_p95"], values["relative_max"]
    return values["absolute_median"], values["absolute_p95"], values["absolute_max"]


def _named(numbers: list[int], most: int = 12) -> str:
    if not numbers:
        return ""
    return " (" + ", ".join(map(str, numbers[:most])) + (", ..." if len(numbers) > most else "") + ")"


def _number(value: float, text: str) -> str:
    return text.format(value) if math.isfinite(value) else "–"
