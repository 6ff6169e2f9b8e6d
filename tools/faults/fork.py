"""A copy of this process."""

from __future__ import annotations

import os
import warnings


def fork() -> int:
    """As os.fork. The copy goes on with this thread alone, which all that is done here can live with."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)
        return os.fork()
