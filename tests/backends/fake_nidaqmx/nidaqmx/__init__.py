"""A stand-in for the package nidaqmx: a card with the simulated motor behind it, in virtual time.

Only what the example driver uses, and that as the package's documentation says: names and arguments of nidaqmx 1.7;
on-demand timing; a task reserves its channels from its start until it is closed; an output holds its value whatever
becomes of its task.
"""

from __future__ import annotations

import warnings

from nidaqmx.card import CARD
from nidaqmx.constants import TerminalConfiguration
from nidaqmx.errors import DaqError, DaqResourceWarning, DaqWriteError

__all__ = ["DaqError", "DaqResourceWarning", "DaqWriteError", "Task"]


class _Channels:
    def __init__(self, task: Task) -> None:
        self._task = task

    def _add(self, physical_channel: str, known: str, min_val: float, max_val: float) -> None:
        device, _, channel = physical_channel.partition("/")
        CARD.meet(device)
        if channel != known:
            raise DaqError(f"Physical channel specified does not exist on this device.\n\n{channel}", -200170)
        self._task.channel, self._task.range_V = physical_channel, (min_val, max_val)


class _Inputs(_Channels):
    def add_ai_voltage_chan(
        self,
        physical_channel: str,
        name_to_assign_to_channel: str = "",
        terminal_config: TerminalConfiguration = TerminalConfiguration.DEFAULT,
        min_val: float = -5.0,
        max_val: float = 5.0,
    ) -> None:
        assert isinstance(terminal_config, TerminalConfiguration)
        self._add(physical_channel, "ai0", min_val, max_val)


class _Outputs(_Channels):
    def add_ao_voltage_chan(
        self, physical_channel: str, name_to_assign_to_channel: str = "", min_val: float = -10.0, max_val: float = 10.0
    ) -> None:
        self._add(physical_channel, "ao0", min_val, max_val)


class Task:
    def __init__(self, new_task_name: str = "") -> None:
        self.ai_channels, self.ao_channels = _Inputs(self), _Outputs(self)
        self.channel = ""
        self.range_V = (0.0, 0.0)
        self.closed = False

    def __del__(self) -> None:
        if not self.closed:
            warnings.warn("Task was not explicitly closed before it was destructed.", DaqResourceWarning, stacklevel=1)

    def _usable(self) -> None:
        if self.closed:
            raise DaqError("Task specified is invalid or does not exist.", -200088)
        CARD.meet(self.channel.partition("/")[0])

    def _started(self) -> None:
        if CARD.reserved.get(self.channel) is not self:
            self.start()
            CARD.restarts += 1  # and it would stop after the sample

    def start(self) -> None:
        self._usable()
        if CARD.reserved.setdefault(self.channel, self) is not self:
            raise DaqError("The specified resource is reserved. The operation could not be completed.", -50103)

    def read(self, number_of_samples_per_channel: int | None = None, timeout: float = 10.0) -> float:
        self._usable()
        assert number_of_samples_per_channel is None, "a list would come"
        self._started()
        low_V, high_V = self.range_V
        return min(max(CARD.convert(), low_V), high_V)

    def write(self, data: float, auto_start: bool = True, timeout: float = 10.0) -> int:
        self._usable()
        self._started()
        low_V, high_V = self.range_V
        if not low_V <= data <= high_V:
            raise DaqWriteError("Attempted writing analog data that is too large or too small.", -200561, 0)
        CARD.generate(data)
        return 1

    def close(self) -> None:
        if self.closed:
            warnings.warn(
                "Attempted to close NI-DAQmx task but task was already closed.", DaqResourceWarning, stacklevel=2
            )
        self.closed = True
        if CARD.reserved.get(self.channel) is self:
            del CARD.reserved[self.channel]
