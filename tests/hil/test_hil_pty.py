"""The emulated board as a process, in real time. Nothing here asserts how long anything takes."""

from __future__ import annotations

import itertools
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from processes import PATIENCE_S, alive, rows, wait_until

from rig.backends.emulated.errors import EmulationError
from rig.backends.links.serial_port import SerialPort
from rig.backends.serial.emulated import firmware_build
from rig.backends.serial.emulated.serial_board import HostBoard
from rig.backends.serial.frames import Code, FrameReader, Hello, Kind, Packet, Setup, encode, pack_ack, pack_arm
from rig.config.schema import Emulated, EmulatedMotor

pytestmark = pytest.mark.realtime

EMULATED = Emulated(motor=EmulatedMotor(tau_s=0.17, K_rad_s_V=6.5, fc_plus_V=5.0, fc_minus_V=5.0))
SESSION = 99
SETUP = Setup(SESSION, 49, 975, 5, 1018, 512, 200, 1000, 1)


def arming(setup: Setup = SETUP) -> bytes:
    """What a host sends to a device that was just switched on."""
    reset, arm = encode(Kind.ACK, 2, pack_ack(Code.RESET)), encode(Kind.ARM, 3, pack_arm(SESSION))
    return encode(Kind.SETUP, 1, setup.pack()) + reset + arm


# A host that arms, drives for as long as it lives, and says when it does.
HOST = """
import sys, time
from rig.backends.serial.frames import Kind, encode, pack_drive
from rig.backends.links.serial_port import SerialPort
port = SerialPort(sys.argv[1])
port.write({arming})
for k in range(10**6):
    port.write(encode(Kind.DRIVE, 3, pack_drive(100)))
    port.read(0.0)
    if k == 20:
        print("driving", flush=True)
    time.sleep(0.005)
"""

# The same host, which has started its board itself.
PARENT = (
    """
import sys
from pathlib import Path
from rig.backends.serial.emulated.serial_board import HostBoard
from rig.config.schema import Emulated
board = HostBoard()
sys.argv[1] = board.start(Emulated.model_validate({emulated}), 1, trace=Path(sys.argv[1]))
print(board.pid, flush=True)
"""
    + HOST
)


def ask(port: SerialPort, kind: Kind) -> Packet:
    reader = FrameReader()
    until_s = time.monotonic() + PATIENCE_S
    while time.monotonic() < until_s:
        port.write(encode(kind, 99))
        for packet in reader.feed(port.read(0.2)):
            if packet.seq == 99:
                return packet
    raise AssertionError("no reply")


def run_host(script: str, argument: str, watchdog_ms: int) -> subprocess.Popen[str]:
    text = script.format(arming=arming(SETUP._replace(watchdog_ms=watchdog_ms)), emulated=EMULATED.model_dump())
    return subprocess.Popen([sys.executable, "-c", text, argument], stdout=subprocess.PIPE, text=True)


def test_a_killed_host_leaves_0_V_and_a_board_that_still_answers(tmp_path: Path) -> None:
    trace, link = tmp_path / "trace.csv", tmp_path / "port"
    with HostBoard() as board:
        port_name = board.start(EMULATED, 1, link=link, trace=trace)
        assert str(link.readlink()) == port_name
        host = run_host(HOST, str(link), 1000)
        assert host.stdout is not None
        with host.stdout:
            assert host.stdout.readline() == "driving\n"
            wait_until(lambda: any(row["drive_V"] > 0.0 for row in rows(trace)))
            host.kill()
            killed_s = time.monotonic()
            host.wait()
        wait_until(lambda: rows(trace)[-1]["drive_V"] == 0.0)
        end = next(row for row in rows(trace) if row["t_s"] > killed_s and row["drive_V"] == 0.0)
        assert end["fault"] == 5.0  # the watchdog, and nothing else

        for _ in range(3):  # open and close as often as one likes
            port = SerialPort(str(link))
            hello = Hello.unpack(ask(port, Kind.HELLO).body)
            assert hello.board == 1 and hello.drive_full == 799
            port.close()
        times = [row["t_s"] for row in rows(trace)]
        assert times == sorted(times)
        pid = board.pid
    assert not alive(pid)
    assert not link.is_symlink()


def test_a_killed_parent_takes_its_board_with_it(tmp_path: Path) -> None:
    trace = tmp_path / "trace.csv"
    parent = run_host(PARENT, str(trace), 200)
    assert parent.stdout is not None
    with parent.stdout:
        pid = int(parent.stdout.readline())
        assert parent.stdout.readline() == "driving\n"
        assert alive(pid)
        parent.kill()
        parent.wait()
    # its last row is the power cut: all that is latched then is a reset (the process itself may linger until reaped)
    wait_until(lambda: any(row["fault"] == 5.0 for row in rows(trace)) and rows(trace)[-1]["fault"] == 14.0)
    seen = rows(trace)
    assert seen[-1]["drive_V"] == 0.0
    last_driven = max(k for k, row in enumerate(seen) if row["drive_V"] != 0.0)
    assert (seen[last_driven + 1]["drive_V"], seen[last_driven + 1]["fault"]) == (0.0, 5.0)  # the watchdog first


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_ends_it_with_0_V_in_the_trace(tmp_path: Path, number: signal.Signals) -> None:
    trace, link = tmp_path / "trace.csv", tmp_path / "port"
    board = HostBoard()
    port = SerialPort(board.start(EMULATED, 1, link=link, trace=trace))
    port.write(arming())
    port.write(encode(Kind.DRIVE, 3, b"\x64\x00"))
    wait_until(lambda: any(row["drive_V"] > 0.0 for row in rows(trace)))
    os.kill(board.pid, number)
    pid = board.pid
    wait_until(lambda: not link.is_symlink())
    board.stop()
    port.close()
    assert not alive(pid)
    assert rows(trace)[-1]["drive_V"] == 0.0


def test_ticks_of_a_stall_of_its_process_are_made_up_for_each_at_its_time(tmp_path: Path) -> None:
    trace = tmp_path / "trace.csv"
    with HostBoard() as board:
        board.start(EMULATED, 1, trace=trace)
        wait_until(lambda: len(rows(trace)) > 5)
        os.kill(board.pid, signal.SIGSTOP)
        before = len(rows(trace))
        time.sleep(0.4)
        os.kill(board.pid, signal.SIGCONT)
        wait_until(lambda: len(rows(trace)) > before + 20)
        times = [row["t_s"] for row in rows(trace)]
    gaps = [later - earlier for earlier, later in itertools.pairwise(times[3:])]
    assert gaps == pytest.approx([0.01] * len(gaps), abs=1e-5)


def test_what_is_not_possible_is_said(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("mine")
    board = HostBoard()
    with pytest.raises(EmulationError, match="not a symbolic link"):
        board.start(EMULATED, 1, link=tmp_path / "file")
    assert (tmp_path / "file").read_text() == "mine"
    with pytest.raises(EmulationError, match="start-rad"):
        board.start(EMULATED.model_copy(update={"motor": EMULATED.motor.model_copy(update={"start_rad": 9.0})}), 1)
    board.stop()


def test_a_missing_compiler_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CC", "no-such-compiler")
    with pytest.raises(EmulationError, match="`no-such-compiler` is missing"):
        HostBoard().start(EMULATED, 1)


def test_a_build_that_fails_is_said(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("CFLAGS", "-DFRAME_PACKET_MAX=oops")
    with pytest.raises(EmulationError, match=r"(?s)failed: .*redefined"):
        firmware_build.build(tmp_path)
