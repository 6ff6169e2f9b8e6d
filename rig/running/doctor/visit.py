"""What `rig doctor` looks at: the machine, and with a config the link and the device behind it."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from rig.backends.clock import MonotonicClock
from rig.backends.emulated.words import in_real_time, in_virtual_time
from rig.backends.registry import backend_of, connect
from rig.config.schema import Experiment
from rig.control.loop.real_time import real_time
from rig.core.faults import Fault, since_the_last_run
from rig.running.doctor import machine, measured
from rig.running.doctor.finding import Finding
from rig.running.preflight.loop_settings import real_time_of
from rig.running.preflight.room_to_stop import watchdog_words

SECONDS = 3.0  # of ticks
_PERIOD_S, _SPIN_S = 0.01, 200e-6  # without a config


def without_config(run_folder: Path, seconds: float = SECONDS) -> Iterator[Finding]:
    """Findings about the machine; the loop's ticks are timed for ``seconds``, s."""
    yield from machine.examine(run_folder)
    with real_time():
        ticks = measured.run_ticks(MonotonicClock(_SPIN_S), _PERIOD_S, _number(seconds, _PERIOD_S))
    yield measured.wake_ups(ticks)


def with_config(experiment: Experiment, run_folder: Path, seconds: float = SECONDS) -> Iterator[Finding]:
    """Findings about the machine, and about the link and the device of ``experiment``.

    The device is opened and read at the experiment's period for ``seconds``, s. It is never armed. A device that does
    not answer is a finding.
    """
    d = experiment.device
    yield from machine.examine(run_folder, ports=False)
    port_name = experiment.daq.port or ""
    backend = backend_of(d)
    adapter = backend.adapter_behind(d)
    if port_name.startswith("/"):
        port = machine.serial_port(Path(port_name))
        yield port
        if port.state == "bad":
            return
    if words := watchdog_words(experiment):
        topic, _, told = words.partition(": ")
        yield Finding(topic, "note", told)
    try:
        with connect(d) as bench:
            yield Finding("device", "good", bench.driver.backend)
            for remark in bench.info.remarks:
                yield Finding("device", "note", remark)
            for code in bench.info.acknowledged:
                yield Finding("device", "note", since_the_last_run(code))
            if adapter is not None:  # only now: opening the port asks an FTDI to wait for 1 ms only
                yield machine.usb_adapter(port_name, adapter)
            if not isinstance(bench.clock, MonotonicClock):
                real = "" if not in_virtual_time(port_name) else f"daq.port: {in_real_time(port_name)} has one to time"
                yield Finding("period", "note", "this bench runs in virtual time: it holds every period", real)
                return
            with real_time(real_time_of(experiment)):
                number = _number(seconds, experiment.period_s)
                ticks = measured.run_ticks(bench.clock, experiment.period_s, number, bench.driver.read)
    except Fault as fault:
        detail = f" ({fault.detail})" if fault.detail else ""
        yield Finding("device", "bad", f"{fault.code}: {fault.cause}{detail}", fault.cure)
        return
    yield measured.wake_ups(ticks)
    reading = backend.reading_budget(d)
    yield measured.round_trip(ticks, reading.total_s, reading.written if reading.terms else "")
    yield measured.verdict(ticks, backend.budget(d).total_s - reading.total_s)


def _number(seconds: float, period_s: float) -> int:
    return max(round(seconds / period_s), 20)
