"""What the doctor says of a machine whose kernel's files are set up by hand."""

import shutil
from pathlib import Path
from types import SimpleNamespace

import pytest
from serial.tools import list_ports

from rig.backends.links.usb_adapters import CHIPS, Adapter, adapter_delay_s
from rig.running.doctor import machine


def put(root: Path, name: str, text: str) -> Path:
    file = root / name
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_text(text + "\n", encoding="utf-8")
    return file


def test_cores_that_slow_down_are_named_with_what_to_type(tmp_path: Path) -> None:
    for core, name in enumerate(("powersave", "powersave", "performance")):
        put(tmp_path, f"sys/devices/system/cpu/cpu{core}/cpufreq/scaling_governor", name)
    found = machine.governor(tmp_path)
    assert found.state == "poor"
    assert "performance on 1 cores, powersave on 2 cores" in found.words
    assert "scaling_governor" in found.cure


def test_performance_governor_and_none_at_all_are_good(tmp_path: Path) -> None:
    assert machine.governor(tmp_path).state == "good"
    put(tmp_path, "sys/devices/system/cpu/cpu0/cpufreq/scaling_governor", "performance")
    assert machine.governor(tmp_path).state == "good"


def test_ftdi_latency_of_16_ms_is_bad_and_the_cure_names_its_file(tmp_path: Path) -> None:
    file = put(tmp_path, "sys/bus/usb-serial/devices/ttyUSB0/latency_timer", "16")
    put(tmp_path, "sys/bus/usb-serial/devices/ttyUSB1/latency_timer", "1")
    slow, fast = machine.latency_timers(tmp_path)
    assert (slow.state, fast.state) == ("bad", "good")
    assert "ttyUSB0 waits 16 ms" in slow.words
    assert str(file) in slow.cure


def plugged_in(monkeypatch: pytest.MonkeyPatch, device: str, vid: int | None, pid: int | None) -> None:
    ports = [SimpleNamespace(device=device, vid=vid, pid=pid)]
    monkeypatch.setattr(list_ports, "comports", lambda: ports)


@pytest.mark.parametrize(
    ("ids", "timer", "adapter"),
    [
        ((0x2341, 0x0043), None, "16u2"),
        ((0x2A03, 0x0042), None, "16u2"),
        ((0x0403, 0x6001), "16", "ftdi"),
        ((0x0403, 0x6015), "4", "ftdi"),
        ((0x0403, 0x6001), "1", "ftdi-1ms"),
        ((0x0403, 0x6001), None, "ftdi"),
        ((0x1A86, 0x7523), None, "ch340"),
        ((0x10C4, 0xEA60), None, "cp210x"),
        ((0x2341, 0x8036), None, "native-usb"),
    ],
)
def test_an_adapter_is_told_by_its_usb_ids_and_the_config_held_to_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, ids: tuple[int, int], timer: str | None, adapter: Adapter
) -> None:
    plugged_in(monkeypatch, "/dev/ttyUSB0", *ids)
    if timer is not None:
        put(tmp_path, "sys/bus/usb-serial/devices/ttyUSB0/latency_timer", timer)
    without = machine.usb_adapter("/dev/ttyUSB0", None, tmp_path)
    assert without.words.endswith(f"daq.adapter: {adapter}")
    assert machine.usb_adapter("/dev/ttyUSB0", adapter, tmp_path).state == "good"
    for other in (*CHIPS, "none"):
        if other != adapter:
            found = machine.usb_adapter("/dev/ttyUSB0", other, tmp_path)
            slower = adapter_delay_s(adapter) > adapter_delay_s(other)
            assert found.state == ("bad" if slower else "poor")
            assert f"made with {other}" in found.words
            assert found.cure.startswith(f"daq.adapter: {adapter},")
    assert ("timer is at" in without.words) == (timer in ("16", "4"))


def test_an_adapter_by_the_name_that_survives_re_plugging(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    plugged_in(monkeypatch, "/dev/ttyUSB0", 0x1A86, 0x7523)
    (tmp_path / "by-id").mkdir()
    link = tmp_path / "by-id" / "usb-1a86_USB_Serial-if00-port0"
    link.symlink_to("/dev/ttyUSB0")
    assert machine.usb_adapter(str(link), "ch340").state == "good"


@pytest.mark.parametrize("ids", [(0x1234, 0x5678), (None, None)])
def test_an_adapter_that_is_not_known_is_a_note(monkeypatch: pytest.MonkeyPatch, ids: tuple[int | None, ...]) -> None:
    plugged_in(monkeypatch, "/dev/ttyUSB0", *ids)
    found = machine.usb_adapter("/dev/ttyUSB0", "ftdi")
    assert (found.state, found.cure) == ("note", "")
    assert found.words.endswith("daq.adapter: ftdi")
    assert machine.usb_adapter("/dev/ttyUSB7", None).state == "note", "it was pulled out"


def test_every_port_says_its_adapter_without_a_config(monkeypatch: pytest.MonkeyPatch) -> None:
    plugged_in(monkeypatch, "/dev/null", 0x10C4, 0xEA60)
    assert [f.topic for f in machine.serial_ports()] == ["serial port", "USB adapter"]


def test_no_usb_adapter_nothing_to_say(tmp_path: Path) -> None:
    assert list(machine.latency_timers(tmp_path)) == []


@pytest.mark.parametrize(("source", "state"), [("tsc", "good"), ("hpet", "poor"), ("acpi_pm", "poor")])
def test_slow_clocks(tmp_path: Path, source: str, state: str) -> None:
    put(tmp_path, "sys/devices/system/clocksource/clocksource0/current_clocksource", source)
    assert machine.clock_source(tmp_path).state == state


def test_modem_manager_is_found_by_its_process(tmp_path: Path) -> None:
    put(tmp_path, "proc/17/comm", "sshd")
    assert machine.modem_manager(tmp_path).state == "good"
    put(tmp_path, "proc/801/comm", "ModemManager")
    found = machine.modem_manager(tmp_path)
    assert found.state == "poor"
    assert "systemctl" in found.cure


def stat(worker: int, name: str, policy: int, priority: int) -> str:
    """/proc/PID/stat: 52 fields, of which 40 is the real-time priority and 41 the policy."""
    fields = ["S", *map(str, range(4, 40)), str(priority), str(policy), *["0"] * 11]
    fields[6] = str(0x00200000)  # PF_KTHREAD
    assert len(fields) == 50
    return f"{worker} ({name}) {' '.join(fields)}"


def test_workers_that_a_killed_run_left_raised_are_found_with_what_to_type(tmp_path: Path) -> None:
    for worker, policy in ((31, 1), (32, 0), (33, 1)):
        put(tmp_path, f"proc/{worker}/comm", "kworker/u8:1 (x)")
        put(tmp_path, f"proc/{worker}/stat", stat(worker, "kworker/u8:1 (x)", policy, 59 * policy))
    put(tmp_path, "proc/34/comm", "irq/9-acpi")
    put(tmp_path, "proc/34/stat", stat(34, "irq/9-acpi", 1, 50))
    found = machine.kernel_workers(tmp_path)
    assert found.state == "poor"
    assert found.words.startswith("2 of the kernel's workers have real-time priority, and no run that raised them")
    assert "chrt --other --pid 0" in found.cure
    put(tmp_path, "proc/77/cmdline", "python\0-I\0-S\0/x/rig/control/loop/kernel_workers.py\00059\0/proc")
    going_on = machine.kernel_workers(tmp_path)
    assert (going_on.state, going_on.cure) == ("note", "")
    for worker in (31, 33):
        put(tmp_path, f"proc/{worker}/stat", stat(worker, "kworker/u8:1 (x)", 0, 0))
    assert machine.kernel_workers(tmp_path).state == "good"


def test_a_virtual_machine_is_told_apart(tmp_path: Path) -> None:
    put(tmp_path, "proc/cpuinfo", "flags\t\t: fpu tsc hypervisor sse2")
    assert "virtual machine" in machine.cores(tmp_path).words


def test_fully_preemptible_kernel(tmp_path: Path) -> None:
    put(tmp_path, "sys/kernel/realtime", "1")
    found = machine.kernel(tmp_path)
    assert found.state == "good"
    assert "PREEMPT_RT" in found.words


def test_a_port_that_is_not_there(tmp_path: Path) -> None:
    found = machine.serial_port(tmp_path / "ttyACM9")
    assert found.state == "bad"
    assert "is not there" in found.words


def test_a_port_of_another_group_names_the_group(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    port = put(tmp_path, "dev/ttyACM0", "")
    monkeypatch.setattr("os.access", lambda *_: False)  # root may open everything
    for group in ("dialout", "root"):
        monkeypatch.setattr("grp.getgrgid", lambda _, group=group: SimpleNamespace(gr_name=group))
        found = machine.serial_port(port)
        assert found.state == "bad"
        assert ("sudo adduser $USER dialout" in found.cure) == (group == "dialout")
        assert ("udev rule" in found.cure and "adduser" not in found.cure) == (group == "root")


def test_a_full_disk_and_one_that_may_not_be_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert machine.disk(tmp_path / "runs" / "not-made-yet").state == "good"
    for free, state in ((10**8, "poor"), (10**6, "bad")):
        usage = shutil._ntuple_diskusage(10**9, 10**9 - free, free)
        monkeypatch.setattr(shutil, "disk_usage", lambda _, usage=usage: usage)
        assert machine.disk(tmp_path).state == state
    monkeypatch.setattr("os.access", lambda *_: False)
    assert machine.disk(tmp_path).state == "bad"
