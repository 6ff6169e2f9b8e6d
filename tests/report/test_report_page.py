"""The whole page: valid, self-contained, true to result.json, honest about what is missing."""

from __future__ import annotations

import base64
import html
import json
import math
import re
import shutil
from collections.abc import Callable
from contextlib import AbstractContextManager
from dataclasses import replace
from html.parser import HTMLParser
from itertools import combinations, pairwise
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner
from evidence import evidence, examples
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from matplotlib.figure import Figure
from matplotlib.text import Text
from synthetic_run import BACKEND, write_run

from rig.cli import main
from rig.core.faults import FAULTS, Fault
from rig.output.report import fitted, tables, write_report
from rig.output.report.page import render_page
from rig.output.report.source import load
from rig.output.report.style import style
from rig.output.report.words import PARAMETERS, quantity
from rig.run_folder.results import EstimateResult

pytestmark = [pytest.mark.long, pytest.mark.drawn]

FILES = ("samples.csv", "meta.json", "events.jsonl", "config.yaml", "result.json")
# without samples (quick), without a result, without all; the others are evidence
SUBSETS = [
    ("samples.csv",), ("result.json",), FILES,
    *evidence((("meta.json",),), (("events.jsonl",),), (("config.yaml",),), (("events.jsonl", "result.json"),)),
    *evidence(*((c,) for n in range(2, 5) for c in combinations(FILES, n) if "samples.csv" in c or n == 4)),
]  # fmt: skip
VOID = {"meta", "img", "br", "link", "hr", "input", "wbr"}


class Page(HTMLParser):
    """What tests look at; raises AssertionError on unbalanced tags."""

    def __init__(self, text: str) -> None:
        super().__init__(convert_charrefs=True)
        self.stack: list[str] = []
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.text: list[str] = []
        self.values: list[float] = []
        self.feed(text)
        self.close()
        assert self.stack == []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attrs)))
        if tag not in VOID:
            self.stack.append(tag)
        if tag == "data":
            self.values.append(float(str(dict(attrs)["value"])))

    def handle_endtag(self, tag: str) -> None:
        assert self.stack and self.stack[-1] == tag, f"</{tag}> closes <{self.stack[-1:]}> at {self.getpos()}"
        self.stack.pop()

    def handle_data(self, data: str) -> None:
        if self.stack and self.stack[-1] not in ("style", "script"):
            self.text.append(data)

    @property
    def words(self) -> str:
        return " ".join(" ".join(self.text).split())

    def images(self) -> list[dict[str, str | None]]:
        return [attrs for tag, attrs in self.tags if tag == "img"]


def page_of(folder: Path) -> Page:
    return Page(write_report(folder).read_text(encoding="utf-8"))


def svg_of(image: dict[str, str | None]) -> str:
    prefix, _, data = str(image["src"]).partition(",")
    assert prefix == "data:image/svg+xml;base64"
    return base64.b64decode(data).decode("utf-8")


@pytest.fixture(scope="module")
def complete(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_run(tmp_path_factory.mktemp("run") / "20260509T120000Z-synthetic")


@pytest.fixture(scope="module")
def drawn(complete: Path) -> tuple[Page, list[list[str]]]:
    """The page of the complete run, which takes long to draw; and of each of its figures the tick labels that touch."""
    touching: list[list[str]] = []
    original = Figure.savefig

    def look(figure: Figure, *arguments: Any, **options: Any) -> None:
        original(figure, *arguments, **options)
        touching.append(overlaps(figure))

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Figure, "savefig", look)
        return page_of(complete), touching


@pytest.fixture(scope="module")
def page(drawn: tuple[Page, list[list[str]]]) -> Page:
    return drawn[0]


@pytest.fixture
def run(complete: Path, tmp_path: Path) -> Path:
    """A copy of the complete run to break."""
    return Path(shutil.copytree(complete, tmp_path / complete.name))


def edit(path: Path, change: Callable[[dict[str, Any]], None]) -> None:
    value = json.loads(path.read_text())
    change(value)
    path.write_text(json.dumps(value))


def test_the_page_is_balanced_with_unique_ids_and_targets_for_its_links(page: Page) -> None:
    ids = [attrs["id"] for _, attrs in page.tags if "id" in attrs]
    assert len(ids) == len(set(ids))
    links = [str(attrs["href"]) for tag, attrs in page.tags if tag == "a"]
    assert links
    assert {link.removeprefix("#") for link in links} <= set(ids)


def test_nothing_is_loaded_from_elsewhere(page: Page, complete: Path) -> None:
    for tag, attrs in page.tags:
        assert tag not in ("script", "link", "iframe", "object", "embed")
        for name in ("src", "href", "srcset", "action", "poster"):
            target = attrs.get(name)
            assert target is None or target.startswith(("data:", "#"))
    text = (complete / "report.html").read_text()
    style = text[text.index("<style>") : text.index("</style>")]
    assert "url(" not in style
    assert "@import" not in style
    for image in page.images():
        svg = svg_of(image)
        for part in svg.split("href=")[1:]:
            assert part.startswith(('"#', '"data:'))


def test_every_figure_names_the_backend_in_picture_alt_and_caption(page: Page) -> None:
    images = page.images()
    assert len(images) == 11
    for image in images:
        # glyphs are outlines; matplotlib writes the string beside them as a comment
        assert f"backend: {BACKEND}" in html.unescape(svg_of(image))
        assert BACKEND in str(image["alt"])
    assert page.words.count(f"Backend: {BACKEND}.") == len(images)


def test_header_and_footer_of_printed_pages_name_the_backend(page: Page, complete: Path) -> None:
    assert page.words.startswith(f"{complete.name} – identification report {complete.name} · backend: {BACKEND}")
    assert page.words.endswith(f"{complete.name} · backend: {BACKEND}")
    text = (complete / "report.html").read_text()
    assert "display: table-header-group; break-inside: avoid" in text
    assert "display: table-footer-group; break-inside: avoid" in text


def test_numbers_are_those_of_the_result(page: Page, complete: Path) -> None:
    result = json.loads((complete / "result.json").read_text())
    expected = []
    for estimate in result["estimates"].values():
        expected += [estimate[k] for k in ("tau_s", "K_rad_s_V", "fc_V", "asym_V", "delay_s", "rms_rad")]
    for relay in result["relays"]:
        expected += [relay[k] for k in ("h1_V", "h2_V", "period_s", "amplitude_rad", "cycles")]
    for tracked in result["tracking"].values():
        expected += [tracked[k] for k in ("rms_rad", "max_rad") if k in tracked]
    expected += [result["loop"]["ticks"], *result["loop"]["late_us"].values()]
    for value in expected:
        assert value in page.values


@pytest.mark.evidence
@pytest.mark.usefixtures("undrawn")
def test_a_run_with_laws_shows_them_in_the_pictures_and_in_the_tracking_check(
    run: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The law of this motor is none at all: a sag of nearly nothing, so that its picture is the plain model's."""
    texts: list[str] = []

    def note(figure: Figure, buffer: Any, **_: Any) -> None:
        texts.extend(text.get_text() for text in figure.findobj(Text))
        buffer.write(b"<svg/>")

    monkeypatch.setattr(Figure, "savefig", note)

    def with_law(result: dict[str, Any]) -> None:
        leading = result["estimates"]["sampled-data"]
        found = {
            "name": "sag",
            "value": 1e-6,
            "unit": "1/V",
            "ci95": [0, 2e-6],
            "bic": 30,
            "numbers": {"sag_per_V": 1e-6},
        }
        frame = {"centre_rad": 0.0, "half_travel_rad": 0.6, "start_s": 10.0, "duration_s": 30.0}
        result.update(law=[found], with_law=leading, law_frame=frame)
        result["tracking"]["sampled-data"] |= {"true_rms_rad": 0.00123, "true_max_rad": 0.0045, "law": ["sag"]}

    edit(run / "result.json", with_law)
    page = page_of(run)
    assert any("sampled data with its laws" in text for text in texts)
    assert "The drive of the tracking check makes up for them." in page.words
    assert "true RMS error, mrad" in page.words and "the drive makes up for sag" in page.words
    assert 0.00123 in page.values and 0.0045 in page.values


@pytest.mark.usefixtures("figureless")
def test_a_run_in_which_no_law_was_found_has_none_and_ok_names_both_of_its_bounds(run: Path) -> None:
    """All records were fitted together, and the plain motor was enough for them."""
    (run / "samples.csv").unlink()

    def without(result: dict[str, Any]) -> None:
        leading = result["estimates"]["sampled-data"]
        whole = {"tau_s": 0.6, "K_rad_s_V": 0.7, "fc_V": 0.8}
        result.update(law=[], with_law=leading, law_records=[{"name": "relay-1", "duration_s": 9.0}])
        result.update(u95=whole, budget={"scatter": whole}, ok_asks_u95_percent=2.5)

    edit(run / "result.json", without)
    page = page_of(run)
    assert "The answer is the motor with these laws" not in page.words
    assert (
        "The verdict is ok if each is at most 2.5 %, and if no law that the tests leave open can move one by more than "
        "5 %; the chance that one still does is at most 1 %."
    ) in page.words


def test_headline_gives_the_values_with_interval_and_error_in_words(page: Page, complete: Path) -> None:
    assert "The motor is identified" in page.words
    assert "63 % of its final speed in 170 ms" in page.words
    assert "95 %: 0.1694 to 0.1714 (± 0.6 %)" in page.words
    assert "+0.25 % off the emulated motor's value" in page.words  # 0.17042 against 0.17
    assert f"For a controller: rig tune {complete}" in page.words
    assert "rig track" not in page.words, "it has tracked"


def test_reasons_and_what_was_not_run_are_said(page: Page) -> None:
    assert "triple relay is doubtful: the position extremum is located no better than 1.2 ms" in page.words
    assert "not run: its simulation on the best model leaves the soft limits (1.31 rad, limit 1.10 rad)" in page.words


def test_the_same_folder_gives_the_same_page(run: Path) -> None:
    """With the two figures that need no samples: the others are drawn alike."""
    (run / "samples.csv").unlink()
    before = write_report(run).read_bytes()
    assert len(Page(before.decode("utf-8")).images()) == 2
    assert write_report(run).read_bytes() == before


@pytest.mark.usefixtures("undrawn", "plain_motor")
@pytest.mark.parametrize("gone", SUBSETS, ids=lambda c: "+".join(c))
def test_any_subset_of_files_makes_a_page_that_says_what_is_missing(run: Path, gone: tuple[str, ...]) -> None:
    for name in gone:
        (run / name).unlink()
    page = page_of(run)
    for name in FILES:
        assert (f"{name} is missing" in page.words) == (name in gone)
    samples, result = "samples.csv" not in gone, "result.json" not in gone
    steps = result or "events.jsonl" not in gone  # of the gain search
    # whole run, breakaway, relays, portraits, residual, tracking, timing, two averaged cycles; estimates side by side
    # need a result, or samples that can be identified in its place; without laws there is no uncertainty budget
    assert len(page.images()) == 9 * samples + (result or samples) + steps
    assert ("For this page its recording was identified" in page.words) == (samples and not result)


@pytest.mark.usefixtures("undrawn", "plain_motor")
@pytest.mark.parametrize(
    ("rows", "drawn", "not_drawn"),
    [
        (3, "Position and drive over the whole run", ""),
        (800, "Gain search", ""),
        (2000, "Residual of the sampled data estimate", "No model was driven along the trajectory"),
        *evidence(
            (300, "Breakaway check", ""),
            (1130, "Residual of the sampled data estimate", "no two settled cycles"),
            (3500, "Tracking by feedback linearisation", "There was no relay test"),
        ),
    ],
)
def test_a_killed_run_shows_what_there_is(run: Path, rows: int, drawn: str, not_drawn: str) -> None:
    lines = (run / "samples.csv").read_text().splitlines(keepends=True)
    (run / "samples.csv").write_text("".join(lines[: rows + 1]) + lines[rows + 1][:11])
    (run / "result.json").unlink()
    page = page_of(run)
    assert f"line {rows + 2}, the last, is torn" in page.words
    if rows < 1000:
        assert "No result: the run ended before it had one" in page.words
        assert f"run the experiment again: rig run {run / 'config.yaml'}" in page.words
        assert "The limit cycle" not in page.words, "there was none yet"
    else:  # enough of what tells the motor is there: the page identifies it
        assert "For this page its recording was identified" in page.words
        assert "sampled data" in page.words
    assert drawn in page.words
    assert (not_drawn in page.words) == (rows < 3500)


@pytest.mark.parametrize(
    "content", ["tick,seq\n", "t_s,u_V,y_rad\n0,0,0\n0,0,0\n0,0,0\n", *evidence("", "not a table")]
)
def test_unusable_samples_are_said_with_their_cause(run: Path, content: str) -> None:
    (run / "samples.csv").write_text(content)
    page = page_of(run)
    assert "nothing that was measured can be shown" in page.words
    assert "There are no samples to draw" in page.words
    assert len(page.images()) == 2  # the estimates side by side, and the gain search from the events


@pytest.mark.usefixtures("figureless")
def test_broken_small_files_are_said(run: Path) -> None:
    (run / "samples.csv").unlink()
    (run / "result.json").write_text('{"schema": 1, "estim')
    (run / "meta.json").write_text("[1]")
    (run / "config.yaml").write_text("a: [")
    (run / "events.jsonl").write_text('{"t_s": 0.1, "kind": "stage"}\n{"t_s"')
    words = page_of(run).words
    assert "result.json (line 1) is broken JSON" in words
    assert "meta.json is no JSON object" in words
    assert "config.yaml:1:5: not valid YAML" in words
    assert "events.jsonl: line 2, the last, is torn and was left out" in words


@pytest.mark.usefixtures("figureless")
def test_a_fault_is_on_top_with_cause_and_cure(run: Path) -> None:
    fault = Fault("TRAVEL_HARD", "y = 1.92 rad, hard limit 1.90 rad")
    (run / "samples.csv").unlink()
    edit(run / "result.json", lambda r: r.update(faults=[fault.as_dict()]))
    with (run / "events.jsonl").open("a") as f:
        f.write(json.dumps({"t_s": 12.345, "kind": "fault", **fault.as_dict()}) + "\n")
    words = page_of(run).words
    assert words.count("Fault TRAVEL_HARD") == 1
    assert FAULTS["TRAVEL_HARD"].cause in words
    assert FAULTS["TRAVEL_HARD"].cure in words
    assert "y = 1.92 rad, hard limit 1.90 rad at 12.345 s" in words
    assert words.index("Fault TRAVEL_HARD") < words.index("The motor is identified, and the run ended with a fault")
    assert "Cure the fault above first." in words


@pytest.mark.usefixtures("figureless")
def test_a_refused_estimate_gives_no_recommendation(run: Path) -> None:
    def refuse(result: dict[str, Any]) -> None:
        result["estimates"]["sampled-data"].update(
            verdict="refused", reasons=["the residual is not white: record more"]
        )

    (run / "samples.csv").unlink()
    edit(run / "result.json", refuse)
    page = page_of(run)
    assert "No model: the estimate was refused" in page.words
    assert "the residual is not white: record more" in page.words
    assert "Do not use these values" in page.words
    assert "rig track" not in page.words


@pytest.mark.usefixtures("figureless")
def test_a_doubtful_estimate_says_why_and_what_to_do(run: Path) -> None:
    reasons = ["only 4 cycles: record ten", "f_c is uncertain by 20 %: raise h2"]
    (run / "samples.csv").unlink()
    edit(run / "result.json", lambda r: r["estimates"]["sampled-data"].update(verdict="doubtful", reasons=reasons))
    words = page_of(run).words
    assert "Identified, but doubtful" in words
    assert all(reason in words for reason in reasons)
    assert "Treat the values as a first guess" in words


@pytest.mark.evidence
def test_words_from_files_are_never_markup_or_mathematics(run: Path) -> None:
    nasty = '<script>alert("1")</script> $\\frac{1$ --> & ]]>'
    lines = (run / "samples.csv").read_text().splitlines(keepends=True)
    (run / "samples.csv").write_text("".join(lines[:800]))
    edit(run / "meta.json", lambda m: m.update(backend=nasty))
    edit(run / "result.json", lambda r: r.update(notes=[nasty], faults=[{"code": nasty, "t_s": 3.0}]))
    page = page_of(run)
    assert nasty in page.words
    assert "script" not in {tag for tag, _ in page.tags}
    assert all(nasty in str(image["alt"]) for image in page.images())


@pytest.mark.usefixtures("figureless")
def test_the_laws_of_the_motor_stand_beside_those_of_the_emulated_one(run: Path) -> None:
    (run / "samples.csv").unlink()
    found = [{"name": name, "value": 0.052, "unit": "V", "ci95": [0.048, 0.056]} for name in ("stribeck", "dead_band")]
    edit(run / "result.json", lambda r: r.update(law=found))
    table = page_of(run).words.split("The law of the motor")[1]
    assert "true" not in table.split("Stribeck effect")[0]  # a folder of an older version does not say
    true: list[dict[str, Any]] = [
        {"name": name, "value": 0.05125, "unit": "V", "numbers": {}} for name in ("stribeck", "lag")
    ]
    edit(run / "meta.json", lambda m: m["truth"].update(law=true))
    words = " ".join(page_of(run).words.split("The law of the motor")[1].split())
    assert "Stribeck effect 0.0520 V 95 %: 0.0480 to 0.0560 0.0512 V a bearing" in words
    assert "dead band of the drive 0.0520 V 95 %: 0.0480 to 0.0560 none a bridge" in words
    missed = words[words.index("lag of the drive not found 0.0512 V") :]
    assert "an inductance" not in missed and "or, as likely" not in words
    assert tables.AT_REST not in words
    edit(run / "meta.json", lambda m: m["truth"]["law"].append(true[0] | {"name": "static"}))
    assert tables.AT_REST in page_of(run).words  # the headline has breakaway levels


@pytest.mark.usefixtures("figureless")
def test_the_notes_of_rig_check_stand_above_the_result(run: Path) -> None:
    (run / "samples.csv").unlink()
    note = "the emulated bridge gives 8 V, by the config it gives <12> V: K and f_c will come out scaled"
    edit(run / "result.json", lambda r: r.update(config_notes=[note]))
    words = page_of(run).words
    assert words.index("Notes of rig check on this config") < words.index(note[1:]) < words.index("The motor is")


@pytest.mark.usefixtures("figureless")
@pytest.mark.parametrize("ended", [{}, {"faults": [Fault("POLARITY").as_dict()]}])
def test_notes_on_the_loops_timing_are_the_cause_of_nothing(run: Path, ended: dict[str, Any]) -> None:
    """A jog and a run that ended with a fault have no estimate, but not because of their clock."""
    (run / "samples.csv").unlink()
    (run / "events.jsonl").unlink()
    timing = "the machine does not grant SCHED_FIFO: ticks come late"
    result = {"schema": 1, "backend": BACKEND, "estimates": {}, "notes": [timing], "faults": []} | ended
    (run / "result.json").write_text(json.dumps(result))
    edit(run / "meta.json", lambda m: m.update(script={"name": "jog", "u_V": 0.8}))
    words = page_of(run).words
    assert "The shaft was jogged" in words
    assert "Why" not in words
    assert words.index(timing) > words.index("About this run")


@pytest.mark.usefixtures("figureless")
def test_why_there_is_no_estimate_is_said_where_it_is_known(run: Path) -> None:
    (run / "samples.csv").unlink()
    result = {"estimates": {}, "notes": ["ticks come late", "nothing to identify: 2 full cycles are too few"]}
    (run / "result.json").write_text(json.dumps(result))
    words = page_of(run).words
    assert "Why, and what to record instead: nothing to identify: 2 full cycles are too few What to do" in words


@pytest.mark.usefixtures("figureless")
def test_a_tracking_run_says_whose_models_it_drove_with(run: Path) -> None:
    (run / "samples.csv").unlink()
    edit(run / "result.json", lambda r: r.update(models_from="runs/earlier", relays=[]))
    page = page_of(run)
    assert "Driven with the models of another run" in page.words
    assert "What is shown here was identified in runs/earlier." in page.words
    assert "rig track" not in page.words


@pytest.mark.usefixtures("figureless")
def test_what_is_known_about_a_run_is_in_words(run: Path) -> None:
    (run / "samples.csv").unlink()
    odd = {"emulated": True, "drive_units": None, "host": {"cores": [0, 1], "real_time": False}, "period_s": 0.1 + 0.2}
    edit(run / "meta.json", lambda m: m.update(odd))
    words = page_of(run).words
    about = words[words.index("About this run", words.index("Timing of the loop")) :]
    for shown in ("emulated yes", "drive units –", "host cores: 0; 1, real time: no", "period s 0.3 "):
        assert shown in about
    for literal in ("True", "False", "None", "{", "[", "'"):
        assert literal not in about[: about.index("config.yaml, resolved")]


def test_every_cell_carries_its_heading_for_a_narrow_screen(page: Page) -> None:
    """There tables are taken apart, row by row, and no heading stands above a value."""
    cells = [attrs for tag, attrs in page.tags if tag == "td"]
    data = sum(tag == "data" for tag, _ in page.tags)
    assert sum("data-is" in attrs for attrs in cells) >= data - 3 > 30  # three values are in the headline
    assert {str(attrs.get("data-is")) for attrs in cells} >= {"K, (rad/s)/V", "period, s", "RMS error, mrad", "ticks"}


def test_light_and_dark_name_the_same_colours_and_no_rule_names_another(complete: Path) -> None:
    text = (complete / "report.html").read_text()
    rules = text[text.index("<style>") : text.index("</style>")]
    light, dark = (
        dict(re.findall(r"--([a-z-]+): (#\w+)", block)) for block in re.findall(r":root \{(.*?)\}", rules, re.S)
    )
    assert light.keys() == dark.keys()
    named = set(re.findall(r"#[0-9a-f]{3,6}\b", re.sub(r":root \{.*?\}", "", rules, flags=re.S)))
    assert named == {"#0072b2", "#d55e00", "#009e73", "#cc79a7"}  # the swatches, turned round like the figures
    assert set(re.findall(r"var\(--([a-z-]+)\)", rules)) - {"tone", "wash"} <= light.keys()

    def contrast(colours: dict[str, str], ink: str, ground: str) -> float:
        a, b = sorted(luminance(colours[name]) for name in (ink, ground))
        return (b + 0.05) / (a + 0.05)

    tones = [(tone, f"{tone}-wash") for tone in ("ok", "doubt", "bad", "none")]
    texts = [(ink, ground) for ink in ("ink", "muted", "link") for ground in ("paper", "panel")]
    for colours in (light, dark):
        for ink, ground in tones + texts:
            assert contrast(colours, ink, ground) >= 4.5, (ink, ground)


def luminance(colour: str) -> float:
    """Relative luminance of sRGB, WCAG 2.1."""
    full = colour[1:] if len(colour) == 7 else "".join(2 * c for c in colour[1:])
    parts = [int(full[k : k + 2], 16) / 255 for k in (0, 2, 4)]
    linear = [c / 12.92 if c <= 0.04045 else ((c + 0.055) / 1.055) ** 2.4 for c in parts]
    return float(0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2])


def test_no_tick_labels_overlap(drawn: tuple[Page, list[list[str]]]) -> None:
    _, touching = drawn
    assert len(touching) == 11
    assert [texts for texts in touching if texts] == []


@pytest.mark.parametrize("scale", [1e-4, 12345.678])
def test_estimates_side_by_side_have_no_tick_labels_that_overlap_at_any_size_of_their_values(
    complete: Path, monkeypatch: pytest.MonkeyPatch, scale: float
) -> None:
    """All methods alike: ticks of many digits."""
    seen: list[list[str]] = []
    original = Figure.savefig

    def look(figure: Figure, *arguments: Any, **options: Any) -> None:
        original(figure, *arguments, **options)
        seen.append(overlaps(figure))

    monkeypatch.setattr(Figure, "savefig", look)
    run = load(complete)
    estimates = {}
    for method, estimate in run.result.estimates.items():
        changed: dict[str, Any] = {
            key: value * scale for key in ("tau_s", "K_rad_s_V", "fc_V") if (value := estimate.value(key)) is not None
        }
        assert len(changed) == 3
        around = {key: (value * (1.0 - 1e-3), value * (1.0 + 1e-3)) for key, value in changed.items()}
        changed["ci95"] = (estimate.ci95 or {}) | around
        estimates[method] = estimate.model_copy(update=changed)
    with style():
        fitted.forest(replace(run, result=run.result.model_copy(update={"estimates": estimates})))
    assert seen == [[]]


def overlaps(figure: Figure) -> list[str]:
    """Neighbouring tick labels of one axis that touch."""
    renderer = figure._get_renderer()  # type: ignore[attr-defined]  # no public method gives it
    found = []
    for axes in figure.axes:
        for axis in (axes.xaxis, axes.yaxis):
            labels = [label for label in axis.get_ticklabels() if label.get_visible() and label.get_text()]
            boxes = [label.get_window_extent(renderer) for label in labels]
            inside = [(box, label) for box, label in zip(boxes, labels, strict=True) if _shown(axis, label)]
            found += [f"{a[1].get_text()} | {b[1].get_text()}" for a, b in pairwise(inside) if a[0].overlaps(b[0])]
    return found


def _shown(axis: Any, label: Any) -> bool:
    low, high = sorted(axis.get_view_interval())
    at = label.get_position()[0 if axis.axis_name == "x" else 1]
    return bool(low <= at <= high)


@pytest.mark.usefixtures("undrawn")
def test_virtual_time_has_no_timing_figure(run: Path) -> None:
    lines = (run / "samples.csv").read_text().splitlines(keepends=True)
    (run / "samples.csv").write_text("".join(lines[:200]))
    edit(run / "meta.json", lambda m: m.update(backend="simulated (virtual time)"))
    page = page_of(run)
    assert "simulated in virtual time: its clock waits for the computation" in page.words
    assert "Timing of the loop, counts" not in page.words


def test_a_full_disk_leaves_the_old_page_whole(
    run: Path, monkeypatch: pytest.MonkeyPatch, largest_file: Callable[[int], AbstractContextManager[None]]
) -> None:
    (run / "report.html").write_text("the old page")
    there = sorted(path.name for path in run.iterdir())
    monkeypatch.setattr("rig.output.report.page.render_page", lambda *_: "a new page " * 1000)
    with largest_file(5000):
        result = CliRunner().invoke(main, ["report", str(run)])
    assert result.exit_code == 1
    assert result.stderr.splitlines() == [
        f"rig: {run / 'report.html'}: cannot be written: File too large",
        "     check the disk's free space and the permissions of the folder",
    ]
    assert (run / "report.html").read_text() == "the old page"
    assert sorted(path.name for path in run.iterdir()) == there


def test_a_folder_that_is_none_is_an_error(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError, match="is not a run folder"):
        write_report(tmp_path / "nowhere")


ANY_JSON = st.recursive(
    st.none() | st.booleans() | st.floats() | st.integers() | st.text(max_size=8),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=5), inner, max_size=3),
    max_leaves=6,
)
NUMBER = st.floats() | st.none() | ANY_JSON
ESTIMATE = st.dictionaries(
    st.sampled_from(
        ["tau_s", "K_rad_s_V", "fc_V", "asym_V", "delay_s", "ci95", "rms_rad", "verdict", "reasons", "rows"]
    ),
    NUMBER | st.dictionaries(st.sampled_from(["tau_s", "K_rad_s_V", "fc_V"]), st.lists(NUMBER, max_size=3)),
)
RESULT = st.fixed_dictionaries(
    {},
    optional={
        "backend": ANY_JSON,
        "estimates": ANY_JSON | st.dictionaries(st.sampled_from(["sampled-data", "triple-relay", "own"]), ESTIMATE),
        "relays": ANY_JSON,
        "tracking": ANY_JSON | st.dictionaries(st.text(max_size=5), ANY_JSON),
        "loop": ANY_JSON,
        "faults": ANY_JSON,
        "notes": ANY_JSON,
        "breakaway": ANY_JSON,
        "search": ANY_JSON,
    },
)


@pytest.mark.usefixtures("undrawn")
@given(result=RESULT, meta=st.dictionaries(st.sampled_from(["backend", "truth", "versions", "period_s"]), ANY_JSON))
@settings(
    max_examples=examples(60),
    deadline=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow],
)
def test_no_result_however_odd_keeps_the_page_from_being_made(
    tmp_path: Path, result: dict[str, Any], meta: dict[str, Any]
) -> None:
    (tmp_path / "result.json").write_text(json.dumps(result))
    (tmp_path / "meta.json").write_text(json.dumps(meta))
    page = Page(render_page(load(tmp_path)))
    assert "samples.csv is missing" in page.words
    assert not any(math.isnan(value) for value in page.values)


def test_a_delay_that_the_times_of_the_recording_say_has_no_interval() -> None:
    delay = next(parameter for parameter in PARAMETERS if parameter.key == "delay_s")
    shown = {
        half_s: quantity(delay, EstimateResult(delay_s=0.004, ci95={"delay_s": (0.004 - half_s, 0.004 + half_s)}), {})
        for half_s in (1e-11, 1e-5)
    }
    assert (shown[1e-11].text, shown[1e-11].plus_minus) == ("4.000", "")
    assert (shown[1e-5].text, shown[1e-5].plus_minus) == ("4.0000", "± 0.0100")
