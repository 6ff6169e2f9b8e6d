"""From nothing to report.html: each example in turn, as many at a time as there are processors."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

from paper import (
    example_4_1,
    example_4_2a,
    example_4_2b,
    example_4_2c,
    example_4_3,
    noise,
    sampling,
    section_5,
    table_1,
    theorem_2_1,
)
from paper.drawing import style
from paper.page import Report, Section, render_page
from shared import page
from shared.cases import spread


def make_4_1(quick: bool) -> Section:
    """Example 4.1."""
    return example_4_1.section(example_4_1.compute(9 if quick else 31))


def make_2_1(quick: bool) -> Section:
    """Theorem 2.1."""
    return theorem_2_1.section(theorem_2_1.compute(4, 2, 3, 3) if quick else theorem_2_1.compute())


def make_4_2a(_quick: bool) -> Section:
    """Example 4.2 (a)."""
    return example_4_2a.section(example_4_2a.compute())


def make_4_2b(quick: bool) -> Section:
    """Example 4.2 (b)."""
    return example_4_2b.section(example_4_2b.compute(7 if quick else 25))


def make_4_2c(quick: bool) -> Section:
    """Example 4.2 (c), (d)."""
    return example_4_2c.section(example_4_2c.compute(7, 5) if quick else example_4_2c.compute())


def make_table_1(_quick: bool) -> Section:
    """Table I."""
    return table_1.section(table_1.compute())


def make_noise(quick: bool) -> Section:
    """Remarks 3.1 and 3.2."""
    return noise.section(noise.compute(2 if quick else 12))


def make_4_3(quick: bool) -> Section:
    """Example 4.3."""
    return example_4_3.section(example_4_3.compute(3 if quick else 7))


def make_5(quick: bool) -> Section:
    """Section V."""
    return section_5.section(section_5.compute(3, 4.0, law=False) if quick else section_5.compute())


def make_sampling(quick: bool) -> Section:
    """What sampling does."""
    return sampling.section(sampling.compute(1, (0.002, 0.01)) if quick else sampling.compute())


class Step(NamedTuple):
    """One section: what it is called while it is made, and how long it takes of the whole, roughly."""

    name: str
    make: Callable[[bool], Section]
    share: float


STEPS = (
    Step("Example 4.1: the limit cycle", make_4_1, 0.03),
    Step("Theorem 2.1: existence, uniqueness, convergence", make_2_1, 0.3),
    Step("Example 4.2 (a): least squares", make_4_2a, 0.02),
    Step("Example 4.2 (b): describing function", make_4_2b, 0.01),
    Step("Example 4.2 (c), (d): triple relay, two-stage", make_4_2c, 0.1),
    Step("Table I: the methods in one place", make_table_1, 0.02),
    Step("Noise: Remarks 3.1 and 3.2", make_noise, 0.1),
    Step("Example 4.3: Tustin's friction", make_4_3, 0.02),
    Step("Section V: the bench", make_5, 0.5),
    Step("What sampling does", make_sampling, 0.25),
)


def build(out: Path, *, quick: bool = False, say: Callable[[str], None] = print) -> Path:
    """Compute everything and write one self-contained HTML file to ``out``; its path.

    quick   fewer trials and coarser curves
    say     takes one line for each section when it is done
    """
    report = Report(make_sections(quick, say))
    page.write(out, render_page(report))
    return out


def make_sections(quick: bool, say: Callable[[str], None]) -> tuple[Section, ...]:
    """All sections in their order on the page; the longest is begun first."""
    begin = time.perf_counter()
    made: dict[int, Section] = {}
    order = sorted(range(len(STEPS)), key=lambda k: -STEPS[k].share)
    for place, (section, took_s) in spread(timed, [(k, quick) for k in order]):
        k = order[place]
        made[k] = section
        say(f"[{len(made)}/{len(STEPS)}] {time.perf_counter() - begin:5.1f} s  {STEPS[k].name} ({took_s:.1f} s)")
    return tuple(made[k] for k in range(len(STEPS)))


def timed(step: int, quick: bool) -> tuple[Section, float]:
    """One section, and the seconds that it took."""
    begin = time.perf_counter()
    with style():
        return STEPS[step].make(quick), time.perf_counter() - begin
