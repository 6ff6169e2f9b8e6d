"""One random motor behind an emulated board, driven by a host that stands still at random, beside its truth."""

from __future__ import annotations

import math
import time
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from campaign_real.departing_bench import BREAKAWAY_V, FAST, HARD_RAD, LARGEST_V, REACH_RAD
from emulated_chips.pico_parameters import pico_parameters
from emulated_chips.virtual_chip import VirtualChip, variant_of
from emulated_chips.virtual_pico import VirtualPico
from rig.backends.driver import Timeouts
from rig.backends.registry import Bench as OpenBench
from rig.backends.serial.driver import SerialDriver
from rig.backends.serial.emulated.virtual_board import VirtualBoard
from rig.campaign.random_motors import Draw, draw
from rig.config import Experiment
from rig.config.campaign import Campaign
from rig.config.load import load
from rig.config.schema import RelaySection, UntilSection
from rig.core.estimators import LEADING
from rig.identification.measurements import measurements
from rig.identification.output_error import refit
from rig.model.bench import BenchParameters
from rig.model.sensitivity import Theta, position_and_jacobian
from rig.run_folder.recording.recording import Recording
from rig.running.experiment.stages import identify_recorded
from rig.running.experiment.until import drive_until
from rig.running.preflight.breakaway_strokes import breakaway_strokes
from rig.running.preflight.room_to_stop import room_rad, stopping_rad
from rig.running.session import Session
from stalls.hostile_host import HostileHost, Stalls
from stopping.in_memory import driven
from stopping.rows import checked

Array = NDArray[np.float64]
Board = Literal["host", "uno", "pico"]

OF = ("tau_s", "K_rad_s_V", "fc_V", "asym_V")
CONFIG = Path(__file__).resolve().parents[2] / "config" / "demo.yaml"
OF_PICO = CONFIG.with_name("demo-pico.yaml")
FINER = 4  # steps of a Pico's converter in one of an Uno's
PERCENT = 1.0  # wanted half width of the 95 % intervals
LONGEST_S = 60.0  # of the tests
FASTEST_RAD_S = 4.9
SHARE = 0.999  # of the room to stop


@dataclass(frozen=True)
class Row:
    """What came of one motor.

    board             behind which it was
    a_minute          stalls a minute that were asked for
    fault             that ended the run, in words; "" where it ended whole
    stalls, longest_stall_s  number of the host's stalls, and the longest, s
    skipped           ticks of the loop
    run_s             length of the run, s
    verdict           of the leading estimate; "": none
    error, bound      of it: estimate less truth, and the Cramer-Rao bound of the recorded rows, by ``OF``
    inside            whether its 95 % intervals hold the truth, by ``OF``
    beyond_rad        how far the shaft went beyond the hard limits, rad; 0.0: not
    check_rad         how far it went from its start in the breakaway check, rad
    seconds           of computing
    """

    number: int
    board: str
    a_minute: float
    fault: str
    stalls: int
    longest_stall_s: float
    skipped: int
    run_s: float
    verdict: str
    error: tuple[float, ...] | None
    bound: tuple[float, ...] | None
    inside: tuple[bool, ...] | None
    beyond_rad: float
    check_rad: float
    seconds: float

    def as_json(self) -> dict[str, object]:
        """As a line of rows.jsonl."""
        return asdict(self)


def config_of(one: Draw, campaign: Campaign, watchdog_s: float, board: Board = "host") -> Experiment:
    """The demo's config for this motor: its data sheet, this watchdog, and the speed that the room bears with it."""
    e = load(CONFIG)
    assert e.motor is not None
    limits = e.limits.model_copy(
        update={
            "soft_rad": (-REACH_RAD, REACH_RAD),
            "hard_rad": (-HARD_RAD, HARD_RAD),
            "max_speed_rad_s": FASTEST_RAD_S,
            "coast_tau_s": one.tau_s,
        }
    )
    given = {
        "period_s": campaign.sampling.period_s,
        "seed": campaign.seed * 1_000_003 + one.number,
        "daq": e.daq.model_copy(update={"watchdog_s": watchdog_s, "timeout_s": 0.03}),
        "limits": limits,
        "tracking": None,
        "sensor": load(OF_PICO).sensor if board == "pico" else e.sensor,
        "drive": e.drive.model_copy(update={"max_V": LARGEST_V}),
        "motor": e.motor.model_copy(update={"no_load_speed_rad_s": FAST * one.K_rad_s_V * e.drive.supply_V}),
        "relay": RelaySection(until=UntilSection(interval_percent=PERCENT, longest_s=LONGEST_S)),
    }
    levels = (
        e.model_copy(update={**given, "breakaway": e.breakaway.model_copy(update={"max_V": V})}) for V in BREAKAWAY_V
    )
    e = next((trial for trial in levels if breakaway_strokes(trial) is not None), e.model_copy(update=given))
    e = checked(e)
    slower = FASTEST_RAD_S * min(SHARE * room_rad(e.device) / stopping_rad(e.device), 1.0)
    return e.model_copy(update={"limits": e.limits.model_copy(update={"max_speed_rad_s": slower})})


def device_of(board: Board, truth: BenchParameters, e: Experiment) -> VirtualBoard | VirtualChip | VirtualPico:
    """The board in virtual time, with the bench behind it."""
    options = variant_of(truth, e.daq.baud, e.drive.bridge)
    if board == "uno":
        return VirtualChip(truth, e.seed % 2**32, options=options)
    if board == "pico":
        truth = replace(
            truth,
            rad_per_count=truth.rad_per_count / FINER,
            centre_counts=FINER * truth.centre_counts,
            counts_max=FINER * (truth.counts_max + 1) - 1,
        )
        return VirtualPico(pico_parameters(truth, e.seed % 2**32, clock_error_ppm=0.0, options=options))
    return VirtualBoard(truth, e.seed % 2**32)


def row(campaign: Campaign, number: int, stalls: Stalls, watchdog_s: float, board: Board = "host") -> Row:
    """The row of motor ``number`` of the campaign."""
    began = time.perf_counter()
    one = draw(campaign, number)
    sensor = campaign.sensor
    e = config_of(one, campaign, watchdog_s, board)
    truth = BenchParameters(
        one.motor(), noise_rad=sensor.noise_rad, rad_per_count=sensor.lsb_rad, offset_rad=one.offset_rad
    )
    host = HostileHost(device_of(board, truth, e), stalls, e.seed)
    driver = SerialDriver(
        host, e.device.scaling, Timeouts(e.daq.timeout_s, e.daq.open_timeout_s), session=1 + number, emulated=True
    )
    opened = OpenBench(driver, host, driver.open(), truth)

    def script(session: Session) -> None:
        drive_until(session)
        identify_recorded(session)

    session, fault = driven(e, opened, script)
    recording = session.read()
    found = session.found.identification
    estimate = None if found is None else found.estimates.get(LEADING)
    true = Theta(one.tau_s, one.K_rad_s_V, one.fc_V, one.asym_V, 0.0)
    error = bound = inside = None
    if estimate is not None:
        error = tuple(float(getattr(estimate, name) - getattr(true, name)) for name in OF)
        step_rad = sensor.lsb_rad / (FINER if board == "pico" else 1)
        bound = _bound(recording, true, math.hypot(sensor.noise_rad, step_rad / math.sqrt(12.0)))
        intervals = [estimate.ci95.get(name, (math.nan, math.nan)) for name in OF]
        inside = tuple(low <= getattr(true, name) <= high for name, (low, high) in zip(OF, intervals, strict=True))
    check = np.array([str(stage) == "breakaway" for stage in recording.stage]) if recording.stage is not None else []
    went = recording.y_rad[check] if np.any(check) else np.zeros(1)
    return Row(
        number,
        board,
        stalls.a_minute,
        "" if fault is None else str(fault),
        len(host.lengths_s),
        max(host.lengths_s, default=0.0),
        session.loop.statistics.skipped,
        float(recording.t_s[-1]),
        "" if estimate is None else estimate.verdict,
        error,
        bound,
        inside,
        max(host.furthest_rad - HARD_RAD, 0.0),
        float(np.max(np.abs(went - went[0]))),
        time.perf_counter() - began,
    )


def _bound(recording: Recording, true: Theta, noise_rad: float) -> tuple[float, ...]:
    """The Cramer-Rao bound of all the rows that an estimator may read, by ``OF``; each series has its own start."""
    data = measurements([recording], with_cycles=True, plain_is_hysteretic=False)
    information = np.zeros((len(OF), len(OF)))
    for series in [*data.tests, *data.beside]:
        window = series.predictable(0.0)
        start = refit([series], true).x[-2:]
        theta = true._replace(v0_rad_per_s=float(start[0]), y0_rad=float(start[1]))
        jacobian = position_and_jacobian(theta, *window.steps, window.t_s)[1] / noise_rad
        own, shared = jacobian[:, 5:], jacobian[:, : len(OF)]
        left = shared - own @ np.linalg.lstsq(own, shared, rcond=None)[0]
        information += left.T @ left
    return tuple(np.sqrt(np.diag(np.linalg.inv(information))).tolist())
