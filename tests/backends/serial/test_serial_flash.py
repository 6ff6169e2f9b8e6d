"""`rig flash`, with a program in place of avrdude that notes what it is told and fails as avrdude 6.3 and 7.1 do."""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import pty
import shutil
import signal
import subprocess
import sys
import threading
import time
import tty
from collections.abc import Iterator
from pathlib import Path

import pytest
from click.testing import CliRunner, Result
from firmware_copy import copied_firmware
from serial.tools import list_ports
from serial.tools.list_ports_common import ListPortInfo

from rig.backends.links.serial_port import SerialPort
from rig.backends.serial import flash
from rig.backends.serial.emulated.firmware_build import Variant
from rig.backends.serial.flash import FlashError, Port
from rig.backends.serial.frames import FrameReader, Hello, Kind, encode
from rig.cli import main
from rig.core.faults import Fault
from rig.core.package import VERSION

HELLO = Hello(2, 0, 1, 0, 1023, 400, 0, 0, f"uno {VERSION}".encode().ljust(16, b"\0"))

SYNC_7 = (
    "avrdude error: programmer is not responding\n"
    "avrdude warning: attempt 10 of 10: not in sync: resp=0x00\n"
    "avrdude error: unable to open programmer arduino on port PORT\n\navrdude done.  Thank you.\n"
)
SYNC_6 = "avrdude: stk500_getsync() attempt 10 of 10: not in sync: resp=0xfa\n\navrdude done.  Thank you.\n"
CHIP_7 = (
    "avrdude warning: attempt 1 of 10: not in sync: resp=0x00\n"
    "avrdude: AVR device initialized and ready to accept instructions\n"
    "avrdude: device signature = 0x1e9514 (probably m328)\n"
    "avrdude error: expected signature for ATmega328P is 1E 95 0F\n"
    "        double check chip or use -F to override this check\n\navrdude done.  Thank you.\n"
)
CHIP_6 = (
    "avrdude: Device signature = 0x1e9801 (probably m2560)\navrdude: Expected signature for ATmega328P is 1E 95 0F\n"
)
BUSY_7 = (
    "avrdude OS error: cannot open port PORT: Device or resource busy\n"
    "avrdude error: unable to open programmer arduino on port PORT\n"
)
BUSY_6 = 'avrdude: ser_open(): can\'t open device "PORT": Device or resource busy\n'
DENIED_6 = 'avrdude: ser_open(): can\'t open device "PORT": Permission denied\n'
GONE_7 = "avrdude OS error: cannot open port PORT: No such file or directory\n"
MISMATCH_7 = "avrdude: 7262 bytes of flash written\navrdude error: verification mismatch\n"
MISMATCH_6 = "avrdude: verification error; content mismatch\n"
UNREADABLE_7 = "avrdude OS error: file a.hex is not readable: No such file or directory\n\navrdude done.  Thank you.\n"
DAMAGED_7 = "avrdude error: invalid record at line 1 of a.hex\navrdude error: read from file a.hex failed\n"
NEW = "avrdude error: the moon is in the wrong phase\n\navrdude done.  Thank you.\n"


@pytest.fixture
def avrdude(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The program in place of avrdude, first on the PATH; it says what is in `say`, ends as `end` has it."""
    folder = tmp_path / "bin"
    folder.mkdir()
    program = folder / "avrdude"
    program.write_text(
        f"#!{sys.executable}\n"
        "import sys, time\n"
        "from pathlib import Path\n"
        "here = Path(__file__).parent\n"
        "(here / 'told').write_text('\\n'.join(sys.argv[1:]))\n"
        "if (here / 'say').exists(): sys.stderr.write((here / 'say').read_text())\n"
        "sys.stderr.flush()\n"
        "if (here / 'hang').exists(): time.sleep(60)\n"
        "sys.exit(int((here / 'end').read_text()) if (here / 'end').exists() else 0)\n"
    )
    program.chmod(0o755)
    monkeypatch.setenv("PATH", f"{folder}{os.pathsep}{os.environ['PATH']}")
    return program


def told(avrdude: Path) -> list[str]:
    return (avrdude.parent / "told").read_text().splitlines()


@contextlib.contextmanager
def board(boot_s: float = 0.0, hello: bytes = HELLO.pack()) -> Iterator[str]:
    """An Uno on a pseudo-terminal: in its boot loader, which swallows all, for so long after the first byte."""
    master, slave = pty.openpty()
    tty.setraw(slave)
    os.set_blocking(master, False)
    over = threading.Event()

    def live() -> None:
        reader, boots_until_s = FrameReader(), None
        while not over.wait(0.005):
            with contextlib.suppress(BlockingIOError):
                data = os.read(master, 512)
                boots_until_s = boots_until_s or time.monotonic() + boot_s
                if time.monotonic() < boots_until_s:
                    continue
                for packet in reader.feed(data):
                    if packet.kind == Kind.HELLO:
                        os.write(master, encode(Kind.HELLO_REPLY, packet.seq, hello))

    life = threading.Thread(target=live)
    life.start()
    try:
        yield os.ttyname(slave)
    finally:
        over.set()
        life.join()
        os.close(master)
        os.close(slave)


def rig_flash(*arguments: object) -> Result:
    return CliRunner().invoke(main, ["flash", *map(str, arguments)])


def plugged(monkeypatch: pytest.MonkeyPatch, *ports: Port) -> None:
    monkeypatch.setattr(flash, "serial_ports", lambda: list(ports))


# ---------------------------------------------------------------------- the whole way


def test_the_board_is_written_and_then_says_who_it_is_after_its_boot_loader(avrdude: Path) -> None:
    with board(boot_s=1.6) as port:
        result = rig_flash("--port", port, "--bridge", "in1-in2", "--end-switches")
    assert result.exit_code == 0, result.output
    *words, what = told(avrdude)
    assert " ".join(words) == f"-p atmega328p -c arduino -b 115200 -P {port} -D -U"
    memory, operation, name, form = what.split(":")
    assert (memory, operation, form) == ("flash", "w", "i")
    assert Path(name).name == "rig_uno-in1_in2-ends.hex"
    assert Path(name).read_text().startswith(":")
    who, at_rest = result.stdout.splitlines()[-2:]
    assert who == f"{port}: board uno, build uno {VERSION}, reset: unknown, cleared by the boot loader"
    assert "D10" in at_rest and "full drive" in at_rest


def test_a_board_that_goes_on_with_another_firmware_is_said(avrdude: Path) -> None:
    with board(hello=HELLO._replace(build=b"uno 0.0.9".ljust(16, b"\0")).pack()) as port:
        result = rig_flash("--port", port)
    assert result.exit_code == 1
    assert f"build uno 0.0.9, and what was written is uno {VERSION}" in result.stderr
    assert "type this again" in result.stderr


def test_what_came_with_rig_is_taken_if_its_hash_is_right(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert flash.prebuilt("rig_uno.hex", tmp_path) is None
    (tmp_path / "rig_uno-in1_in2.hex").write_bytes(b":00000001FF\n")
    digest = hashlib.sha256(b":00000001FF\n").hexdigest()
    (tmp_path / "SHA256SUMS").write_text(f"{digest}  rig_uno-in1_in2.hex\n")
    monkeypatch.setattr(flash, "PREBUILT", tmp_path)
    monkeypatch.setenv("PATH", str(tmp_path))  # no compiler
    dry = rig_flash("--dry-run", "--port", "/dev/ttyACM7", "--bridge", "in1-in2")
    assert dry.exit_code == 0, dry.output
    assert dry.stdout.splitlines()[:2] == [
        f"prebuilt firmware rig_uno-in1_in2.hex, SHA-256 {digest}",
        "this firmware has never run on a real chip: take the first steps of docs/real-bench.md one by one",
    ]
    (tmp_path / "rig_uno-in1_in2.hex").write_bytes(b":00000001FE\n")
    damaged = rig_flash("--dry-run", "--port", "/dev/ttyACM7", "--bridge", "in1-in2")
    assert damaged.exit_code == 1
    assert "is damaged: its SHA-256 is" in damaged.stderr and "install rig again" in damaged.stderr


def test_it_says_that_no_real_chip_has_run_it_until_a_report_stands_in_the_docs() -> None:
    """Of each board: a report of a real chip that found nothing bad, and the page that says so."""
    docs = Path(__file__).resolve().parents[3] / "docs"
    reports = {path.name: json.loads(path.read_text()) for path in (docs / "loopback").glob("*.json")}
    real = {report["board"]["name"]: name for name, report in reports.items() if not report["emulated"]}
    assert real == flash.REAL_CHIP_REPORTS
    assert all(reports[name]["ok"] for name in real.values())
    page = (docs / "loopback.md").read_text()
    for board in ("uno", "pico"):
        assert (f"| {board} | none: it has never run on a real chip |" in page) == (board not in real)


def test_the_reset_cause_is_told_where_the_boot_loader_leaves_it(avrdude: Path, tmp_path: Path) -> None:
    (tmp_path / "a.hex").write_text(":00000001FF\n")
    with board(hello=HELLO._replace(reset_cause=2 | 4).pack()) as port:
        result = rig_flash("--port", port, "--hex", tmp_path / "a.hex")
    assert result.exit_code == 0, result.output
    assert told(avrdude)[-1] == f"flash:w:{tmp_path / 'a.hex'}:i"
    assert result.stdout.endswith("reset: external, brown-out\n")


def test_a_dry_run_builds_and_says_the_command_and_touches_nothing(
    avrdude: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    plugged(monkeypatch, Port("/dev/ttyS0"), Port("/dev/ttyACM7", 0x2341, 0x0043))
    result = rig_flash("--dry-run", "--baud", 1000000)
    assert result.exit_code == 0, result.output
    found, command = result.stdout.splitlines()
    assert found == "found: /dev/ttyACM7 (Arduino Uno, 2341:0043)"
    assert command.startswith(f"would run: {avrdude} -p atmega328p -c arduino -b 115200 -P /dev/ttyACM7 -D -U flash:w:")
    assert command.endswith("rig_uno-1000000.hex:i")
    assert not (avrdude.parent / "told").exists()


def test_a_dry_run_does_without_avrdude_and_a_real_one_does_not(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    hex_file = tmp_path / "rig uno.hex"
    hex_file.write_text(":00000001FF\n")
    dry = rig_flash("--dry-run", "--hex", hex_file, "--port", "/dev/ttyACM7")
    assert (dry.exit_code, dry.stderr) == (0, "")
    assert dry.stdout.splitlines() == [
        f"would run: avrdude -p atmega328p -c arduino -b 115200 -P /dev/ttyACM7 -D -U 'flash:w:{hex_file}:i'",
        "avrdude is missing here. Debian: apt-get install avrdude",
    ]
    real = rig_flash("--hex", hex_file, "--port", "/dev/ttyACM7")
    assert real.exit_code == 1
    assert real.stderr.splitlines() == [
        "rig: `avrdude`, which writes to the board, is missing",
        "     Debian: apt-get install avrdude",
    ]


def test_a_dry_run_does_without_a_board(avrdude: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    plugged(monkeypatch, Port("/dev/ttyS0"))
    result = rig_flash("--dry-run")
    assert (result.exit_code, result.stderr) == (0, "")
    none, command = result.stdout.splitlines()
    assert none == "no Arduino Uno on USB: PORT stands for its port"
    assert command.startswith(f"would run: {avrdude} -p atmega328p -c arduino -b 115200 -P PORT -D -U flash:w:")
    assert rig_flash().exit_code == 1
    assert not (avrdude.parent / "told").exists()


def test_a_board_that_stays_silent_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    with board(boot_s=60.0) as port, pytest.raises(FlashError) as caught:
        flash.meet(port, 115200, timeout_s=0.3)
    assert "does not answer: nothing" in caught.value.cause
    assert "--baud" in caught.value.cure


# ---------------------------------------------------------------------- what goes wrong


@pytest.mark.parametrize("said", [SYNC_7, SYNC_6, CHIP_7, BUSY_7, MISMATCH_7, DAMAGED_7, NEW])
def test_avrdudes_words_and_status_pass_with_one_line_of_cause_and_one_of_cure(avrdude: Path, said: str) -> None:
    (avrdude.parent / "say").write_text(said)
    (avrdude.parent / "end").write_text("7")
    with board() as port:
        result = rig_flash("--port", port)
    assert result.exit_code == 7
    assert result.stderr.startswith(said)
    cause, cure = result.stderr.removeprefix(said).splitlines()
    assert cause.startswith("rig: ") and cure.startswith("     ")


@pytest.mark.parametrize(
    ("said", "cause"),
    [
        (SYNC_7, "no boot loader answers at PORT: programmer not in sync"),
        (SYNC_6, "no boot loader answers at PORT: programmer not in sync"),
        (CHIP_7, "the chip at PORT is no ATmega328P: its signature is 0x1e9514"),
        (CHIP_6, "the chip at PORT is no ATmega328P: its signature is 0x1e9801"),
        (BUSY_7, "PORT is held by another program"),
        (BUSY_6, "PORT is held by another program"),
        (DENIED_6, "PORT cannot be opened by this user"),
        (GONE_7, "PORT is not there"),
        (MISMATCH_7, "the board does not read back what was written"),
        (MISMATCH_6, "the board does not read back what was written"),
        (UNREADABLE_7, "avrdude cannot read the .hex: file a.hex is not readable: No such file or directory"),
        (DAMAGED_7, "avrdude cannot read the .hex: read from file a.hex failed"),
        (NEW, "avrdude failed, status 3: the moon is in the wrong phase"),
        ("", "avrdude failed, status 3: it said nothing"),
    ],
)
def test_what_avrdudes_words_mean(said: str, cause: str) -> None:
    error = flash.failure(3, said, "PORT")
    assert (error.cause, error.status) == (cause, 3)
    assert error.cure and "{" not in error.cure


def test_a_port_that_another_rig_holds_is_not_touched(avrdude: Path) -> None:
    with board() as port, contextlib.closing(SerialPort(port)):
        result = rig_flash("--port", port)
    assert result.exit_code == 1
    assert result.stderr.splitlines()[0] == f"rig: {port} is held by another program"
    assert f"fuser {port}" in result.stderr
    assert not (avrdude.parent / "told").exists()


@pytest.mark.parametrize(("name", "what"), [("none", "is not there"), ("file", "is no serial port")])
def test_what_is_no_port(avrdude: Path, tmp_path: Path, name: str, what: str) -> None:
    (tmp_path / "file").touch()
    result = rig_flash("--port", tmp_path / name)
    assert result.exit_code == 1
    assert result.stderr.splitlines()[0] == f"rig: {tmp_path / name} {what}"
    assert len(result.stderr.splitlines()) == 2


def test_without_avrdude_its_package_is_named(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    result = rig_flash("--port", "/dev/ttyACM0")
    assert result.exit_code == 1
    assert result.stderr.splitlines()[1:] == ["     Debian: apt-get install avrdude"]


@pytest.mark.parametrize("here", [("make", "cc"), ("make", "cc", "avr-gcc")])
def test_without_the_compiler_or_its_library_the_packages_are_named(
    avrdude: Path, monkeypatch: pytest.MonkeyPatch, here: tuple[str, ...], tmp_path: Path
) -> None:
    sources = copied_firmware(tmp_path / "firmware")  # never built
    monkeypatch.setattr("rig.backends.serial.emulated.firmware_build.source_folder", lambda: sources)
    for name in here:
        program = avrdude.parent / name
        if name == "avr-gcc":  # without avr-libc
            program.write_text(
                "#!/bin/sh\necho 'adc.c:3:10: fatal error: avr/io.h: No such file or directory' >&2\nexit 1\n"
            )
            program.chmod(0o755)
        else:
            program.symlink_to(shutil.which(name) or "")
    for name in ("mkdir", "sh"):
        (avrdude.parent / name).symlink_to(shutil.which(name) or "")
    monkeypatch.setenv("PATH", str(avrdude.parent))
    result = rig_flash("--port", "/dev/ttyACM0")
    assert result.exit_code == 1
    assert len(result.stderr.splitlines()) <= 2
    assert "apt-get install gcc-avr avr-libc binutils-avr" in result.stderr


def test_ctrl_c_ends_avrdude_and_says_what_state_the_board_may_be_in(avrdude: Path) -> None:
    (avrdude.parent / "say").write_text("Writing | #### \n")
    (avrdude.parent / "hang").touch()
    with board() as port:
        command = [sys.executable, "-m", "rig", "flash", "--port", port]
        with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
            assert process.stderr is not None
            assert process.stderr.readline().startswith("Writing")
            process.send_signal(signal.SIGINT)
            _, said = process.communicate()  # which waits for avrdude, too: it has these pipes
    assert process.returncode == 130
    cause, cure = said.strip().splitlines()
    assert "half a program" in cause and "supply off" in cure


def test_no_rig_opens_a_port_that_avrdude_writes_to_not_even_once_rig_flash_was_killed(avrdude: Path) -> None:
    (avrdude.parent / "say").write_text("Writing | #### \n")
    (avrdude.parent / "hang").touch()
    with board() as port:
        command = [sys.executable, "-m", "rig", "flash", "--port", port]
        with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True) as process:
            assert process.stderr is not None
            assert process.stderr.readline().startswith("Writing")
            writes = int(Path(f"/proc/{process.pid}/task/{process.pid}/children").read_text())
            process.kill()
            process.wait()
            with pytest.raises(Fault, match="holds it"):
                SerialPort(port)
            os.kill(writes, signal.SIGTERM)


def test_a_built_hex_takes_no_build_options(avrdude: Path, tmp_path: Path) -> None:
    (tmp_path / "a.hex").write_text(":00000001FF\n")
    result = rig_flash("--port", "/dev/ttyACM0", "--hex", tmp_path / "a.hex", "--bridge", "in1-in2")
    assert result.exit_code == 2
    assert len(result.stderr.splitlines()) == 2


# ---------------------------------------------------------------------- which port


def test_the_only_candidate_is_taken_whatever_else_is_plugged_in() -> None:
    clone = Port("/dev/ttyUSB3", 0x1A86, 0x7523)
    assert flash.only_candidate([Port("/dev/ttyS0"), clone, Port("/dev/ttyACM0", 0x1546, 0x01A8)]) == clone


def test_several_boards_are_a_question() -> None:
    with pytest.raises(FlashError) as caught:
        flash.only_candidate([Port("/dev/ttyUSB0", 0x1A86, 0x7523), Port("/dev/ttyACM0", 0x2A03, 0x0043)])
    assert caught.value.cause == (
        "several boards: /dev/ttyACM0 (Arduino Uno, 2a03:0043), /dev/ttyUSB0 (CH340, as on many clones, 1a86:7523)"
    )


@pytest.mark.parametrize(
    ("ports", "cause"),
    [
        ([], "no Arduino Uno on USB"),
        ([Port("/dev/ttyS0")], "no Arduino Uno on USB"),
        ([Port("/dev/ttyACM0", 0x1546, 0x01A8)], "no Arduino Uno on USB, but /dev/ttyACM0 (unknown, 1546:01a8)"),
    ],
)
def test_no_board_is_said_with_what_else_there_is(ports: list[Port], cause: str) -> None:
    with pytest.raises(FlashError) as caught:
        flash.only_candidate(ports)
    assert caught.value.cause == cause


def test_ports_are_listed_with_their_usb_chips(monkeypatch: pytest.MonkeyPatch) -> None:
    on_board, on_usb = ListPortInfo("/dev/ttyS0"), ListPortInfo("/dev/ttyACM0")
    on_usb.vid, on_usb.pid = 0x2341, 0x0043
    monkeypatch.setattr(list_ports, "comports", lambda: [on_board, on_usb])
    assert flash.serial_ports() == [Port("/dev/ttyS0"), Port("/dev/ttyACM0", 0x2341, 0x0043)]


# ---------------------------------------------------------------------- as a config says


def test_a_config_says_what_the_firmware_is_for_and_no_option_contradicts_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    built: list[Variant] = []

    def build(options: Variant) -> Path:
        built.append(options)
        return tmp_path / "firmware.hex"

    monkeypatch.setattr("rig.backends.serial.emulated.firmware_build.build_uno", build)
    path = tmp_path / "bench.yaml"
    text = (Path(__file__).resolve().parents[3] / "config/uno.yaml").read_text(encoding="utf-8")
    path.write_text(text.replace("port: /dev/ttyACM0", "port: /dev/ttyACM7"), encoding="utf-8")
    result = rig_flash(path, "--supply", "--end-switches", "--dry-run")
    assert result.exit_code == 0, result.output
    assert "-P /dev/ttyACM7 " in result.output
    assert built == [Variant("IN1_IN2", 1_000_000, supply=True, end_switches=True)]
    for wrong, says in (
        (("--bridge", "pwm-dir"), f"--bridge pwm-dir, but drive.bridge of {path} is in1-in2"),
        (("--baud", "115200"), f"--baud 115200, but daq.baud of {path} is 1000000"),
        (("--board", "pico"), f"--board pico, but sensor.counts_max of {path} is that of the uno"),
        (("--port", "/dev/ttyACM0"), f"--port /dev/ttyACM0, but daq.port of {path} is /dev/ttyACM7"),
        (("--encoder",), f"--encoder, but {path} has no section sensor.encoder"),
        (("--tachometer",), f"--tachometer, but {path} has no section tachometer"),
    ):
        refused = rig_flash(path, *wrong, "--dry-run")
        assert (refused.exit_code, says in refused.output) == (2, True), refused.output
    assert len(built) == 1


@pytest.mark.parametrize(
    ("config", "says"),
    [
        ("modbus-rtu", "its device, `driver: modbus`, runs no firmware of rig"),
        ("demo", "does not name the bridge, and with the wrong one 0 V can be full drive"),
        ("none", "no such file"),
    ],
)
def test_a_config_that_does_not_tell_the_firmware_is_refused(config: str, says: str) -> None:
    refused = rig_flash(Path(__file__).resolve().parents[3] / "config" / f"{config}.yaml", "--dry-run")
    assert refused.exit_code == 2 and says in refused.output
