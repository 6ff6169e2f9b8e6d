"""What a call raises, for tests that look at it."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from rig.core.faults import Fault


def fault_of(call: Callable[..., object], *arguments: object) -> Fault:
    """The fault that the call raises; fails where it raises none."""
    with pytest.raises(Fault) as caught:
        call(*arguments)
    return caught.value
