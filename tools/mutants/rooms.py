"""The rooms that are changed at random, and the survivors that no test can tell from the code."""

from __future__ import annotations

from mutants.sampled import Room

SEED = "rig 11"

_REPLAY = ("tests/replay",)
_MODBUS = ("tests/backends/modbus/test_modbus_driver.py", "tests/backends/modbus/test_modbus_tcp.py")
_CLOCK = ("tests/loop/test_loop_real_time.py", "tests/loop/test_loop_runner.py")
_FILES = ("tests/recording/test_recording_recorder.py", "tests/recording/test_recording_failing_disk.py")

ROOMS = (
    Room(
        "rig/control",
        24,
        ("tests/control", "tests/loop"),
        {
            "law": ("tests/control/test_control_law.py", "tests/api/test_api_law.py"),
            "leased_jog": ("tests/control/test_control_leased_jog.py",),
        },
    ),
    Room(
        "rig/control/loop",
        12,
        ("tests/loop", "tests/replay", "tests/hil/test_hil_device_relay.py"),
        {
            "recorded": _REPLAY,
            "replayed_rows": _REPLAY,
            "device_relay": ("tests/hil/test_hil_device_relay.py",),
            "statistics": ("tests/loop/test_loop_runner.py",),
            "stop_request": ("tests/loop/test_loop_runner.py",),
        },
    ),
    Room(
        "rig/backends",
        2,
        ("tests/backends",),
        {"driver": ("tests/backends/test_backends_plug_in.py",), "clock": _CLOCK},
    ),
    Room(
        "rig/backends/links",
        3,
        ("tests/backends", "tests/backends/modbus/test_modbus_tcp.py", "tests/backends/serial/test_serial_usb.py"),
        {
            "serial_port": ("tests/backends/test_backends_serial_port.py",),
            "usb_port": ("tests/backends/test_backends_serial_port.py",),
            "tcp_link": ("tests/backends/modbus/test_modbus_tcp.py",),
            "usb_adapters": ("tests/backends/serial/test_serial_usb.py",),
        },
    ),
    Room(
        "rig/backends/serial",
        7,
        ("tests/backends/serial", "tests/hil/test_hil_device_relay.py", "tests/hil/test_hil_driver.py"),
        {
            "law_run": ("tests/hil/test_hil_device_relay.py",),
            "firmware_laws": ("tests/hil/test_hil_device_relay.py",),
            **dict.fromkeys(("introduction", "exchange", "fit"), ("tests/backends/serial/test_serial_driver.py",)),
        },
    ),
    Room(
        "rig/backends/modbus",
        5,
        ("tests/backends/modbus", "tests/config/test_config_modbus.py"),
        dict.fromkeys(("driver", "client", "requests", "frames"), _MODBUS),
    ),
    Room(
        "rig/backends/registers",
        5,
        ("tests/backends/modbus", "tests/config/test_config_modbus.py"),
        dict.fromkeys(("driver", "bus"), _MODBUS),
    ),
    Room(
        "rig/backends/simulated",
        1,
        ("tests/loop",),
        {"driver": ("tests/loop/test_loop_runner.py", "tests/loop/test_loop_order.py")},
    ),
    Room(
        "rig/run_folder/recording",
        10,
        ("tests/recording",),
        {"writer": _FILES, "layout": _FILES, "sample_columns": _FILES},
    ),
)

# name of a mutant: why what it does is what the code does
EQUIVALENT: dict[str, str] = {
    "backends/registers/driver.py: _INTRODUCTIONS = 20 # reads that measure the round trip -> _INTRODUCTIONS = 21 # "
    "reads that measure the round trip": "the fastest of the reads counts; nobody is promised how many there are",
    "control/motion.py Standstill.restart: self.high_rad = -math.inf -> self.high_rad = not math.inf": (
        "the first step sets both ends of the span to its reading, whatever they were, and the stand that it may end "
        "is of a time that is no number"
    ),
    "control/observer.py MotorObserver._correct: if len(self._gain[0]) == 2 and not math.isnan(sample.v_rad_per_s): -> "
    "if len(self._gain[ 1]) == 2 and not math.isnan(sample.v_rad_per_s):": "rows of a matrix are of one length",
    "loop/real_time.py real_time: libc.prctl(_PR_SET_TIMERSLACK, ctypes.c_ulong(1), 0, 0, 0) -> "
    "libc.prctl(_PR_SET_TIMERSLACK, ctypes.c_ulong(1), 0, 1, 0)": "Linux looks at the first argument of this one alone",
    'loop/runner.py Loop.__init__: self._longest_latency_s = period_s * (2.0 if driver.order == "write_first" else '
    '1.0) -> self._longest_latency_s = period_s * (2.0 if driver.order >= "write_first" else 1.0)': (
        "there are two orders, and the other one comes before it in the alphabet"
    ),
}
