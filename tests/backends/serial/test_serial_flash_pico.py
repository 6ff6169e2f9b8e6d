"""`rig flash --board pico`, with a folder in place of the drive that a Pico is while BOOTSEL is held."""

from __future__ import annotations

import struct
import threading
import time
from pathlib import Path

import pytest
from click.testing import CliRunner, Result

from rig.backends.serial import flash_pico
from rig.backends.serial.emulated.firmware_build import Variant, build_pico
from rig.backends.serial.flash import FlashError
from rig.cli import main

ABOUT = "UF2 Bootloader v3.0\nModel: Raspberry Pi RP2\nBoard-ID: RPI-RP2\n"


@pytest.fixture
def drive(tmp_path: Path) -> Path:
    folder = tmp_path / "RPI RP2"
    folder.mkdir()
    (folder / "INFO_UF2.TXT").write_text(ABOUT)
    return folder


def run(*asked: str) -> Result:
    return CliRunner().invoke(main, ["flash", "--board", "pico", *asked])


def vanishing(folder: Path) -> threading.Thread:
    """A board that restarts when it has a whole file."""

    def wait() -> None:
        while not [path for path in folder.glob("*.uf2") if path.stat().st_size > 0]:
            time.sleep(0.01)
        (folder / "INFO_UF2.TXT").unlink()

    thread = threading.Thread(target=wait, daemon=True)
    thread.start()
    return thread


def test_the_uf2_has_every_byte_of_the_program_and_the_boot_programs_checksum() -> None:
    uf2 = build_pico()
    program = uf2.with_suffix(".bin").read_bytes()
    blocks = [uf2.read_bytes()[at : at + 512] for at in range(0, uf2.stat().st_size, 512)]
    assert len(blocks) == -(-len(program) // 256)
    flash = b""
    for number, block in enumerate(blocks):
        head = struct.unpack("<8I", block[:32])
        assert head == (
            0x0A324655, 0x9E5D5157, 0x2000, 0x10000000 + 256 * number, 256, number, len(blocks), 0xE48BFF56,
        )  # fmt: skip
        assert block[-4:] == struct.pack("<I", 0x0AB16F30)
        flash += block[32:288]
    crc = 0xFFFFFFFF
    for byte in flash[:252]:
        crc ^= byte << 24
        for _ in range(8):
            crc = (crc << 1 ^ 0x04C11DB7 if crc & 0x80000000 else crc << 1) & 0xFFFFFFFF
    assert flash[252:256] == struct.pack("<I", crc)
    assert flash[256 : len(program)] == program[256:] and flash[:252] == program[:252]


@pytest.mark.evidence
def test_a_variant_has_its_name() -> None:
    options = Variant("IN1_IN2", 1_000_000, supply=True)
    assert build_pico(options).name == "rig_pico-in1_in2-1000000-supply.uf2"


def test_it_copies_the_firmware_and_waits_until_the_board_restarts(drive: Path) -> None:
    board = vanishing(drive)
    result = run("--drive", str(drive), "--bridge", "in1-in2")
    board.join(5.0)
    assert result.exit_code == 0, result.output
    assert (drive / "rig_pico-in1_in2.uf2").read_bytes() == build_pico(Variant("IN1_IN2")).read_bytes()
    assert "GP17) must be at 3.3 V" in result.stdout and "--port PORT" in result.stdout


def test_a_dry_run_copies_nothing_and_needs_no_board(drive: Path) -> None:
    result = run("--drive", str(drive), "--dry-run")
    assert result.exit_code == 0 and f"rig_pico.uf2 to {drive}" in result.stdout
    assert not list(drive.glob("*.uf2"))
    result = run("--drive", str(drive / "nowhere"), "--dry-run")
    assert result.exit_code == 0 and "BOOTSEL" in result.stdout and "to DRIVE" in result.stdout


def test_what_is_no_pico_is_named(drive: Path, tmp_path: Path) -> None:
    result = run("--drive", str(tmp_path))
    assert result.exit_code == 1 and "has no INFO_UF2.TXT" in result.stderr and "BOOTSEL" in result.stderr
    (drive / "INFO_UF2.TXT").write_text(ABOUT.replace("RPI-RP2", "RP2350"))
    result = run("--drive", str(drive))
    assert result.exit_code == 1 and "no Pico with an RP2040 (Board-ID: RP2350)" in result.stderr


def test_the_only_mounted_drive_is_found(drive: Path, tmp_path: Path) -> None:
    mounts = tmp_path / "mounts"
    line = f"/dev/sdb1 {drive} vfat rw 0 0\n".replace("RPI RP2", "RPI\\040RP2")
    mounts.write_text(f"proc /proc proc rw 0 0\n/dev/sda1 {tmp_path} ext4 rw 0 0\n{line}")
    assert flash_pico.find_drive(None, mounts) == drive
    mounts.write_text(2 * line)
    with pytest.raises(FlashError, match="several Picos"):
        flash_pico.find_drive(None, mounts)
    mounts.write_text("")
    with pytest.raises(FlashError, match="no Pico is there") as caught:
        flash_pico.find_drive(None, mounts)
    assert "hold its button BOOTSEL" in caught.value.cure


def test_a_file_that_the_board_would_ignore_is_refused(drive: Path, tmp_path: Path) -> None:
    other = tmp_path / "other.uf2"
    whole = build_pico().read_bytes()
    for bad in (b"", b"hello", whole[:-1], whole.replace(struct.pack("<I", 0xE48BFF56), b"\0\0\0\0")):
        other.write_bytes(bad)
        result = run("--drive", str(drive), "--uf2", str(other))
        assert result.exit_code == 1 and "no .uf2 for the RP2040" in result.stderr
        assert not list(drive.glob("*.uf2"))


def test_a_board_that_does_not_restart_is_told(drive: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(flash_pico, "_RESTART_S", 0.2)
    result = run("--drive", str(drive))
    assert result.exit_code == 1 and "has not taken the file" in result.stderr


@pytest.mark.parametrize(
    ("asked", "word"),
    [
        (("--board", "pico", "--hex", __file__), "--hex is for the Uno"),
        (("--uf2", __file__), "--uf2 is for the Pico"),
        (("--drive", "/x"), "--drive is for the Pico"),
        (("--board", "pico", "--uf2", __file__, "--supply"), "with --uf2 only --baud"),
    ],
)
def test_what_is_meant_for_the_other_board_is_refused(asked: tuple[str, ...], word: str) -> None:
    result = CliRunner().invoke(main, ["flash", *asked])
    assert result.exit_code == 2 and word in result.stderr
