"""Broken configs give one clear line with file, line, column and key; nothing but ConfigError ever comes out."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest
import yaml
from evidence import examples
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from rig.config import ConfigError, Experiment, dump, load
from rig.config.problems import Problem
from rig.config.units import converted, stem_of, unit_of
from rig.config.yaml12 import emit, parse
from rig.run_folder.results import JsonObject
from rig.running.preflight import check

CONFIGS = Path(__file__).parents[2] / "config"
DEMO = (CONFIGS / "demo.yaml").read_text(encoding="utf-8")
RELAY = DEMO[DEMO.index("  target:") : DEMO.index("\ntracking:")]
TARGET = RELAY[: RELAY.index("\n") + 1]


def changed(old: str, new: str, text: str = DEMO) -> str:
    """The demo with one mutation; ``old`` must stand in it."""
    assert text.count(old) >= 1, old
    return text.replace(old, new, 1)


def problems_of(text: str | bytes, folder: Path) -> tuple[Problem, ...]:
    path = folder / "broken.yaml"
    path.write_bytes(text if isinstance(text, bytes) else text.encode("utf-8"))
    with pytest.raises(ConfigError) as caught:
        check(path)
    assert str(caught.value) == "\n".join(str(problem) for problem in caught.value.problems)
    return caught.value.problems


# what is replaced in the demo, by what; where the problem is (a text in that line, from which on); its key; words of
# its message; words of its hint
BROKEN = {
    "unknown key": ("cycles: 10", "cyles: 12", "cyles", "relay.cyles", "unknown key", "did you mean 'cycles'?"),
    "unknown key, nothing like it": ("cycles: 10", "qqq: 12", "qqq", "relay.qqq", "unknown key", "known here: until"),
    "unit in the key": (
        "period_s: 0.010", "period_ms: 10", "period_ms", "period_ms", "unknown key",
        "did you mean 'period_s'? (seconds, 10 ms is 0.01)",
    ),
    "no unit in the key": (
        "supply_V: 12.0", "supply: 12.0", "supply", "drive.supply", "unknown key", "did you mean 'supply_V'? (volts)"
    ),
    "degrees": (
        "amplitude_rad: 0.6, ", "amplitude_deg: 30, ", "amplitude_deg", "relay.target.amplitude_deg", "unknown key",
        "did you mean 'amplitude_rad'? (rad, 30 deg is 0.523599)",
    ),
    "key of another section": (
        "name: demo", "name: demo\nwatchdog_s: 0.1", "watchdog_s", "watchdog_s", "unknown key",
        "did you mean 'daq.watchdog_s'?",
    ),
    "unknown key in a list": (
        "{counts: 24, rad: -2.0015625}", "{counts: 24, rad: -2.0015625, volt: 1}", "volt", "sensor.calibration[0].volt",
        "unknown key", "known here: counts, rad",
    ),
    "missing key": (
        "  supply_V: 12.0\n", "", "drive:", "drive.supply_V", "required key is missing", "motor supply",
    ),
    "missing section": (
        re.findall(r"limits:\n(?:  .*\n)+", DEMO)[0], "", "# yaml", "limits", "required key is missing",
        "where the shaft may be",
    ),
    "text for a number": (
        "supply_V: 12.0", "supply_V: twelve", "twelve", "drive.supply_V",
        'must be a number in volts, got the text "twelve"',
        "",
    ),
    "value with its unit": (
        "period_s: 0.010", "period_s: 10 ms", "10 ms", "period_s", "must be a number in seconds",
        "write the number alone; it is in seconds",
    ),
    "quoted number": (
        "supply_V: 12.0", "supply_V: '12.0'", "'12.0'", "drive.supply_V", "number", "leave out the quotes"
    ),
    "decimal comma": ("supply_V: 12.0", "supply_V: 12,0", "12,0", "drive.supply_V", "number", "decimal point"),
    "infinity": ("supply_V: 12.0", "supply_V: .inf", ".inf", "drive.supply_V", "must be a finite number, not .inf", ""),
    "not a number": ("rad: -2.0015625", "rad: .nan", ".nan", "sensor.calibration[0].rad", "finite number", ""),
    "overflow": ("supply_V: 12.0", "supply_V: 1e999", "1e999", "drive.supply_V", "too large", ""),
    "many digits": ("seed: 1", "seed: " + "9" * 5000, "999", "seed", "a number of 5000 characters", ""),
    "true for a number": (
        "supply_V: 12.0", "supply_V: true", "true", "drive.supply_V", "number in volts, got true", ""
    ),
    "fraction for a count": (
        "cycles: 10", "cycles: 12.5", "12.5", "relay.cycles", "must be a whole number, got 12.5", ""
    ),
    "yes is text": (
        "baud: 115200", "baud: 115200\n  accept_no_watchdog: yes", "yes", "daq.accept_no_watchdog",
        'must be true or false, got the text "yes"', "write true or false",
    ),
    "negative": (
        "supply_V: 12.0", "supply_V: -12", "-12", "drive.supply_V", "must be greater than 0 volts, got -12", ""
    ),
    "out of range": ("period_s: 0.010", "period_s: 10", "10", "period_s", "must be at most 0.1 seconds, got 10", ""),
    "misspelt choice": (
        "cycles: 10", "cycles: 12\n  where: devise", "devise", "relay.where", "must be one of host, device",
        "did you mean 'device'?",
    ),
    "a bridge as it is sold": (
        "supply_V: 12.0", "bridge: TB6612\n  supply_V: 12.0", "TB6612", "drive.bridge", "must be one of pwm-dir",
        "write in1-in2, the inputs of TB6612FNG",
    ),
    "a bridge that nothing brakes": (
        "supply_V: 12.0", "bridge: l298-ena\n  supply_V: 12.0", "l298-ena", "drive.bridge", "must be one of pwm-dir",
        "put the jumper back on ENA",
    ),
    "driver with capitals": (
        "driver: serial", "driver: Serial", "Serial", "daq.driver", "must be made of lower-case letters", ""
    ),
    "name": ("name: demo", "name: My Run", "My Run", "name", "must be made of lower-case letters", ""),
    "number for a name": ("name: demo", "name: 12", "12", "name", "must be text, got 12", "put it in quotes"),
    "empty section": (
        "breakaway:\n  ramp_V_s: 0.4\n  max_V: 1.2\n", "breakaway:\n", "breakaway:", "breakaway", "a section with keys",
        "its keys: ramp_V_s",
    ),
    "pair of one": (
        "soft_rad: [-1.1, 1.1]", "soft_rad: [-1.1]", "[-1.1]", "limits.soft_rad", "must be two values, [low, high]", ""
    ),
    "pair of three": (
        "soft_rad: [-1.1, 1.1]", "soft_rad: [-1.1, 0, 1.1]", "[-1.1, 0", "limits.soft_rad", "at most 2", ""
    ),
    "pair upside down": (
        "soft_rad: [-1.1, 1.1]", "soft_rad: [1.1, -1.1]", "[1.1", "limits.soft_rad",
        "must be [low, high] with low < high, not [1.1, -1.1]", "",
    ),
    "wrong element": (
        "soft_rad: [-1.1, 1.1]", "soft_rad: [-1.1, x]", "x]", "limits.soft_rad[1]", "must be a number in rad", ""
    ),
    "number for a pair": (
        "soft_rad: [-1.1, 1.1]", "soft_rad: 1.1", "1.1", "limits.soft_rad", "must be a list", "[a, b]"
    ),
    "one calibration point": (
        "    - {counts: 1000, rad: 2.0015625}\n", "", "- {counts: 24", "sensor.calibration", "at least 2 items", ""
    ),
    "equal calibration points": (
        "counts: 1000,", "counts: 24,", "- {counts: 24, rad: -2", "sensor.calibration", "24 counts is given twice", ""
    ),
    "calibration beyond the ADC": (
        "counts: 1000,", "counts: 1024,", "- {counts: 24", "sensor.calibration", "more than sensor.counts_max", ""
    ),
    "rails upside down": ("[5, 1018]", "[1018, 5]", "[1018", "sensor.rail_counts", "0 <= low < high <= 1023", ""),
    "until and a target": (
        "cycles: 10", "until: {}", "target", "relay", "`until` chooses its tests by itself: remove `target`", ""
    ),
    "an interval below what a run can tell": (
        RELAY, "  until: {interval_percent: 0.01}\n",
        "0.01", "relay.until.interval_percent", "must be at least 0.1", "",
    ),
    "neither target nor gains": (
        TARGET, "", "cycles: 10", "relay", "give `until` (the tests", ""
    ),
    "key twice": (
        "supply_V: 12.0", "supply_V: 12.0\n  supply_V: 24.0", "supply_V: 24.0", "drive.supply_V",
        "given twice: first in line", "keep one",
    ),
    "number as key": ("cycles: 10", "12: 12", "12: 12", "relay", "a key must be a name, not 12", ""),
    "list as key": ("cycles: 10", "? [a]\n  : 12", "[a]", "relay", "a key must be a name, not a list", ""),
    "tab": ("  ramp_V_s: 0.4", "\tramp_V_s: 0.4", "\tramp", "", "a tab where spaces must be", "indent with spaces"),
    "bracket not closed": (
        "soft_rad: [-1.1, 1.1]", "soft_rad: [-1.1, 1.1", "[-1.1, 1.1", "", "not valid YAML", "is not closed"
    ),
    "no space after the colon": ("seed: 1", "seed:1", "seed:1", "", "not valid YAML", "a space after"),
    "second document": (
        "relay:\n", "---\nrelay:\n", "---", "", "a second document begins here", "one experiment a file"
    ),
    "anchor": ("[-1.1, 1.1]", "&soft [-1.1, 1.1]", "&soft", "", "anchors and aliases are not supported", ""),
    "alias": ("[-1.1, 1.1]", "*soft", "*soft", "", "anchors and aliases are not supported", ""),
    "merge key": (
        "cycles: 10", "<<: {cycles: 12}", "<<", "relay.<<", "unknown key", "known here"
    ),
    "tag": (
        "seed: 1", "seed: !!python/object/apply:os.getcwd []", "!!python", "", "tags (`!...`) are not supported", ""
    ),
    "cogging without its order": (
        "bias_V: 0.01", "bias_V: 0.01\n    parts: {cogging_cos_V: 0.05}", "{cogging", "emulated.motor.parts",
        "do nothing without cogging_per_rad", "",
    ),
    "free between pulses without full drive": (
        "bias_V: 0.01", "bias_V: 0.01\n    parts: {free_between: 0.8}", "{free", "emulated.motor.parts",
        "does nothing without full_drive_V", "",
    ),
    "control character": ("name: demo", "name: de\x07mo", "\x07mo", "", "control character U+0007", "delete it"),
    "half a character": ("name: demo", 'name: "de\\ud800mo"', '"de', "name", "half of a surrogate pair", ""),
}  # fmt: skip


@pytest.mark.parametrize("case", BROKEN)
def test_one_mistake_gives_one_line_with_place_key_and_hint(case: str, tmp_path: Path) -> None:
    old, new, where, key, message, hint = BROKEN[case]
    text = changed(old, new)
    problems = problems_of(text, tmp_path)
    assert len(problems) == 1, problems
    problem = problems[0]
    start = text.index(new) if new and where in text[text.index(new) :] and where in new else 0
    at = text.index(where, start)
    line = text.count("\n", 0, at) + 1
    column = at - (text.rfind("\n", 0, at) + 1) + 1
    if case in ("empty section", "missing key"):  # the section's own line
        assert text.splitlines()[problem.line - 1].startswith(where)
    else:
        assert (problem.line, problem.column) == (line, column), str(problem)
    assert problem.key == key
    assert message in problem.message
    assert hint in problem.hint
    printed = str(problem)
    assert printed.startswith(f"{tmp_path / 'broken.yaml'}:{problem.line}:{problem.column}: {key}")
    assert printed.isprintable()
    assert len(printed) < 600


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"", "the file is empty"),
        (b"# only a comment\n", "the file is empty"),
        (b"- 1\n- 2\n", "must hold keys with values, not a list"),
        (b"42\n", "must hold keys with values, not a single value"),
        (b"name: caf\xe9\n", "not UTF-8: byte 0xE9"),
        ("name: demo\n".encode("utf-16"), "not UTF-8"),
        (b'name: "\\Uffffffff"\n', "not valid YAML"),
        (b"name: 'demo\n", "not valid YAML"),
        (b"\x00\x01", "control character U+0000"),
    ],
)
def test_what_is_no_config_at_all(content: bytes, message: str, tmp_path: Path) -> None:
    (problem,) = problems_of(content, tmp_path)
    assert message in problem.message
    assert problem.line >= 1
    assert problem.key == ""


def test_deep_nesting_is_refused_at_its_place(tmp_path: Path) -> None:
    (problem,) = problems_of("name: " + "[" * 5000 + "]" * 5000, tmp_path)
    assert "nested more than 20 levels deep" in problem.message
    assert (problem.line, problem.column) == (1, len("name: ") + 20)


def test_files_that_cannot_be_read(tmp_path: Path) -> None:
    for path, message in (
        (tmp_path / "none.yaml", "none.yaml: no such file; `rig init"),
        (tmp_path, "is a folder, not a file"),
        (Path("a\x00b"), "cannot be read"),
        (tmp_path / "x" / ".." / ("n" * 5000), "cannot be read"),
    ):
        with pytest.raises(ConfigError, match=message):
            load(path)


def test_every_problem_is_told_at_once_in_the_order_of_the_file(tmp_path: Path) -> None:
    text = changed("seed: 1", "sead: 1", changed("cycles: 10", "cycles: 0", changed("max_V: 3.0", "max_V: x")))
    keys = [problem.key for problem in problems_of(text, tmp_path)]
    assert keys == ["sead", "drive.max_V", "relay.cycles"]


def test_a_mistyped_required_key_is_told_once(tmp_path: Path) -> None:
    (problem,) = problems_of(changed("supply_V: 12.0", "suply_V: 12.0"), tmp_path)
    assert problem.key == "drive.suply_V"
    assert problem.hint == "did you mean 'supply_V'?"


def test_the_example_line_of_the_docs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    Path("x.yaml").write_text(changed("cycles: 10", "cyles: 12"), encoding="utf-8")
    line = DEMO[: DEMO.index("cycles: 10")].count("\n") + 1
    with pytest.raises(ConfigError) as caught:
        load("x.yaml")
    assert str(caught.value) == f"x.yaml:{line}:3: relay.cyles: unknown key; did you mean 'cycles'?"


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("1e-3", 1e-3),
        ("1E3", 1e3),
        ("+.5", 0.5),
        ("1.", 1.0),
        ("010", 10),
        ("0o10", 8),
        ("0x1F", 31),
        ("-7", -7),
        ("on", "on"),
        ("yes", "yes"),
        ("No", "No"),
        ("y", "y"),
        ("true", True),
        ("False", False),
        ("null", None),
        ("~", None),
        ("", None),
        ("1_000", "1_000"),
        ("12:30", "12:30"),
        ("2026-01-01", "2026-01-01"),
        ("0b11", "0b11"),
        ("'1'", "1"),
        ("=", "="),
        ("1e", "1e"),
        (".", "."),
    ],
)
def test_scalars_are_those_of_yaml_1_2(text: str, value: object) -> None:
    read = parse(f"key: {text}\n", "f").data["key"]
    assert read == value
    assert type(read) is type(value)


def test_byte_order_mark_and_windows_line_ends_are_read(tmp_path: Path) -> None:
    path = tmp_path / "windows.yaml"
    path.write_bytes(b"\xef\xbb\xbf" + DEMO.replace("\n", "\r\n").encode())
    (tmp_path / "unix.yaml").write_text(DEMO, encoding="utf-8")
    assert load(path) == load(tmp_path / "unix.yaml")


@pytest.mark.parametrize("name", ["demo", "simulated", "uno"])
def test_dump_reads_back_equal_and_is_complete(name: str, tmp_path: Path) -> None:
    experiment = load(CONFIGS / f"{name}.yaml")
    path = tmp_path / "resolved.yaml"
    path.write_text(dump(experiment), encoding="utf-8")
    assert load(path) == experiment
    assert "timeout_s" in path.read_text(encoding="utf-8")  # a default, written out


@pytest.mark.parametrize("name", ["1e3", "0o17", "123", "010", "null", "true", "on", "1-2", "0x1f"])
def test_dump_quotes_names_that_look_like_something_else(name: str, tmp_path: Path) -> None:
    experiment = load(CONFIGS / "demo.yaml").model_copy(update={"name": name})
    path = tmp_path / "resolved.yaml"
    path.write_text(dump(experiment), encoding="utf-8")
    assert load(path) == experiment


TEXT = st.text(st.characters(exclude_categories=["Cs"]), max_size=20)
PLAIN = st.recursive(
    st.none()
    | st.booleans()
    | st.integers(-(10**30), 10**30)
    | st.floats(allow_nan=False, allow_infinity=False)
    | TEXT,
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(TEXT, inner, max_size=3),
    max_leaves=8,
)


@settings(max_examples=examples(200), deadline=None)
@given(st.dictionaries(TEXT, PLAIN, min_size=1, max_size=4))
def test_what_is_emitted_is_parsed_back_equal(data: JsonObject) -> None:
    assert parse(emit(data), "f").data == data


def only_config_error(raw: bytes, path: Path) -> None:
    """Load bytes: an experiment, or ConfigError whose lines print."""
    path.write_bytes(raw)
    try:
        experiment = load(path)
    except ConfigError as error:
        assert error.problems
        for line, problem in zip(str(error).split("\n"), error.problems, strict=True):
            assert line == str(problem)
            assert problem.line >= 1
            line.encode("utf-8")
    else:
        assert isinstance(experiment, Experiment)


any_file = settings(
    max_examples=examples(150),
    deadline=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow],
)
YAML_LIKE = st.text(
    st.sampled_from("abc01e.-+_:,[]{}#&*!|>'\"%@`?~<= \t\n\r\\xuU\u2028\ud7ff\ufeff\x85\x00"), max_size=60
)


@any_file
@given(st.binary(max_size=80))
def test_any_bytes_give_config_error_and_nothing_else(tmp_path: Path, raw: bytes) -> None:
    only_config_error(raw, tmp_path / "f.yaml")


@any_file
@given(YAML_LIKE)
def test_any_text_gives_config_error_and_nothing_else(tmp_path: Path, text: str) -> None:
    only_config_error(text.encode("utf-8"), tmp_path / "f.yaml")


@any_file
@given(st.integers(0, len(DEMO)), st.integers(0, 12), YAML_LIKE)
def test_a_damaged_demo_gives_config_error_and_nothing_else(tmp_path: Path, at: int, cut: int, text: str) -> None:
    only_config_error((DEMO[:at] + text + DEMO[at + cut :]).encode("utf-8"), tmp_path / "f.yaml")


def paths_of(data: object, above: tuple[str | int, ...] = ()) -> list[tuple[str | int, ...]]:
    items = data.items() if isinstance(data, dict) else enumerate(data) if isinstance(data, list) else ()
    return [path for key, inner in items for path in ((*above, key), *paths_of(inner, (*above, key)))]


PATHS = paths_of(parse(DEMO, "demo").data)


@any_file
@given(st.sampled_from(PATHS), PLAIN)
def test_any_value_at_any_key_gives_config_error_and_nothing_else(
    tmp_path: Path, path: tuple[str | int, ...], value: object
) -> None:
    data = parse(DEMO, "demo").data
    inner: Any = data  # a mapping, or a list in one
    for part in path[:-1]:
        inner = inner[part]
    inner[path[-1]] = value
    only_config_error(emit(data).encode("utf-8"), tmp_path / "f.yaml")


def test_units_are_read_from_keys() -> None:
    assert unit_of("period_s") == "seconds"
    assert unit_of("K_rad_s_V") == "(rad/s)/V"
    assert unit_of("k2_1_s2") == "1/s^2"
    assert unit_of("cycles") == ""
    assert stem_of("period_ms") == stem_of("period_s") == stem_of("period") == "period"
    assert stem_of("max_speed_rpm") == stem_of("max_speed_rad_s")
    assert converted(250, "watchdog_ms", "watchdog_s") == "250 ms is 0.25"
    assert converted("x", "watchdog_ms", "watchdog_s") == ""
    assert converted(3, "period_hz", "period_s") == ""


def test_pyyaml_alone_would_read_it_otherwise() -> None:
    """Why there is a loader of our own."""
    assert yaml.safe_load("a: 1e-3\nb: on\nc: 010\nd: 1\nd: 2\n") == {"a": "1e-3", "b": True, "c": 8, "d": 2}
