"""Units at the end of keys, and the units that people write by mistake."""

from __future__ import annotations

# ending of a key -> unit in words; longer endings first
_WORDS = {
    "rad_s_per_count": "rad/s per count",
    "rad_per_count": "rad per count",
    "rad_s_V": "(rad/s)/V",
    "rad_s": "rad/s",
    "V_s": "V/s",
    "1_s2": "1/s^2",
    "1_s": "1/s",
    "rad": "rad",
    "s": "seconds",
    "V": "volts",
    "ppm": "parts per million",
    "counts": "counts",
    "duty": "duty, 0 to 1",
    "baud": "bits per second",
}

# unit that somebody may write instead -> (ours, how many of ours one of theirs is; None: not a plain factor)
_FOREIGN: dict[str, tuple[str, float | None]] = {
    "ms": ("s", 1e-3),
    "us": ("s", 1e-6),
    "sec": ("s", 1.0),
    "seconds": ("s", 1.0),
    "min": ("s", 60.0),
    "hz": ("s", None),
    "mv": ("V", 1e-3),
    "volt": ("V", 1.0),
    "volts": ("V", 1.0),
    "deg": ("rad", 0.017453292519943295),
    "degrees": ("rad", 0.017453292519943295),
    "mrad": ("rad", 1e-3),
    "deg_s": ("rad_s", 0.017453292519943295),
    "rpm": ("rad_s", 0.10471975511965977),
    "rad_per_s": ("rad_s", 1.0),
}


_ENDINGS = sorted([*_FOREIGN, *(ending.lower() for ending in _WORDS)], key=len, reverse=True)


def unit_of(key: str) -> str:
    """Unit of a key in words, "" if it has none: ``period_s`` -> "seconds"."""
    return next((words for ending, words in _WORDS.items() if key == ending or key.endswith(f"_{ending}")), "")


def stem_of(key: str) -> str:
    """A key without its unit, ours or another, in lower case: ``period_ms`` -> "period"."""
    lower = key.lower()
    return next((lower[: -len(end) - 1] for end in _ENDINGS if lower.endswith(f"_{end}")), lower)


def converted(value: object, written: str, wanted: str) -> str:
    """A value of the key ``written``, converted to the unit of the key ``wanted``: "10 ms is 0.01"; "" if unknown."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        return ""
    for ending, (ours, factor) in _FOREIGN.items():
        if factor is not None and written.lower().endswith(f"_{ending}") and wanted.endswith(f"_{ours}"):
            return f"{value:g} {ending} is {value * factor:.6g}" if abs(value) < 1e300 else ""
    return ""
