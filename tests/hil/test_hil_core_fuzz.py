"""The firmware's core under any bytes, ticks, readings and contacts; and that the harness notices broken promises."""

from __future__ import annotations

import os
import re
import subprocess
from pathlib import Path

import pytest
from evidence import first_of_each
from firmware_copy import copied_firmware

import fuzz_corpus
from rig.backends.serial.emulated.firmware_build import source_folder

pytestmark = pytest.mark.long

# What the device promises (rig_core.h), each taken out of the source at one place: file, text, and what stands there
# instead.
DEFECTS = {
    "CRC not looked at": ("frames.c", "sent == frame_crc16(bytes, content) ? content : 0u", "content"),
    "too long a frame taken": ("frames.c", "rx->overflow ? 0u : check(", "check("),
    "code that points past the end": ("frames.c", "code - 1u > (uint8_t)(n - in)", "false"),
    "P1 armed without set-up": ("rig_core.c", "if (!core->has_setup)", "if (false)"),
    "P1 drives without being armed": ("rig_core.c", "core->fault = RIG_E_NOT_ARMED;", "act(core, units);"),
    "P2 any negative drive": ("rig_core.c", "units > most || units < -most", "units > most"),
    "P2 any drive of the relay": ("rig_core.c", "is_too_much(core, wanted->drive[i])", "false"),
    "P2 any drive of a stroke": ("rig_core.c", "is_too_much(core, one->drive)", "false"),
    "P3 no watchdog": ("rig_core.c", "latch(core, RIG_E_WATCHDOG);", ""),
    "P3 counts from when the core looks": (
        "rig_core.c",
        "? board->arrived_us(board->context)",
        "? board->micros(board->context)",
    ),
    "P3 kept up by READ": ("rig_core.c", "if (core->drive == 0 && !core->running)", "if (true)"),
    "P4 no limits": (
        "rig_core.c",
        "    if (side(core) != 0) {\n        const bool",
        "    if (false) {\n        const bool",
    ),
    "P5 no upper rail": ("rig_core.c", "core->counts >= core->setup.rail_hi", "false"),
    "P6 outward drive": ("rig_core.c", "raises == is_above", "false"),
    "P6 outward under inward drive": ("rig_core.c", "if (moves_outward(core))", "if (false)"),
    "P7 a fault leaves it armed": (
        "rig_core.c",
        "    if (core->armed) {\n        disarm(core);",
        "    if (core->armed) {\n        act(core, 0);",
    ),
    "P7 ARM clears": (
        "rig_core.c",
        "    if (core->latched != 0u) {\n        return core->fault;",
        "    if (false) {\n        return core->fault;",
    ),
    "P7 ACK clears all": ("rig_core.c", "core->latched &= ~bit_of(code);", "core->latched = 0;"),
    "P7 ACK while the cause lasts": (
        "rig_core.c",
        "    if (is_in_the_way(core, code)) {\n        refuse",
        "    if (false) {\n        refuse",
    ),
    "P9 no e-stop": ("rig_core.c", "is_set(core, RIG_INPUT_ESTOP)", "false"),
    "P10 nothing latches while disarmed": (
        "rig_core.c",
        "if (is_in_the_way(core, ALWAYS[i]))",
        "if (core->armed && is_in_the_way(core, ALWAYS[i]))",
    ),
    "P10 no rail while disarmed": ("rig_core.c", "core->has_setup && at_rail(core)", "core->armed && at_rail(core)"),
    "P10 no end switches while disarmed": ("rig_core.c", "core->has_setup && is_high", "core->armed && is_high"),
    "P10 no reset": ("rig_core.c", "latch(core, RIG_E_RESET); /* P10 */", ""),
    "P10 STOP looks and forgets": (
        "rig_core.c",
        "    disarm(core);\n    sense(core);\n    head",
        "    disarm(core);\n    read_sensors(core);\n    head",
    ),
    "P11 any session": ("rig_core.c", "if (session != core->setup.session)", "if (false)"),
    "P11 a session of 0": ("rig_core.c", "setup->session != 0u &&", ""),
    "P11 a state without session": (
        "rig_core.c",
        "    put_u32(out, core->setup.session);\n}",
        "    put_u32(out, 0);\n}",
    ),
    "P11 a block without session": ("rig_core.c", "now->session = core->setup.session;", ""),
    "P9 swapped end switches": ("rig_core.c", "is_high(core) && is_low(core)", "false"),
    "limits changed under drive": ("rig_core.c", "core->armed || !is_valid", "!is_valid"),
    "STOP leaves it armed": (
        "rig_core.c",
        "    disarm(core);\n    sense(core);\n    head",
        "    sense(core);\n    head",
    ),
    "a request that the tick may interrupt": ("rig_core.c", "        hold(core);\n        act_on(", "        act_on("),
    "a block given free behind the tick's back": (
        "rig_core.c",
        "    hold(core);\n    blocks_sent(&core->blocks); /* all of it is in the packet */\n    release(core);",
        "    blocks_sent(&core->blocks);",
    ),
    "P12 a stroke without an end": ("strokes.c", "s->driven > s->setup.stroke_ticks", "false"),
    "P12 a reading that stands still for ever": ("strokes.c", "is_still || ", ""),
    "P12 strokes that fail and go on": ("strokes.c", "s->failed++;", ""),
    "a stroke beyond a limit": ("rig_core.c", "one->turn > core->setup.hard_hi", "false"),
    "two strokes the same way": ("strokes.c", "wants_positive ? drive <= 0 : drive >= 0", "drive == 0"),
    "P13 armed without a zero": ("rig_core.c", "!core->has_zero && core->setup.homing == 0u", "false"),
    "P13 a reset leaves the zero": ("rig_core.c", "core->has_zero = false; /* P13 */", ""),
    "P13 a fault leaves the zero": ("rig_core.c", "    core->has_zero = false;\n    latch", "    latch"),
    "P13 a zero under drive": (
        "rig_core.c",
        "    if (core->armed) {\n        refuse(out, RIG_ZERO",
        "    if (false) {\n        refuse(out, RIG_ZERO",
    ),
    "P13 a homing keeps the zero": ("rig_core.c", "core->has_zero = false; /* P13: whatever", "/* P13: whatever"),
    "P13 a zero worked out from wrong counts": ("rig_core.c", "trouble != RIG_OK", "false"),
    "P13 a still channel is no fault while disarmed": (
        "rig_core.c",
        "if ((troubles & (unsigned)RIG_ENCODER_STILL) != 0u)",
        "if ((troubles & (unsigned)RIG_ENCODER_STILL) != 0u && core->armed)",
    ),
    "P13 counts lost are no fault": ("rig_core.c", "(troubles & (unsigned)RIG_ENCODER_LOST) != 0u", "false"),
    "P13 a still channel is no fault": ("rig_core.c", "(troubles & (unsigned)RIG_ENCODER_STILL) != 0u", "false"),
    "P14 an e-stop that nobody has tried": ("rig_core.c", "!core->estop_tried", "false"),
    "a homing that runs a law": ("rig_core.c", " || core->setup.homing != 0u", ""),
    "a homing without limits": ("rig_core.c", "!(setup->homing == 1u && is_endless(setup))", "true"),
    "a relay beyond its numbers": ("rig_core.c", "relay_reaches(&core->relay.setup, core->counts);", "true;"),
    "strokes beyond what may be counted": (
        "rig_core.c",
        "!is_endless(&core->setup) || is_near(core, counts)",
        "is_near(core, counts) || true",
    ),
    "relay without a bound": ("relay.c", "if (value > bound)", "if (false)"),
    "one row too many": ("blocks.c", "now->n >= b->rows", "now->n > b->rows"),
}

STAY = ("P6", "P13")  # beside the first defect of each file


def make(folder: Path, *words: str) -> subprocess.CompletedProcess[str]:
    environment = {key: value for key, value in os.environ.items() if key not in ("MAKEFLAGS", "MFLAGS", "MAKELEVEL")}
    command = ["make", "-s", "-C", str(folder), *words]
    return subprocess.run(command, env=environment, capture_output=True, text=True, check=False)


def test_the_corpus_is_what_the_drivers_frames_make_of_it(tmp_path: Path) -> None:
    fuzz_corpus.write(tmp_path)
    fresh = {path.relative_to(tmp_path): path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()}
    kept = fuzz_corpus.CORPUS
    assert {path.relative_to(kept): path.read_bytes() for path in kept.rglob("*") if path.is_file()} == fresh


@pytest.mark.evidence
def test_a_short_run_breaks_nothing(tmp_path: Path) -> None:
    made = make(source_folder(), "fuzz", "SECONDS=1", f"BUILD={tmp_path}")
    assert made.returncode == 0, made.stdout + made.stderr
    inputs = dict(
        re.findall(r"^fuzz_(\w+): (\d+) inputs in \d+ s, \d+ edges, nothing broken$", made.stdout, re.MULTILINE)
    )
    assert set(inputs) == {"frames", "core"}
    assert all(int(count) > 0 for count in inputs.values()), inputs  # how many is the machine's matter


@pytest.fixture(scope="module")
def firmware(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A copy of the sources, to put a defect in."""
    folder = copied_firmware(tmp_path_factory.mktemp("sources") / "firmware")
    made = make(folder, "replay", f"BUILD={folder / 'build'}", "CFLAGS=-O0")
    assert made.returncode == 0, made.stdout + made.stderr  # as it is, the corpus breaks nothing
    return folder


@pytest.mark.parametrize("name", first_of_each(DEFECTS, lambda name: (DEFECTS[name][0], name.split()[0] in STAY)))
def test_the_corpus_alone_finds(name: str, firmware: Path) -> None:
    file, text, instead = DEFECTS[name]
    source = firmware / "core" / file
    sound = source.read_text()
    assert sound.count(text) == 1, f"{text!r} is not (only) at one place of {file} any more"
    try:
        source.write_text(sound.replace(text, instead))
        harness = "frames" if file == "frames.c" else "core"
        quick = "CFLAGS=-O0", "WARNINGS=-w", f"HARNESSES={harness}"
        made = make(firmware, "replay", f"BUILD={firmware / 'build'}", *quick)
        assert made.returncode != 0 and ": broken: " in made.stderr, made.stderr
    finally:
        source.write_text(sound)
