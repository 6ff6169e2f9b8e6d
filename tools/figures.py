"""Draws the figures of README and docs/theory.md into docs/figures, each from the code that it shows.

make figures
"""

from __future__ import annotations

import base64
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np

from paper import sampling
from paper.drawing import FIRST, MUTED, course, finish, new_figure, shade_stages, style, zero
from rig.model import describing_function
from rig.model.limit_cycle import NoLimitCycle, limit_cycle
from rig.output.report.friction_map import over_position
from rig.output.report.source import load
from rig.output.report.style import Picture

ROOT = Path(__file__).resolve().parent.parent
FIGURES = ROOT / "docs" / "figures"
SIMULATED = str(ROOT / "config" / "simulated.yaml")
PAGE_PX = (1000, 1130)  # of the report: its headline and the table of estimates
CHECK_ROW = (0.17, 6.5, 0.5, 0.8, 1.0)  # tau, K, fc, h1, h2 of docs/theory.md 3.4


def photograph(page: Path, to: Path) -> None:
    """The top of an HTML page as Chromium shows it. Raises SystemExit where there is no Chromium."""
    browser = shutil.which("chromium") or shutil.which("google-chrome")
    if browser is None:
        sys.exit("docs/figures/report.png needs a browser: sudo apt-get install chromium; the other figures need none")
    window = f"--window-size={PAGE_PX[0]},{PAGE_PX[1]}"
    options = ("--headless", "--no-sandbox", "--disable-gpu", "--hide-scrollbars", window, f"--screenshot={to}")
    subprocess.run([browser, *options, page.as_uri()], check=True, stderr=subprocess.DEVNULL)


def report(to: Path) -> None:
    """The top of the report of `make demo`."""
    with tempfile.TemporaryDirectory() as folder:
        command = [sys.executable, "-m", "rig", "run", str(ROOT / "config" / "demo.yaml")]
        subprocess.run(command, cwd=folder, check=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        photograph(next(Path(folder).glob("runs/*/report.html")), to)


def design(to: Path) -> None:
    """The picture of `rig design` for the motor of `rig run config/simulated.yaml`."""
    _after_a_run(to, "design", SIMULATED, "--model", "run", "--to", to.name)


def tune(to: Path) -> None:
    """The picture of `rig tune` for that motor, with the bench beside it."""
    _after_a_run(to, "tune", "run", "--try", SIMULATED, "--to", to.name)


def _after_a_run(to: Path, *command: str) -> None:
    """The file that a command writes in the folder of `rig run config/simulated.yaml`."""
    with tempfile.TemporaryDirectory() as folder:
        for words in (("run", SIMULATED), command):
            subprocess.run([sys.executable, "-m", "rig", *words], cwd=folder, check=True, capture_output=True)
            for run in Path(folder).glob("runs/*run-simulated"):
                run.rename(Path(folder) / "run")  # a name without a date: the picture says it
        shutil.copyfile(Path(folder) / to.name, to)


def friction_map(to: Path) -> None:
    """The map over the position of `rig survey config/survey.yaml`."""
    with tempfile.TemporaryDirectory() as folder:
        command = [sys.executable, "-m", "rig", "survey", str(ROOT / "config" / "survey.yaml")]
        subprocess.run(command, cwd=folder, check=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        run = load(next(Path(folder).glob("runs/*")))
        drawn(lambda: over_position(run))(to)


def limit_cycle_figure() -> Picture:
    """Position, velocity, integral and drive over one period, with the three stages."""
    tau, K, fc, h1, h2 = CHECK_ROW
    cycle = limit_cycle(tau, K, fc, h1, h2)
    curves = course(cycle)
    drive = -h1 * np.sign(curves["y"]) - h2 * np.sign(curves["z"])
    drive[0] = h1 + h2  # z is zero there
    figure = new_figure(5.0)
    rows = figure.subplots(4, 1, sharex=True)
    names = ("velocity v,\nrad/s", "position y,\nrad", "integral z,\nrad s", "drive u,\nV")
    for axes, name, values in zip(rows, names, (curves["v"], curves["y"], curves["z"], drive), strict=True):
        axes.plot(curves["t"], values, color=FIRST, drawstyle="steps-post" if values is drive else "default")
        axes.set_ylabel(name)
        zero(axes)
        shade_stages(axes, cycle, 1.0)
    rows[-1].set(xlabel="time, s", xlim=(0.0, cycle.period_s))
    for relay, when in zip(("RA", "RB", "RC"), np.cumsum(cycle.durations_s), strict=True):
        rows[0].annotate(relay, (float(when), 0.0), (3, -4), textcoords="offset points", fontsize=8, va="top")
    words = f"tau = {tau} s, K = {K} (rad/s)/V, f_c = {fc} V, h1 = {h1} V, h2 = {h2} V"
    return finish(figure, "One period of the limit cycle.", words)


def describing_function_figure() -> Picture:
    """Period and amplitude by describing function, over those of Theorem 2.1."""
    figure = new_figure(2.9)
    left, right = figure.subplots(1, 2)
    ratios = np.geomspace(0.2, 5.0, 60)
    for share, dash in ((0.0, ":"), (0.3, "--"), (0.6, "-")):
        points = []
        for ratio in ratios:
            h1, h2 = float(ratio) * (1.0 - share), 1.0  # of h1 / (h2 - fc) = ratio
            try:
                exact = limit_cycle(1.0, 1.0, share, h1, h2)
            except NoLimitCycle:
                continue
            sine = describing_function.predict(1.0, 1.0, share, h1, h2)
            period, amplitude = sine.period_s / exact.period_s, sine.amplitude_rad / exact.amplitude_rad
            points.append((ratio, period, amplitude))
        x, period, amplitude = np.array(points).T
        left.semilogx(x, period, dash, color=FIRST, label=f"f_c = {share:g} h2")
        right.semilogx(x, amplitude, dash, color=FIRST, label=f"f_c = {share:g} h2")
    for axes, name in ((left, "period, over the exact one"), (right, "amplitude, over the exact one")):
        axes.axhline(1.0, color=MUTED, lw=0.6)
        axes.set(xlabel="h1 / (h2 - f_c)", ylabel=name)
        axes.set_xticks([0.2, 0.5, 1.0, 2.0, 5.0], ["0.2", "0.5", "1", "2", "5"])
        axes.minorticks_off()
    left.legend()
    return finish(figure, "Period and amplitude of the describing function over those of Theorem 2.1.", "")


def sampling_figure() -> Picture:
    """Error of each estimator against the sampling period."""
    return sampling.picture(sampling.compute())


def drawn(make: Callable[[], Picture]) -> Callable[[Path], None]:
    """Writes a picture's SVG."""

    def write(to: Path) -> None:
        with style():
            uri = make().uri
        to.write_bytes(base64.b64decode(uri.partition(",")[2]))

    return write


FILES: dict[str, Callable[[Path], None]] = {
    "limit-cycle.svg": drawn(limit_cycle_figure),
    "describing-function.svg": drawn(describing_function_figure),
    "sampling.svg": drawn(sampling_figure),
    "friction-map.svg": friction_map,
    "report.png": report,
    "design.png": design,
    "tune.png": tune,
}


def main() -> int:
    """Draw those named on the command line, or all."""
    FIGURES.mkdir(parents=True, exist_ok=True)
    for name in sys.argv[1:] or FILES:
        FILES[name](FIGURES / name)
        print(f"docs/figures/{name}: {(FIGURES / name).stat().st_size / 1000:.0f} kB")
    return 0


if __name__ == "__main__":
    sys.exit(main())
