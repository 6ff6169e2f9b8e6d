"""The corpus that the firmware's fuzzers start from, made of frames as the host's driver sends them.

    python tools/fuzz_corpus.py [FOLDER]    default: firmware/tests/corpus

Writes FOLDER/core (scripts of steps for firmware/tests/fuzz_core.c) and FOLDER/frames (bytes for fuzz_frames.c), one
file a situation. A byte for byte equal corpus comes out each time; a test holds the repository's to it.
"""

from __future__ import annotations

import sys
from pathlib import Path

from rig.backends.serial.frames import (
    VERSION,
    Code,
    Kind,
    RelaySetup,
    Setup,
    StrokesSetup,
    encode,
    pack_ack,
    pack_arm,
    pack_drive,
    pack_zero,
)
from rig.core.calibration import ALL_COUNTS

CORPUS = Path(__file__).resolve().parent.parent / "firmware" / "tests" / "corpus"

SESSION = 0x12345678
SETUP = Setup(
    session=SESSION,
    hard_lo=100,
    hard_hi=900,
    rail_lo=5,
    rail_hi=1018,
    centre=512,
    max_drive=200,
    watchdog_ms=20,
    polarity=1,
)
RELAY = RelaySetup(drive=(-160, 40, -40, 160), centre=512 * 16, z_bound=30000, direction=1, rows=10)
STROKES = StrokesSetup(((120, 600), (-150, 420), (60, 560), (-90, 450)), 40, 30, 4, rows=10)

# the board's byte: 10-bit converter with contacts and supply; + what a situation changes
BOARD = 4 | 8
NO_CONTACTS, TWELVE_BITS, WIDE, BEFORE_WRAP, LAGGING, FINE_DRIVE, ENCODER = -4, 1, 2, 16, 32, 64, 128
ESTOP, END_LOW, END_HIGH = 1, 2, 4  # of a step `contacts`


def step(code: int, n: int = 0, argument: bytes = b"") -> bytes:
    """One step of fuzz_core.c's script: its code, 5 bits of `n`, and what follows."""
    return bytes([code | n << 3]) + argument


def ticks(count: int) -> bytes:
    """So many ticks of 1 ms."""
    whole, rest = divmod(count, 32)
    return step(0, 31) * whole + (step(0, rest - 1) if rest else b"")


def wait(us: int) -> bytes:
    """Time that passes without a tick."""
    return step(1, 0, bytes([us // 16]))


def reading(counts: int) -> bytes:
    """The position sensor's counts from now on."""
    return step(2, 0, (counts % 2**32).to_bytes(4, "little"))


def contacts(bits: int) -> bytes:
    """The contacts that ask for a stop from now on."""
    return step(3, bits)


def content(kind: int, body: bytes = b"", seq: int = 7, version: int = VERSION) -> bytes:
    """A packet without its CRC."""
    return bytes([version, kind]) + seq.to_bytes(2, "little") + body


def frame(kind: int, body: bytes = b"", seq: int = 7, version: int = VERSION) -> bytes:
    """A frame whose CRC the harness puts in, so that what changes in it still counts."""
    packet = content(kind, body, seq, version)
    return step(4, 0, bytes([len(packet)]) + packet)


def damaged(kind: int, body: bytes = b"", where: int = 3, bits: int = 0x10) -> bytes:
    """The same with some bits of one byte on the wire changed."""
    packet = content(kind, body)
    return step(5, 0, bytes([len(packet), where, bits]) + packet)


def raw(data: bytes) -> bytes:
    """Bytes as they are."""
    return b"".join(step(6, len(part), part) for at in range(0, len(data), 31) for part in [data[at : at + 31]])


def board(streams: bool = True, reset: bool = False, troubles: int = 0) -> bytes:
    """Whether the board has time to send blocks, whether it starts anew, and what it finds wrong with its encoder."""
    return step(7, streams | reset << 1 | troubles << 2)


def drive(units: int) -> bytes:
    """A DRIVE frame."""
    return frame(Kind.DRIVE, pack_drive(units))


def ack(code: int) -> bytes:
    """An ACK frame."""
    return frame(Kind.ACK, pack_ack(code))


READ, STOP, KEEP, HELLO = (frame(k) for k in (Kind.READ, Kind.STOP, Kind.KEEP, Kind.HELLO))
ARM = frame(Kind.ARM, pack_arm(SESSION))
ALL_SEEN = b"".join(
    ack(code) for code in (*range(Code.WATCHDOG, Code.DRIVE_RANGE + 1), *range(Code.POLARITY, Code.SESSION))
)


ENCODER_SEEN = b"".join(ack(code) for code in (Code.ENCODER_LOST, Code.ENCODER_RATE, Code.ENCODER_STILL))


def armed(setup: Setup = SETUP) -> bytes:
    """Set up and armed, after a reset."""
    return frame(Kind.SETUP, setup.pack()) + ack(Code.RESET) + ARM


def zero(counts: int = 0) -> bytes:
    """A ZERO frame."""
    return frame(Kind.ZERO, pack_zero(counts))


def counted(setup: Setup) -> bytes:
    """Set up and armed, of an encoder that stands at 0."""
    return frame(Kind.SETUP, setup.pack()) + ack(Code.RESET) + zero() + ARM


def relay(setup: RelaySetup = RELAY) -> bytes:
    """A RELAY frame."""
    return frame(Kind.RELAY, setup.pack())


def strokes(setup: StrokesSetup = STROKES) -> bytes:
    """A STROKES frame."""
    return frame(Kind.STROKES, setup.pack())


def to_and_fro(rounds: int, low: int = 410, high: int = 610) -> bytes:
    """Strokes that turn, kept alive."""
    return b"".join(reading((high, low)[i % 2]) + ticks(3) + KEEP + reading(512 + i) + ticks(9) for i in range(rounds))


def stuck(rounds: int) -> bytes:
    """A reading that does not change, kept alive."""
    return (ticks(15) + KEEP) * rounds


def kept(rounds: int) -> bytes:
    """A relay that swings, kept alive."""
    return b"".join(reading(520 - 16 * (i % 2)) + ticks(12) + KEEP for i in range(rounds))


def core_corpus() -> dict[str, bytes]:
    """Scripts by situation."""
    swapped = RELAY._replace(drive=(160, -40, 40, -160))
    falling = SETUP._replace(polarity=-1)
    on_the_wire = b"".join(
        encode(kind, seq, body)
        for seq, (kind, body) in enumerate(
            [
                (Kind.SETUP, SETUP.pack()),
                (Kind.ACK, pack_ack(Code.RESET)),
                (Kind.ARM, pack_arm(SESSION)),
                (Kind.DRIVE, pack_drive(120)),
            ]
        )
    )
    scripts = {
        "hello": HELLO + READ + frame(Kind.HELLO, version=1) + frame(0x55) + frame(Kind.READ, b"\0"),
        "drive": armed() + drive(150) + ticks(5) + READ + drive(-200) + ticks(5) + STOP + ticks(2) + drive(50) + READ,
        "not_armed": drive(100) + READ + frame(Kind.SETUP, SETUP.pack()) + drive(100) + ticks(1) + relay() + KEEP,
        "no_setup": ARM + drive(100) + ticks(2) + READ + ack(Code.RESET) + ARM
        + frame(Kind.ARM, pack_arm(0)) + drive(100) + ticks(2),
        "beyond_range": armed() + drive(200) + ticks(1) + drive(201) + ticks(1) + drive(100) + ticks(1) + ARM
        + ack(Code.DRIVE_RANGE) + ARM + drive(-201),
        "silent": armed() + drive(100) + ticks(25) + drive(100) + ticks(2) + READ + ARM
        + ack(Code.WATCHDOG) + ARM + drive(60) + ticks(3),
        "silent_phase": armed() + wait(700) + drive(100) + wait(320) + ticks(25),
        "read_keeps_no_drive": armed() + drive(100) + (ticks(8) + READ + KEEP) * 4,
        "travel": armed() + drive(100) + reading(901) + ticks(1) + reading(512) + drive(90) + ticks(1) + READ,
        "travel_low": armed() + drive(-100) + reading(99) + ticks(1) + READ + reading(512) + drive(90) + ticks(1),
        "rail": armed() + drive(100) + reading(1018) + ticks(1) + ARM + reading(0) + ALL_SEEN + ARM
        + reading(512) + ALL_SEEN + ARM + drive(5),
        "rail_within_limits": armed(SETUP._replace(hard_hi=1021)) + drive(100) + reading(1019) + ticks(1),
        "recover": reading(950) + armed() + drive(-80) + ticks(3) + reading(905) + ticks(2) + reading(880) + ticks(2)
        + drive(80) + ticks(2) + reading(910) + ticks(1) + READ,
        "recover_outward": reading(950) + armed() + drive(80) + ticks(1) + ack(Code.TRAVEL) + ARM + reading(960)
        + ticks(1) + drive(-80) + reading(995) + ticks(2),
        "recover_low": reading(60) + armed(falling) + drive(-80) + ticks(3) + reading(120) + ticks(1)
        + drive(80) + ticks(1),
        "end_switch": armed() + drive(100) + contacts(END_HIGH) + ticks(1) + ALL_SEEN + ARM + drive(-50)
        + ticks(2) + contacts(0) + ticks(2) + drive(50) + ticks(1) + contacts(END_LOW) + ticks(1),
        "end_switch_outward": contacts(END_LOW) + armed() + drive(-50) + ticks(2),
        "both_ends": contacts(END_LOW | END_HIGH) + armed() + drive(10) + ticks(1),
        "switch_against_position": reading(950) + contacts(END_LOW) + armed() + drive(-50) + ticks(3),
        "position_against_switch": contacts(END_HIGH) + armed() + drive(-50) + ticks(1) + reading(60) + ticks(2),
        "estop": armed() + drive(100) + ticks(1) + contacts(ESTOP) + ticks(1) + ack(Code.E_STOP) + ARM + contacts(0)
        + drive(60) + ticks(1) + ARM + ack(Code.E_STOP) + ARM + drive(60),
        "estop_in_a_pause": armed() + drive(100) + STOP + contacts(ESTOP) + ticks(1) + contacts(0) + ticks(3) + ARM
        + drive(60) + ack(Code.E_STOP) + ARM + drive(60) + STOP + contacts(ESTOP) + READ + contacts(0) + ARM,
        "estop_seen_by_one_request": armed() + b"".join(
            STOP + contacts(ESTOP) + request + contacts(0) + ARM + drive(60) + ALL_SEEN + ARM
            for request in (STOP, READ, ARM, ack(Code.TRAVEL))
        ),
        "rail_in_a_pause": reading(2) + ticks(1) + reading(512) + armed() + STOP + reading(2) + ticks(1) + reading(512)
        + ARM + ack(Code.SENSOR_RAIL) + ARM + STOP + reading(950) + ticks(1) + reading(512) + ARM + drive(50),
        "sessions": armed() + frame(Kind.ARM, pack_arm(SESSION + 1)) + drive(50) + frame(Kind.ARM, pack_arm(0)) + ARM
        + STOP + frame(Kind.SETUP, SETUP._replace(session=0).pack()) + ARM
        + frame(Kind.SETUP, SETUP._replace(session=9).pack()) + ARM + frame(Kind.ARM, pack_arm(9)) + drive(50),
        "setup_while_armed": armed() + drive(100) + frame(Kind.SETUP, SETUP._replace(max_drive=700).pack())
        + drive(300),
        "setup_refused": frame(Kind.SETUP, SETUP._replace(rail_hi=2000).pack())
        + frame(Kind.SETUP, SETUP._replace(watchdog_ms=0).pack()) + ARM + drive(100),
        "relay": armed() + relay() + kept(6) + STOP + READ,
        "relay_silent": armed() + relay() + ticks(30) + READ,
        "relay_read_keeps_nothing": armed() + relay() + (ticks(8) + READ) * 4,
        "relay_then_drive": armed() + relay() + kept(2) + drive(70) + ticks(4) + relay() + kept(1) + ARM
        + relay() + kept(1),
        "relay_refused": reading(520) + armed() + relay(RELAY._replace(drive=(-300, 0, 0, 160))) + relay(swapped)
        + relay(RELAY._replace(rows=11)) + relay(RELAY._replace(centre=2**31 - 1)) + relay(RELAY._replace(z_bound=0))
        + ticks(2),
        "relay_limit": armed() + relay() + kept(1) + reading(950) + ticks(2) + ALL_SEEN + ARM + relay()
        + drive(-50) + ticks(1),
        "relay_bound": armed() + relay(RELAY._replace(z_bound=500)) + kept(2) + STOP,
        "relay_falling": armed(falling) + relay(swapped) + kept(2) + contacts(ESTOP) + READ,
        "relay_not_streamed": armed() + relay() + board(streams=False) + kept(3) + board() + ticks(1) + STOP,
        "relay_block_after_setup": armed() + relay() + board(streams=False) + ticks(25)
        + frame(Kind.SETUP, SETUP._replace(session=9, max_drive=50).pack()) + board() + READ,
        "relay_off_grid": armed() + relay() + ticks(4) + wait(300) + ticks(4) + KEEP + wait(160) + ticks(11),
        "strokes": reading(500) + armed() + strokes() + to_and_fro(6) + STOP + READ,
        "strokes_slow": reading(500) + armed() + strokes()
        + b"".join(reading(501 + i) + ticks(2) + (KEEP if i % 5 == 0 else b"") for i in range(50)) + STOP,
        "strokes_stuck": reading(500) + armed() + strokes() + stuck(6) + drive(0) + strokes() + stuck(2) + STOP,
        "strokes_full_and_stuck": reading(500) + armed() + strokes(STROKES._replace(still_ticks=300)) + stuck(7) + READ,
        "strokes_refused": reading(500) + strokes() + armed()
        + b"".join(
            strokes(wrong)
            for wrong in (
                STROKES._replace(strokes=((201, 600), (-150, 420))),
                STROKES._replace(strokes=((120, 600), (-201, 420))),
                STROKES._replace(strokes=((120, 901), (-150, 420))),
                STROKES._replace(strokes=((120, 600), (-150, 99))),
                STROKES._replace(strokes=((120, 600), (150, 420))),
                STROKES._replace(strokes=((120, 600), (0, 420))),
                STROKES._replace(strokes=((120, 600),)),
                STROKES._replace(stroke_ticks=0),
                STROKES._replace(still_ticks=10001),
                STROKES._replace(still_counts=0),
                STROKES._replace(rows=11),
            )
        )
        + ticks(2),
        "strokes_silent": reading(500) + armed() + strokes() + ticks(30) + READ,
        "strokes_read_keeps_nothing": reading(500) + armed() + strokes() + (ticks(8) + READ) * 4,
        "strokes_limit": reading(500) + armed() + strokes() + to_and_fro(1) + reading(950) + ticks(2) + ALL_SEEN + ARM
        + strokes() + drive(-50) + ticks(1),
        "strokes_estop": reading(500) + armed() + strokes() + to_and_fro(2) + contacts(ESTOP) + ticks(1) + READ,
        "strokes_falling": reading(500) + armed(falling) + strokes(STROKES._replace(strokes=((120, 420), (-150, 600))))
        + to_and_fro(3) + contacts(END_HIGH) + ticks(1),
        "strokes_and_relay": reading(500) + armed() + strokes() + to_and_fro(1) + relay() + drive(20) + relay()
        + kept(1) + strokes() + drive(0) + reading(500) + strokes() + to_and_fro(2) + ARM + strokes() + ticks(2) + STOP,
        "strokes_not_streamed": reading(500) + armed() + strokes() + board(streams=False) + to_and_fro(3) + board()
        + ticks(1) + STOP,
        "reset": armed() + drive(100) + board(reset=True) + drive(100) + ticks(1) + ARM + ALL_SEEN + ARM,
        "damaged": damaged(Kind.SETUP, SETUP.pack()) + armed() + damaged(Kind.DRIVE, pack_drive(90)) + ticks(1)
        + damaged(Kind.DRIVE, pack_drive(90), where=9, bits=0) + ticks(1),
        "on_the_wire": raw(on_the_wire) + ticks(2) + raw(on_the_wire[:20] + on_the_wire) + ticks(2),
        "too_long": raw(b"\x41" * 70 + b"\0" + on_the_wire) + ticks(1),
    }  # fmt: skip
    twelve = SETUP._replace(hard_lo=400, hard_hi=3600, rail_lo=20, rail_hi=4075, centre=2048)
    fine = SETUP._replace(max_drive=32767)
    wide = SETUP._replace(rail_lo=0, rail_hi=2**31 - 1)
    far = wide._replace(hard_lo=10**9 - 50000, hard_hi=10**9 + 50000)
    about = wide._replace(hard_lo=6 * 10**7 - 40000, hard_hi=6 * 10**7 + 40000)
    limited = SETUP._replace(hard_lo=-900, hard_hi=900, rail_lo=0, rail_hi=0, centre=0)
    endless = limited._replace(hard_lo=ALL_COUNTS[0], hard_hi=ALL_COUNTS[1])
    on_boards = {
        "wide": (
            WIDE,
            reading(10**9)
            + armed(far)
            + drive(100)
            + reading(10**9 + 50001)
            + ticks(2)
            + ALL_SEEN
            + ARM
            + drive(-50)
            + reading(10**9 + 40000)
            + ticks(2)
            + relay(RELAY._replace(centre=0))
            + STOP,
        ),
        "far_relay": (
            WIDE,
            reading(6 * 10**7)
            + armed(about)
            + relay(RELAY._replace(centre=96 * 10**7))
            + ticks(3)
            + reading(6 * 10**7 + 39000)
            + ticks(3)
            + reading(6 * 10**7 - 30000)
            + ticks(3)
            + KEEP
            + STOP,
        ),
        "far_strokes": (
            WIDE,
            reading(10**9)
            + armed(far)
            + strokes(STROKES._replace(strokes=((120, 10**9 + 40000), (-150, 10**9 - 40000)), still_counts=65535))
            + to_and_fro(2, 10**9 - 41000, 10**9 + 41000)
            + STOP,
        ),
        "counted": (
            ENCODER,
            counted(limited)
            + drive(100)
            + ticks(3)
            + reading(901)
            + ticks(2)
            + ALL_SEEN
            + ARM
            + drive(-50)
            + reading(-400)
            + ticks(2)
            + strokes(STROKES._replace(strokes=((120, 300), (-150, -850))))
            + to_and_fro(3, -870, 320)
            + STOP,
        ),
        "counted_without_a_zero": (
            ENCODER,
            frame(Kind.SETUP, limited.pack())
            + ack(Code.RESET)
            + ARM
            + drive(50)
            + ticks(1)
            + zero(-300)
            + ARM
            + drive(50)
            + zero(100)
            + ticks(2)
            + board(reset=True)
            + ack(Code.RESET)
            + frame(Kind.SETUP, limited.pack())
            + READ
            + ARM
            + drive(50)
            + ticks(1),
        ),
        "counted_troubles": (
            ENCODER,
            counted(limited)
            + b"".join(
                drive(60) + board(troubles=bits) + ticks(2) + READ + ENCODER_SEEN + ARM + zero(9) + ARM
                for bits in (1, 2, 4, 7)
            )
            + STOP
            + b"".join(
                board(troubles=bits) + ticks(1) + READ + zero() + ENCODER_SEEN + ARM + drive(50) + zero()
                for bits in (4, 1, 2)
            )
            + ARM
            + strokes(STROKES._replace(strokes=((120, 300), (-150, -300))))
            + ticks(2)
            + board(troubles=1)
            + ticks(1)
            + READ,
        ),
        "counted_homing": (
            ENCODER,
            frame(Kind.SETUP, endless._replace(homing=1).pack())
            + frame(Kind.SETUP, limited._replace(homing=2).pack())
            + zero()
            + frame(Kind.SETUP, limited._replace(homing=1).pack())
            + READ
            + ack(Code.RESET)
            + ARM
            + relay(RELAY._replace(centre=0))
            + strokes(STROKES._replace(strokes=((120, 300), (-150, -300))))
            + drive(60)
            + ticks(2)
            + contacts(END_HIGH)
            + ticks(1)
            + zero(700)
            + ALL_SEEN
            + frame(Kind.SETUP, limited.pack())
            + ARM
            + drive(-50)
            + ticks(2),
        ),
        "counted_endless": (
            ENCODER,
            counted(endless)
            + drive(60)
            + ticks(1)
            + contacts(ESTOP)
            + ticks(1)
            + contacts(0)
            + ALL_SEEN
            + ARM
            + drive(100)
            + reading(2**31 - 1)
            + ticks(2)
            + reading(2**31)
            + ticks(2)
            + READ
            + drive(0)
            + relay(RELAY._replace(centre=0))
            + STOP
            + zero(5 * 10**7)
            + ARM
            + relay(RELAY._replace(centre=80 * 10**7))
            + ticks(3)
            + reading(5 * 10**7 + 2**20 - 1)
            + ticks(2)
            + reading(5 * 10**7 + 2**20)
            + ticks(2)
            + READ,
        ),
        "counted_zero_at_the_other_switch": (
            ENCODER,
            contacts(END_LOW)
            + frame(Kind.SETUP, limited.pack())
            + ack(Code.RESET)
            + zero(limited.hard_hi + 50)
            + ticks(1),
        ),
        "counted_endless_strokes": (
            ENCODER,
            contacts(ESTOP)
            + ticks(1)
            + contacts(0)
            + ALL_SEEN
            + counted(endless)
            + strokes(STROKES._replace(strokes=((120, 2**20), (-150, 0))))
            + strokes(STROKES._replace(strokes=((120, 0), (-150, -(2**20)))))
            + strokes(STROKES._replace(strokes=((120, 2**31 - 1), (-150, -(2**31)))))
            + drive(0)
            + strokes(STROKES._replace(strokes=((120, 2**20 - 1), (-150, -400))))
            + to_and_fro(2, -500, 2**20 - 1)
            + reading(2**20)
            + ticks(2)
            + READ
            + ALL_SEEN
            + ARM
            + strokes(STROKES._replace(strokes=((120, 400), (-150, -400)))),
        ),
        "no_contacts": (NO_CONTACTS, armed() + contacts(ESTOP) + drive(100) + ticks(3)),
        "twelve_bits": (TWELVE_BITS, armed(twelve) + drive(100) + reading(3601) + ticks(2)),
        "clock_wraps": (BEFORE_WRAP, armed() + ticks(10) + drive(100) + ticks(15) + drive(90) + ticks(25)),
        "lagging": (LAGGING, armed() + drive(100) + wait(704) + ticks(25)),
        "fine_drive": (FINE_DRIVE, armed(fine) + drive(-32767) + ticks(1) + drive(-32768) + ticks(1)),
    }
    plain = {name: (0, script) for name, script in scripts.items()}
    return {name: bytes([BOARD + change]) + script for name, (change, script) in (plain | on_boards).items()}


def frames_corpus() -> dict[str, bytes]:
    """Bytes on the wire, and contents behind two bytes that say where the encoded frame is damaged and how."""
    setup, relay_frame = encode(Kind.SETUP, 1, SETUP.pack()), encode(Kind.RELAY, 9, RELAY.pack())
    longest = encode(0x55, 1, b"\x55" * 58)
    return {
        "read": encode(Kind.READ, 1),
        "run_in": setup + encode(Kind.ARM, 2) + encode(Kind.DRIVE, 3, pack_drive(-120)) + encode(Kind.READ, 4),
        "relay": b"\0" + relay_frame + encode(Kind.KEEP, 10),
        "strokes": encode(Kind.STROKES, 11, STROKES.pack()) + encode(Kind.KEEP, 12),
        "cut": setup[9:] + setup[:7] + setup,
        "longest": longest + longest[:-1] + b"\x41\0" + b"\x41" * 70 + b"\0" + setup,
        "past_end": b"\x09\x01\x02\0" + b"\x04\x01\x04\x03\0" + encode(Kind.READ, 1),
        "content": b"\x03\x10" + content(Kind.SETUP, SETUP.pack()),
        "zeros": b"\x02\x01" + b"\0" * 62,
    }


def write(folder: Path) -> None:
    """Write both, and remove files that are no longer of them."""
    for name, files in (("core", core_corpus()), ("frames", frames_corpus())):
        (folder / name).mkdir(parents=True, exist_ok=True)
        for old in (folder / name).iterdir():
            if old.name not in files:
                old.unlink()
        for file, data in files.items():
            (folder / name / file).write_bytes(data)


if __name__ == "__main__":
    write(Path(sys.argv[1]) if len(sys.argv) > 1 else CORPUS)
