"""Why the panel does not do what a page asks for."""

from __future__ import annotations

from rig.core.errors import RigError


class RefusedError(RigError):
    """An answer that is no: HTTP status, what is wrong, what to do."""

    def __init__(self, status: int, what: str, cure: str) -> None:
        self.status, self.what, self.cure = status, what, cure
        super().__init__(f"{what}\n{cure}")
