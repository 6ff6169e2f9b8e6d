"""Flash the firmware into an Arduino Uno: find the port, run avrdude, explain its errors.

The Uno's boot loader (Optiboot) listens at 115200 baud, whatever the firmware speaks afterwards.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
import re
import shutil
import subprocess
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import NamedTuple

from serial.tools import list_ports

from rig.backends.links.serial_port import SerialPort
from rig.backends.serial.frames import BOARDS, FrameReader, Hello
from rig.backends.serial.introduction import await_introduction
from rig.core.errors import CauseError
from rig.core.faults import Fault
from rig.core.package import FOLDER, VERSION

# The chip between USB and the Uno's serial port; those of the Uno itself are in the Arduino IDE's boards.txt.
USB_CHIPS = {
    (0x2341, 0x0001): "Arduino Uno",
    (0x2341, 0x0043): "Arduino Uno",
    (0x2341, 0x0243): "Arduino Uno",
    (0x2341, 0x006A): "Arduino Uno",
    (0x2A03, 0x0043): "Arduino Uno",
    (0x1A86, 0x7523): "CH340, as on many clones",
    (0x0403, 0x6001): "FT232R, as on some clones",
    (0x10C4, 0xEA60): "CP2102, as on some clones",
}
ANSWER_S = 8.0  # for the boot loader, about 1.5 s, and the firmware's first answer
INTERRUPTED = 130  # exit status, as a shell has it

# What a voltmeter must show at 0 V drive: the wrong choice of the two can be full drive.
AT_REST = {
    "pwm-dir": "PWM (D9) must be at 0 V",
    "in1-in2": "IN1 (D9) and IN2 (D10) must be at 5 V; with a bridge that has PWM and DIR inputs this is full drive",
}

_BUSY = ("is held by another program", "end the other rig, serial monitor or modem manager: `fuser {port}` names it")
_ABSENT = ("is not there", "plug the board in; `ls /dev/serial/by-id/` lists the ports")
# Reasons for which a port cannot be opened, in the words of the C library.
_CANNOT_OPEN = {
    "No such file or directory": _ABSENT,
    "No such device": _ABSENT,
    "Permission denied": ("cannot be opened by this user", "`sudo adduser $USER dialout`, then log in again"),
    "Device or resource busy": _BUSY,
    "Resource temporarily unavailable": _BUSY,
}
# Complaints of avrdude, 6.3 to 7.1, in the order in which they tell most: pattern, cause, cure.
_COMPLAINTS = (
    (
        r"xpected signature",
        "the chip at {port} is no ATmega328P{signature}",
        "this firmware is for the ATmega328P of an Arduino Uno",
    ),
    (
        r"verification (error|mismatch)",
        "the board does not read back what was written",
        "leave the motor's supply off, and try again with another cable or USB port",
    ),
    (
        r"not in sync|out of sync|not responding|protocol error",
        "no boot loader answers at {port}: programmer not in sync",
        "is it an Uno, with nothing wired to D0 and D1? press its reset just when this starts, and try again",
    ),
    (
        r"input file|not readable|invalid record|no valid record|read from file",
        "avrdude cannot read the .hex: {last}",
        "leave --hex out: then rig builds it",
    ),
)
_LAST_WORDS = re.compile(r"^avrdude(?: OS)?(?: error)?: (?!.*TIOCM)(?!.*done\.  Thank you)(.*\S)\s*$", re.MULTILINE)
_SIGNATURE = re.compile(r"device signature = (0x[0-9a-f]+)", re.IGNORECASE)


PREBUILT = FOLDER / "_firmware" / "prebuilt"  # in an installed rig
# Boards whose real chip has kept the firmware's promises, and the report that says so (docs/loopback.md): none yet.
REAL_CHIP_REPORTS: dict[str, str] = {}
NEVER_RUN = "this firmware has never run on a real chip: take the first steps of docs/real-bench.md one by one"


class FlashError(CauseError):
    """What went wrong and what to do, a line each; ``status``: exit status, avrdude's own where that failed."""

    def __init__(self, cause: str, cure: str, status: int = 1) -> None:
        super().__init__(cause, cure)
        self.status = status


class Port(NamedTuple):
    """A serial port of this machine. vid, pid: of its USB chip; None where there is none."""

    device: str
    vid: int | None = None
    pid: int | None = None

    def __str__(self) -> str:
        if self.vid is None or self.pid is None:
            return self.device
        return f"{self.device} ({USB_CHIPS.get((self.vid, self.pid), 'unknown')}, {self.vid:04x}:{self.pid:04x})"


def serial_ports() -> list[Port]:
    """The serial ports of this machine."""
    return [Port(port.device, port.vid, port.pid) for port in list_ports.comports()]


def only_candidate(ports: Iterable[Port]) -> Port:
    """The only port where an Uno may be. Raises FlashError where there is none, or more than one."""
    on_usb = sorted(port for port in ports if port.vid is not None)
    candidates = [port for port in on_usb if (port.vid, port.pid) in USB_CHIPS]
    if len(candidates) == 1:
        return candidates[0]
    if candidates:
        raise FlashError(f"several boards: {', '.join(map(str, candidates))}", "name one: --port PORT")
    others = f", but {', '.join(map(str, on_usb))}" if on_usb else ""
    raise FlashError(
        f"no Arduino Uno on USB{others}", "plug it in, with a cable that has data wires, or name its port: --port PORT"
    )


class Prebuilt(NamedTuple):
    """A .hex or .uf2 that came with rig, and its hash, which has been checked."""

    path: Path
    sha256: str

    def __str__(self) -> str:
        return f"prebuilt firmware {self.path.name}, SHA-256 {self.sha256}"


def prebuilt(file: str, folder: Path | None = None) -> Prebuilt | None:
    """The firmware that came with rig; None where rig runs from its repository, or was built without.

    file    its name: the variant, and ".hex" or ".uf2"
    folder  where they are; default: in the installed package
    Raises FlashError if the file is not the one that was built with rig.
    """
    folder = PREBUILT if folder is None else folder
    sums, path = folder / "SHA256SUMS", folder / file
    if not sums.is_file():
        return None
    expected = {line.split()[1]: line.split()[0] for line in sums.read_text(encoding="ascii").splitlines()}
    content = path.read_bytes() if path.is_file() else b""
    digest = hashlib.sha256(content).hexdigest()
    if digest != expected.get(path.name):
        raise FlashError(f"{path} is damaged: its SHA-256 is {digest}", "install rig again")
    return Prebuilt(path, digest)


def check_build(hello: Hello, board: str) -> None:
    """Raise FlashError where the board answers with another firmware than this rig has just written to it."""
    written = f"{board} {VERSION}"
    if hello.build_text != written:
        raise FlashError(
            f"the board answers with build {hello.build_text}, and what was written is {written}",
            "leave the motor's supply off; press the board's reset and type this again",
        )


def find_avrdude() -> str | None:
    """Path of avrdude; None where it is missing."""
    return shutil.which("avrdude")


def no_avrdude() -> FlashError:
    """The error that avrdude is missing, and what to type."""
    return FlashError("`avrdude`, which writes to the board, is missing", "Debian: apt-get install avrdude")


def avrdude_command(avrdude: str, port: str, hex_file: Path) -> list[str]:
    """The command that writes the .hex to the Uno at ``port`` and reads it back."""
    # -D: this boot loader cannot erase the chip; it erases each page that it writes
    boot_loader = ["-c", "arduino", "-b", "115200", "-P", port]
    return [avrdude, "-p", "atmega328p", *boot_loader, "-D", "-U", f"flash:w:{hex_file}:i"]


@contextlib.contextmanager
def held(port: str) -> Iterator[int]:
    """Hold a port as rig does, for the block; its descriptor: who has that holds it, too.

    avrdude neither looks nor locks: another rig could open the port meanwhile, which restarts an Uno amid its program.
    Raises FlashError where the port cannot be opened, or a program holds it. Opening the port restarts an Uno.
    """
    try:
        import fcntl  # not everywhere
    except ImportError as error:
        raise FlashError("flashing works on Linux only", "`rig flash --dry-run` shows the command") from error
    with contextlib.ExitStack() as stack:
        try:
            handle = os.open(port, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
            stack.callback(os.close, handle)
            if not os.isatty(handle):
                raise FlashError(f"{port} is no serial port", "`ls /dev/serial/by-id/` lists the ports")
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            why = os.strerror(error.errno or 0)
            what, cure = _CANNOT_OPEN.get(why, (f"cannot be opened: {why}", "check the cable and the port's name"))
            raise FlashError(f"{port} {what}", cure.format(port=port)) from error
        yield handle


def write(command: list[str], port: str, show: Callable[[str], None], holds: int) -> None:
    """Run avrdude and pass its output on to ``show`` as it comes. With ``holds`` it holds the port, whatever ends rig.

    Raises FlashError, as ``failure`` has it, where avrdude fails: cause, cure and exit status (128 + n after signal n).
    """
    said: list[str] = []
    environment = os.environ | {"LC_ALL": "C"}
    with subprocess.Popen(
        command, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, env=environment,
        pass_fds=(holds,),
    ) as avrdude:  # fmt: skip
        assert avrdude.stdout is not None
        try:
            while chunk := os.read(avrdude.stdout.fileno(), 4096):
                said.append(chunk.decode("utf-8", "replace"))
                show(said[-1])
        except KeyboardInterrupt:
            avrdude.terminate()
            raise FlashError(
                "interrupted: the board may hold half a program",
                "leave the motor's supply off, and run this again",
                INTERRUPTED,
            ) from None
    if avrdude.returncode != 0:
        raise failure(avrdude.returncode if avrdude.returncode > 0 else 128 - avrdude.returncode, "".join(said), port)


def failure(status: int, said: str, port: str) -> FlashError:
    """The error for avrdude's exit status, which is not 0, and its output."""
    for line in said.splitlines():
        if "open" in line and (port in line or "device" in line):
            for reason, (what, cure) in _CANNOT_OPEN.items():
                if line.rstrip().endswith(reason):
                    return FlashError(f"{port} {what}", cure.format(port=port), status)
    words = _LAST_WORDS.findall(said)
    last = words[-1] if words else "it said nothing"
    seen = _SIGNATURE.search(said)
    signature = f": its signature is {seen[1]}" if seen else ""
    for pattern, cause, cure in _COMPLAINTS:
        if re.search(pattern, said):
            return FlashError(cause.format(port=port, signature=signature, last=last), cure, status)
    return FlashError(f"avrdude failed, status {status}: {last}", "its own words are above", status)


def meet(port: str, baud: int, timeout_s: float = ANSWER_S) -> Hello:
    """Open the port, which restarts an Uno, and wait until the firmware introduces itself.

    Raises FlashError where it does not, Fault LINK_* where the port fails or another protocol is spoken.
    """
    reader = FrameReader()
    with contextlib.closing(SerialPort(port, baud)) as transport:
        try:
            return await_introduction(transport, reader, timeout_s).hello
        except Fault as fault:
            if fault.code != "LINK_HELLO":
                raise
            heard = f"damaged frames ({reader.bad_frames})" if reader.bad_frames else "nothing"
            raise FlashError(
                f"written, but the board does not answer: {heard} at {port} in {timeout_s:g} s at {baud} baud",
                "with --hex, give the --baud that it was built for; press the board's reset; wire nothing to D0 and D1",
            ) from fault


def in_words(hello: Hello) -> str:
    """Board, build and reset cause, for people."""
    # Most boot loaders clear the chip's record of the reset before the firmware can read it.
    cause = hello.reset_words if hello.reset_cause else "unknown, cleared by the boot loader"
    return f"board {BOARDS.get(hello.board, hello.board)}, build {hello.build_text}, reset: {cause}"
