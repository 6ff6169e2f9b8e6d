"""From nothing to report.html: each example in turn."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path

from paper import example_4_1, example_4_2a, example_4_2b, example_4_2c, example_4_3, noise, sampling, section_5
from paper.drawing import style
from paper.page import Report, Section, render_page


def examples(quick: bool) -> list[tuple[str, Callable[[], Section]]]:
    """What each step is called and how it is made."""
    return [
        ("Example 4.1: limit cycle", lambda: example_4_1.section(example_4_1.compute(9 if quick else 31))),
        ("Example 4.2 (a): least squares", lambda: example_4_2a.section(example_4_2a.compute())),
        ("Example 4.2 (b): describing function", lambda: example_4_2b.section(example_4_2b.compute())),
        (
            "Example 4.2 (c), (d): triple relay",
            lambda: example_4_2c.section(example_4_2c.compute(9 if quick else 27)),
        ),
        ("Noise: Remarks 3.1 and 3.2", lambda: noise.section(noise.compute(3 if quick else 12))),
        ("Example 4.3: Tustin's friction", lambda: example_4_3.section(example_4_3.compute(3 if quick else 7))),
        (
            "Section V: the bench",
            lambda: section_5.section(section_5.compute(2, 5.0) if quick else section_5.compute()),
        ),
        (
            "What sampling does",
            lambda: sampling.section(sampling.compute(1, (0.002, 0.01)) if quick else sampling.compute()),
        ),
    ]


def build(out: Path, *, quick: bool = False, say: Callable[[str], None] = print) -> Path:
    """Compute everything and write one self-contained HTML file to ``out``; its path."""
    steps = examples(quick)
    sections = []
    for number, (name, make) in enumerate(steps, start=1):
        begin = time.perf_counter()
        with style():
            sections.append(make())
        say(f"[{number}/{len(steps)}] {name}: {time.perf_counter() - begin:.1f} s")
    out.parent.mkdir(parents=True, exist_ok=True)
    half = out.with_name(f".{out.name}.part")
    half.write_text(render_page(Report(tuple(sections))), encoding="utf-8")
    half.replace(out)
    return out
