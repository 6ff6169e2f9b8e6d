"""The system of the stand-in: one card."""

from __future__ import annotations

from typing import NamedTuple

from nidaqmx.card import CARD


class DriverVersion(NamedTuple):
    major_version: int
    minor_version: int
    update_version: int


class System:
    driver_version = DriverVersion(24, 5, 0)

    @staticmethod
    def local() -> System:
        return System()


class Device:
    def __init__(self, name: str) -> None:
        self._name = name

    @property
    def product_type(self) -> str:
        CARD.meet(self._name)
        return "PCI-6221"

    @property
    def serial_num(self) -> int:
        return 0x1A2B3C4

    @property
    def is_simulated(self) -> bool:
        return True
