"""Deep, wide, huge and strange values, made from any bytes: what damage to a good file hardly ever becomes.

An input is a program for a small machine: each byte appends to the text, or repeats what was appended last.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

MOST_CHARACTERS: Final = 40_000

_JSON: Final = (
    "{", "}", "[", "]", ",", ":", '"', "\\", " ", "\n", "null", "true", "false", "NaN", "-Infinity", "1e400",
    "-0.0", "1E-999", "9" * 40, "9" * 41, "0.1", "-", '"kind":', '"t_s":', '"name":', '"stage"', '"cycle"',
    '"link"', '"live"', '"fault"', '"errors":', '"number":', '"amplitude_rad":', '"h1_V":', '"__proto__":',
    '"\\ud800"', '"\\u0000"', '"truth":', '"law":', '"estimates":', '"script":', '"period_s":', "\0", "\ufeff",
    "\u2028", '{"a":', "[[", "0,",
)  # fmt: skip
_YAML: Final = (
    "a", "b", ": ", ":\n", "\n", "  ", "- ", "? ", "&a ", "*a", "<<: ", "!!int ", "[", "]", "{", "}", ", ", "'",
    '"', "|\n", ">\n", "#", "---\n", "...\n", "%YAML 1.1\n", "2001-99-99", "1e400", ".inf", "0x" + "f" * 41,
    "9" * 41, "~", "true", "name: ", "period_s: ", "limits:\n  ", "hard_rad: ", "relay:\n  ", "target:\n  ", "\t",
    "\\U", "\x07", "\ufeff", "[*a,*a,*a,*a]", "&b {<<: [*a]}\n",
)  # fmt: skip


def _text(data: bytes, words: tuple[str, ...]) -> str:
    """The text of a program: a byte below the count of words is that word, one above repeats the last words often."""
    out, last = "", ""
    steps = iter(data)
    for step in steps:
        if step < len(words):
            last, out = words[step], out + words[step]
        elif step < 200:  # the last 1 to 8 words' length of text, 2 to 2^16 times
            last = out[-1 - step % 24 :]
            out += last * (1 << next(steps, 0) % 17)
        else:
            out += chr(step)
        out = out[:MOST_CHARACTERS]
    return out


def json_text(data: bytes) -> str:
    """JSON, or nearly."""
    return _text(data, _JSON)


def yaml_text(data: bytes) -> str:
    """YAML, or nearly."""
    return _text(data, _YAML)


def _program(text: str, words: tuple[str, ...]) -> bytes:
    out = b""
    while text:
        found = max((word for word in words if text.startswith(word)), key=len, default="")
        out += bytes([words.index(found)]) if found else b""
        text = text[len(found) or 1 :]
    return out


def json_seeds() -> Iterator[bytes]:
    """Programs of texts that once did harm, and of their kin."""
    for text in (
        '{"kind":"link","errors":1e400}',
        '{"a":[0.1,null,"\\ud800"],"kind":"stage","name":"stage"}',
        "[[]]",
        "0,0,",
    ):
        program = _program(text, _JSON)
        yield program
        yield program + bytes([60, 12])
        yield bytes([2, 60, 16]) + program


def yaml_seeds() -> Iterator[bytes]:
    """Likewise."""
    for text in (
        "a: &a [b, b]\nb: &b {<<: [*a,*a,*a,*a]}\n",
        "a: 2001-99-99\n",
        "period_s: " + "9" * 41,
        "a: [[[",
        "- - - a",
    ):
        program = _program(text, _YAML)
        yield program
        yield program + bytes([60, 12])
