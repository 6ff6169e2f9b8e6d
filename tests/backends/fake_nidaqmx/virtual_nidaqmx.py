"""The example's driver in the stand-in's virtual time."""

from nidaqmx.card import CARD
from rig_nidaqmx import CardDriver


class VirtualCardDriver(CardDriver):
    clock = CARD.clock
    now_s = staticmethod(CARD.clock.now_s)
