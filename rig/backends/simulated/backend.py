"""``driver: simulated``: the motor of section ``emulated`` on this machine, in virtual time."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace

from typing_extensions import override

from rig.backends.backend import Backend, Unopened, Watchdog, emulated_of
from rig.backends.clock import VirtualClock
from rig.backends.emulated.shaft import ShaftPath
from rig.config.problems import Problem, wrong
from rig.config.schema import DeviceSetup
from rig.core.strict_json import JsonObject

_ROUNDED_S = 1e-6  # the last digit in samples.csv


class SimulatedBackend(Backend):
    """No device: a model of the motor, and a driver with its own clock."""

    name = "simulated"
    shared_keys = frozenset()

    @override
    def rules(self, d: DeviceSetup) -> Iterator[Problem]:
        if d.emulated is None:
            yield wrong(
                "emulated", "`driver: simulated` needs this section", "describe the bench: see config/demo.yaml"
            )
        if d.runs_relay:
            yield wrong(
                "relay.where",
                "`driver: simulated` has no device",
                "set it to host, or daq.driver to serial with a port",
            )

    @override
    def watchdog(self, d: DeviceSetup) -> Watchdog:
        return Watchdog(d.daq.watchdog_s)

    @override
    def writes_first(self, d: DeviceSetup) -> bool:
        return False

    @override
    def times_error_s(self, d: DeviceSetup) -> float:
        """Exact, but for the digits in samples.csv."""
        return _ROUNDED_S

    @override
    def words(self, d: DeviceSetup) -> str:
        return "a simulation in virtual time, no device, nothing moves"

    @override
    def is_emulated(self, d: DeviceSetup) -> bool:
        return True

    @override
    def in_virtual_time(self, d: DeviceSetup) -> bool:
        return True

    @override
    def rehearsed(self, d: DeviceSetup) -> dict[str, JsonObject]:
        """As it is."""
        return {"daq": {}, "emulated": {}}

    @override
    @contextmanager
    def unopened(self, d: DeviceSetup) -> Iterator[Unopened]:
        """Raises ValueError without section ``emulated``."""
        from rig.backends.emulated.bench_of_config import bench_parameters
        from rig.backends.simulated.driver import SimulatedDriver, SimulatedLatency

        emulated = emulated_of(d)
        truth = bench_parameters(emulated, d.tachometer)
        clock = VirtualClock()
        as_it_says = replace(d.drive.map, full_units=truth.drive_counts)  # as a real device says of itself
        driver = SimulatedDriver(
            clock,
            truth,
            replace(d.scaling, drive_map=as_it_says),
            SimulatedLatency(emulated.latency_s, emulated.latency_jitter_s),
            d.seed,
        )
        yield Unopened(driver, clock, truth, lambda: ShaftPath(*driver.shaft()))


SIMULATED = SimulatedBackend()
