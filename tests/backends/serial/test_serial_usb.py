"""USB adapters: what the emulated ones do with bytes; the sums of `rig check` bound what a link behind them shows."""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple, get_args

import pytest
import yaml
from command_line import rig
from simulated_bench import DEMO, LIMITS, SCALING

from emulated_chips.virtual_chip import VirtualChip
from rig.backends.driver import Timeouts
from rig.backends.links.usb_adapters import CHIPS, FRAME_S, Adapter, adapter_by_id, adapter_by_name
from rig.backends.registry import connect, emulated_board
from rig.backends.serial.driver import SerialDriver
from rig.backends.serial.emulated.behind_usb import BehindUsb, UsbChip
from rig.backends.serial.emulated.firmware_build import Variant
from rig.backends.serial.emulated.virtual_board import VirtualBoard
from rig.backends.serial.link_budget import reading_budget, sample_to_drive_s, tick_budget
from rig.config import Experiment
from rig.core.faults import Fault

ROOT = Path(__file__).resolve().parents[3]
CLOCK_PPM = 4000.0


def config(**daq: object) -> dict[str, Any]:
    document: dict[str, Any] = yaml.safe_load((ROOT / "config/demo.yaml").read_text(encoding="utf-8"))
    document["daq"] |= daq
    document["drive"]["bridge"] = "pwm-dir"  # a port of this machine may have a motor behind it
    document["limits"]["max_speed_rad_s"] = 4.5  # room for what an adapter adds to the stopping distance
    return document


def written(document: dict[str, Any], folder: Path) -> Path:
    path = folder / "changed.yaml"
    path.write_text(yaml.safe_dump(document), encoding="utf-8")
    return path


# ---------------------------------------------------------------------- the chips


def arrivals(adapter: Adapter, bytes_at_s: list[float]) -> list[tuple[float, int]]:
    """When how many bytes have reached the host, of single ones at these times."""
    chip, out, coming = UsbChip(adapter), [], list(bytes_at_s)
    while coming or chip.next_s() < 1.0:
        t_s = min(chip.next_s(), coming[0] if coming else 1.0)
        while coming and coming[0] <= t_s:
            chip.from_device(b"x", coming.pop(0))
        if data := chip.for_host(t_s):
            out.append((t_s, len(data)))
    return out


@pytest.mark.parametrize(
    ("adapter", "at_s"),
    [
        ("16u2", [0.005, 0.013]),  # at 4.096 and 12.288 ms, and then the next frame
        ("ftdi", [0.016, 0.032]),  # an empty packet at 16 ms of the second's wait is one, too
        ("ftdi-1ms", [0.001, 0.01]),
        ("ch340", [0.002, 0.011]),
        ("cp210x", [0.002, 0.011]),
        ("native-usb", [0.001, 0.01]),
    ],
)
def test_a_short_reply_waits_for_the_chips_timer_and_the_frame(adapter: Adapter, at_s: list[float]) -> None:
    first, second = [0.0003, 0.0004], [0.0092, 0.0093]
    if adapter == "ftdi":
        second = [0.0192, 0.0193]
    expected: list[tuple[object, int]] = [(pytest.approx(t), 2) for t in at_s]
    assert arrivals(adapter, first + second) == expected


@pytest.mark.parametrize("adapter", CHIPS)
def test_a_full_packet_does_not_wait(adapter: Adapter) -> None:
    full = CHIPS[adapter].packet_bytes
    chip = UsbChip(adapter)
    chip.from_device(b"x" * full, 0.0001)
    assert chip.for_host(FRAME_S) == b"x" * full


@pytest.mark.parametrize("adapter", CHIPS)
def test_what_the_host_sends_goes_with_the_next_frame(adapter: Adapter) -> None:
    chip = UsbChip(adapter)
    chip.from_host(b"ab", 0.0021)
    assert chip.for_device(0.0029) == b""
    assert chip.next_s() == pytest.approx(0.003)
    assert chip.for_device(0.0031) == b"ab"


def test_every_adapter_of_the_config_is_in_the_table() -> None:
    assert {*CHIPS, "none"} == set(get_args(Adapter))


@pytest.mark.parametrize(
    ("port", "adapter"),
    [
        ("/dev/serial/by-id/usb-FTDI_FT232R_USB_UART_A50285BI-if00-port0", "ftdi"),
        ("/dev/serial/by-id/usb-1a86_USB_Serial-if00-port0", "ch340"),
        ("/dev/serial/by-id/usb-Silicon_Labs_CP2102_USB_to_UART_Bridge_Controller_0001-if00-port0", "cp210x"),
        ("/dev/serial/by-id/usb-Arduino__www.arduino.cc__0043_7543-if00", "16u2"),
        ("/dev/ttyACM0", "16u2"),
        ("/dev/ttyS0", "none"),
        ("/dev/ttyAMA10", "none"),
        # what people call a link says nothing of what it leads to
        ("/dev/arduino", "ftdi"),
        ("/dev/ttysrig", "ftdi"),
        ("/dev/ttyS", "ftdi"),
        ("/dev/ttyACM-left", "ftdi"),
        ("/dev/my-ttyACM0", "ftdi"),
        ("/home/arduino/port", "ftdi"),
        ("/tmp/usb-Arduino__www.arduino.cc__0043_7543-if00", "ftdi"),
        ("/dev/serial/by-id/usb-Acme_for_Arduino-if00", "ftdi"),
        ("/dev/serial/by-id/ttyACM0", "ftdi"),
        ("/dev/ttyUSB0", "ftdi"),
        ("COM3", "ftdi"),
    ],
)
def test_by_the_ports_name_the_slowest_that_it_can_be(port: str, adapter: Adapter) -> None:
    assert adapter_by_name(port) == adapter


def test_an_ftdi_chip_packs_what_usb_takes_less_its_two_bytes_of_status_whatever_its_timer() -> None:
    slow, quick = CHIPS["ftdi"], CHIPS["ftdi-1ms"]
    assert slow.packet_bytes == 64 - 2
    assert quick == slow._replace(words=quick.words, wait_s=0.001)


@pytest.mark.parametrize(
    ("vendor", "product"),
    [(0x2341, 0x8036), (0x2341, 0x8037), (0x2A03, 0x8036), (0x2A03, 0x8037), (0x16C0, 0x0483), (0x2E8A, 0x000A)],
)
def test_a_leonardo_a_micro_a_teensy_and_a_pico_have_usb_of_their_own(vendor: int, product: int) -> None:
    assert adapter_by_id(vendor, product) == "native-usb"


def test_usb_ids_that_say_nothing() -> None:
    assert adapter_by_id(None, None) is None
    assert adapter_by_id(0x1D50, 0x6001) is None


# ---------------------------------------------------------------------- a link behind one


class Seen(NamedTuple):
    """The longest reading and the longest time from a sample to its drive, s; what was counted; the clock's errors."""

    reading_s: float
    delay_s: float
    statistics: dict[str, int]
    offset_s: float
    rate: float


def seen_behind(adapter: Adapter, baud: int, period_s: float, ticks: int = 150, start_s: float = 0.0) -> Seen:
    """The host board with wire and adapter in virtual time, read and driven for so many ticks."""
    board = VirtualBoard(DEMO, 1, clock_error_ppm=CLOCK_PPM, baud=baud)
    link = board if adapter == "none" else BehindUsb(board, adapter)
    link.sleep_until(start_s)
    driver = SerialDriver(link, SCALING, Timeouts(0.06))
    ratio = driver.open().clock_ratio
    now_s = board.now_s()
    offset_s = driver._clock.to_host_s(round(1e6 * now_s * (1.0 + 1e-6 * CLOCK_PPM)), now_s) - now_s
    driver.arm(LIMITS)
    readings, delays, due_s, sampled_s = [], [], link.now_s(), None
    for tick in range(ticks):
        due_s += period_s
        link.sleep_until(due_s)
        began_s = link.now_s()
        sample = driver.read()
        readings.append(link.now_s() - began_s)
        if sampled_s is not None:
            delays.append(sample.t_u_s - sampled_s)
        driver.write(0.1 * (tick % 2))
        sampled_s = sample.t_s
    rate = ratio / (1.0 + 1e-6 * CLOCK_PPM) - 1.0
    return Seen(max(readings), max(delays), dict(driver.link_statistics), offset_s, rate)


# each chip at one of the two baud rates
EACH_ADAPTER = [
    pytest.param(adapter, baud, marks=[pytest.mark.evidence] if (k + m) % 2 else [])
    for k, adapter in enumerate((*CHIPS, "none"))
    for m, baud in enumerate((115200, 1_000_000))
]


@pytest.mark.parametrize(("adapter", "baud"), EACH_ADAPTER)
def test_the_sums_of_rig_check_bound_what_the_link_shows(adapter: Adapter, baud: int) -> None:
    """At the shortest period that the sum allows: its phases to the chip's timer and to the frames are all met."""
    e = Experiment.model_validate(config(adapter=adapter, baud=baud))
    reading_s = reading_budget(e.device).total_s
    seen = seen_behind(adapter, baud, 1.00123 * tick_budget(e.device).total_s / 0.8)
    assert seen.reading_s <= reading_s
    unmet_s = 0.001 + (0.0 if adapter == "none" else 2.0 * FRAME_S)  # the device's tick and the frames, by their phase
    assert seen.reading_s > reading_s - unmet_s - 1e-4
    assert seen.delay_s <= sample_to_drive_s(e.device)
    counts = seen.statistics
    assert not any(counts[name] for name in ("timeouts", "asked_again", "stale_replies", "bad_frames", "drives_lost"))


@pytest.mark.parametrize(("adapter", "baud"), EACH_ADAPTER)
def test_the_clock_is_not_biased_by_the_wait(adapter: Adapter, baud: int) -> None:
    """A reply that waits for up to 18 ms: the device's clock is right to half a frame, its rate to 60 ppm."""
    for start_s in (0.0, 0.00911):
        seen = seen_behind(adapter, baud, 0.03, 2, start_s)
        assert abs(seen.offset_s) < 0.5 * FRAME_S
        assert abs(seen.rate) < 60e-6


def test_a_chip_behind_an_adapter_that_is_pulled_out_is_lost_while_time_goes_on() -> None:
    chip = VirtualChip(DEMO, options=Variant(baud=1_000_000))
    link = BehindUsb(chip, "16u2")
    link.sleep_until(0.1)
    chip.unplug()
    for action in (lambda: link.read(0.01), lambda: link.write(b"x")):
        with pytest.raises(Fault, match="LINK_LOST"):
            action()
    assert link.sleep_until(0.2) == pytest.approx(0.2)


# ---------------------------------------------------------------------- rig check, rig run


def checked(folder: Path, **daq: object) -> tuple[int, str]:
    done = rig("check", written(config(**daq), folder))
    return done.exit_code, " ".join(done.output.split())


def test_an_ftdi_at_16_ms_is_refused_at_10_ms_with_what_to_type(tmp_path: Path) -> None:
    code, text = checked(tmp_path, port="/dev/ttyUSB3", adapter="ftdi")
    assert code == 2
    assert "daq.adapter: too slow for the period" in text
    assert "+ 2 ms (USB frames) + 16 ms (ftdi adapter)" in text
    cure = "`echo 1 | sudo tee /sys/bus/usb-serial/devices/ttyUSB3/latency_timer`, and daq.adapter: ftdi-1ms"
    assert f"{cure}, and daq.baud 230400" in text
    assert "daq.timeout_s" not in text
    code, text = checked(tmp_path, port="/dev/ttyUSB3", adapter="ftdi", baud=230400)
    assert code == 2 and f"{cure}, or period_s" in text
    code, text = checked(tmp_path, port="/dev/ttyUSB3", adapter="ftdi-1ms", baud=230400)
    assert code == 0
    assert "+ 1 ms (ftdi-1ms adapter)" in text


def test_without_the_key_the_slowest_by_the_ports_name_is_reckoned_with(tmp_path: Path) -> None:
    code, text = checked(tmp_path, port="/dev/ttyUSB0")
    assert code == 2
    assert "ftdi adapter" in text and "set daq.adapter to what `rig doctor` finds there" in text
    code, text = checked(tmp_path, port="/dev/ttyACM0")
    assert code == 2
    assert "16u2 adapter" in text and "daq.baud 1000000 fits" in text
    code, text = checked(tmp_path, port="/dev/ttyACM0", baud=1_000_000)
    assert code == 0
    assert "note: daq.adapter is not given; from the port's name rig assumes the ATmega16U2" in text
    assert "USB adapter" in text.split("stopping")[1].split("link:")[0]
    code, text = checked(tmp_path, port="emulated")
    assert code == 0 and "adapter" not in text


def test_a_time_out_too_short_for_the_adapter_is_refused_with_a_quicker_one(tmp_path: Path) -> None:
    document = config(adapter="ftdi", watchdog_s=0.3)
    document |= {"period_s": 0.05}
    document["limits"]["max_speed_rad_s"] = 2.5
    document["relay"] = {"target": {"amplitude_rad": 0.3, "period_s": 2.0}}
    document["tracking"]["trajectory"] = [{"amplitude_rad": 0.5, "omega_rad_s": 1.5}]
    document["breakaway"] |= {"rest_s": 0.6}
    document["motor"] |= {"no_load_speed_rad_s": 20.0}
    document["daq"]["timeout_s"] = 0.03
    done = rig("check", written(document, tmp_path))
    text = " ".join(done.output.split())
    assert done.exit_code == 2
    assert "daq.timeout_s: 30 ms is too short for a reading" in text and "latency timer at 1 ms fits" in text
    document["daq"]["adapter"] = "ftdi-1ms"
    assert rig("check", written(document, tmp_path)).exit_code == 0


def test_the_key_is_of_serial_devices(tmp_path: Path) -> None:
    document: dict[str, Any] = yaml.safe_load((ROOT / "config/modbus-rtu.yaml").read_text(encoding="utf-8"))
    document["daq"]["adapter"] = "ftdi"
    done = rig("check", written(document, tmp_path))
    assert done.exit_code == 2
    assert "add its delay to daq.modbus.turnaround_s" in " ".join(done.output.split())


def test_an_emulated_port_delays_as_the_config_says(tmp_path: Path) -> None:
    """In virtual time, through `connect`: readings take longer than without by what the adapter may add."""
    longest = {}
    for adapter in ("none", "16u2"):
        experiment = Experiment.model_validate(config(port="emulated-chip", adapter=adapter, baud=1_000_000))
        with connect(experiment.device) as bench:
            times = []
            for _ in range(20):
                began_s = bench.clock.now_s()
                bench.driver.read()
                times.append(bench.clock.now_s() - began_s)
            longest[adapter] = max(times)
        assert longest[adapter] <= reading_budget(experiment.device).total_s
    assert longest["16u2"] > longest["none"] + 0.002


@pytest.mark.realtime
def test_in_real_time_the_adapter_is_before_the_device(tmp_path: Path) -> None:
    """It passes everything on, the link leads to it, and the device's reset button is there."""
    experiment = Experiment.model_validate(config(adapter="16u2"))
    link = tmp_path / "device"
    with emulated_board(experiment.device, link) as board:
        assert str(link.readlink()) == board.port
        behind = Experiment.model_validate(config(port=str(link), adapter="16u2", timeout_s=0.5, watchdog_s=1.0))
        with connect(behind.device) as bench:
            assert "emulated host board" in bench.driver.backend
            assert -2.0 < bench.driver.read().y_rad < 2.0
            assert bench.driver.link_statistics["bad_frames"] == 0
        board.reset()
        board.check()
    assert not link.exists()
