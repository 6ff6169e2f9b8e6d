"""The targets of `make fuzz` on a bounded number of inputs: seeds, seeds with damage, and anything."""

import random

import pytest
from evidence import evidence, examples
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from fuzz.targets import TARGETS

INPUTS = {"identify": 100, "config": 300, "campaign-config": 300, "run-folder": 300, "replay": 60, "hostile-run": 40}
INPUTS |= {"hostile-config": 40, "strict-json": 200, "servo-bus": 300}


LONG = ("config", "hostile-run")


@pytest.mark.parametrize("name", [*(name for name in TARGETS if name not in LONG), *evidence(*LONG)])
def test_seeds_and_damaged_seeds(name: str) -> None:
    """Bytes changed, cut out, repeated, as disks, editors and wires do."""
    target, draw = TARGETS[name], random.Random(name)
    seeds = list(target.seeds())
    for seed in seeds:
        target.feed(seed)
    for _ in range(examples(INPUTS.get(name, 1000))):
        data = bytearray(draw.choice(seeds))
        for _ in range(draw.randint(1, 4)):
            at = draw.randrange(len(data) + 1)
            length = draw.choice((1, 1, 2, 8, 100))
            how = draw.randrange(4)
            if how == 0:
                data[at : at + length] = draw.randbytes(length)
            elif how == 1:
                del data[at : at + length]
            elif how == 2:
                data[at:at] = data[at : at + length] * draw.choice((1, 2, 50))
            else:
                data[at : at + 1] = draw.choice((b"\n", b"nan", b"-1e999", b"\0", b"\xff", b",", b": ", b"{", b"0"))
        target.feed(bytes(data))


@pytest.mark.parametrize("name", TARGETS)
def test_anything(name: str) -> None:
    feed = TARGETS[name].feed

    @settings(
        max_examples=examples(INPUTS.get(name, 1000)),
        deadline=None,
        suppress_health_check=list(HealthCheck),
        database=None,
    )
    @given(st.binary(max_size=300) | st.text(max_size=200).map(lambda text: text.encode("utf-8", "replace")))
    def feeds(data: bytes) -> None:
        feed(data)

    feeds()


def test_a_target_lets_a_defect_through() -> None:
    """What is not declared must not be swallowed: a reader that raises something else fails its target."""
    with pytest.raises(AssertionError), pytest.MonkeyPatch.context() as patch:
        patch.setattr("fuzz.targets.frames.FrameReader.feed", lambda self, data: [data])
        TARGETS["frames"].feed(bytes([200, 3, 1, 2, 3]))
