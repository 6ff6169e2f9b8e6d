"""The conformance suite: a sound driver passes, and each defect is found by the test that is named for it."""

from collections.abc import Collection
from importlib.metadata import EntryPoint
from pathlib import Path

import pytest
from broken_cards import CAUGHT_BY
from plug_in_cards import VirtualCard, WriteFirstCard

from rig.backends import plug_in
from rig.backends.driver import Driver
from rig.testing import conformance

CONFIG = Path(__file__).with_name("virtual-card.yaml")


def offer(monkeypatch: pytest.MonkeyPatch, card: type[VirtualCard]) -> None:
    entry = EntryPoint("virtual-card", f"{card.__module__}:{card.__qualname__}", plug_in.GROUP)
    monkeypatch.setattr(plug_in, "entry_points", lambda group: [entry])


def pull_the_plug(driver: Driver) -> None:
    assert isinstance(driver, VirtualCard)
    driver.dead = True


def failures(suite: type[conformance.Suite], only: Collection[str] = ()) -> dict[str, str]:
    """The tests of a suite that fail, as pytest would run them, and what they say; ``only`` these, where given."""
    names = [name for base in reversed(suite.__mro__) for name in vars(base) if name.startswith("test_")]
    assert len(names) > 20 and set(only) <= set(names)
    said = {}
    for name in only or names:
        test = suite()
        try:
            test.setup_method()
            getattr(test, name)()
        except Exception as error:  # noqa: BLE001 - whatever a broken driver raises
            said[name] = f"{type(error).__name__}: {error}"
        finally:
            test.teardown_method()
    suite.teardown_class()
    return said


@pytest.mark.parametrize("card", [VirtualCard, WriteFirstCard])
def test_a_sound_driver_passes(monkeypatch: pytest.MonkeyPatch, card: type[VirtualCard]) -> None:
    offer(monkeypatch, card)
    assert failures(conformance.suite(CONFIG, silence=True, cut=pull_the_plug)) == {}


@pytest.mark.parametrize("card", CAUGHT_BY, ids=lambda card: card.__name__)
def test_a_defect_is_found_by_name(monkeypatch: pytest.MonkeyPatch, card: type[VirtualCard]) -> None:
    offer(monkeypatch, card)
    said = failures(conformance.suite(CONFIG, silence=True, cut=pull_the_plug), CAUGHT_BY[card])
    assert set(said) == set(CAUGHT_BY[card]), said


@pytest.mark.evidence
@pytest.mark.parametrize("card", CAUGHT_BY, ids=lambda card: card.__name__)
def test_a_defect_fails_no_other_test(monkeypatch: pytest.MonkeyPatch, card: type[VirtualCard]) -> None:
    offer(monkeypatch, card)
    said = failures(conformance.suite(CONFIG, silence=True, cut=pull_the_plug))
    assert set(said) == CAUGHT_BY[card], said
