"""Builds the C library of the motor's physics into a wheel of rig, and if that is asked for the boards' firmware.

hatchling runs it for each wheel. The library takes a second of any C compiler; where there is none, the package ziglang
brings one, as a requirement of the build. The firmware of every variant, of Uno and Pico, is built only with
RIG_FIRMWARE=required, as `make wheel` and `make dist` have it. Then both compilers, and uPlot, which draws the panel's
curves, have to be there. Else an installation is quick, and `rig flash` compiles what it flashes.
"""

from __future__ import annotations

import importlib.util
import os
import shutil
import subprocess
import sysconfig
import tempfile
from pathlib import Path
from types import ModuleType
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface

TOOLS = ("make", "cc", "avr-gcc", "avr-objcopy", "arm-none-eabi-gcc", "arm-none-eabi-objcopy", "sha256sum")
UPLOT = "rig/panel/static/vendor/uPlot.esm.js"
PACKAGES = "make gcc gcc-avr avr-libc binutils-avr gcc-arm-none-eabi binutils-arm-none-eabi"


class FirmwareHook(BuildHookInterface):  # type: ignore[type-arg]
    """Adds the library, and ``rig/_firmware/prebuilt``: the .hex and .uf2 files and SHA256SUMS."""

    PLUGIN_NAME = "custom"

    def dependencies(self) -> list[str]:
        """What this build needs besides: a C compiler, where this machine has none."""
        return [] if self._library_build().compiler() else ["ziglang>=0.13"]

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Build the library, and the variants if that is asked for. In a clone rig builds the library itself."""
        if version == "editable":
            return
        self.folder = Path(tempfile.mkdtemp(prefix="rig-firmware-"))
        build = self._library_build()
        sources = build.sources_in(Path(self.root) / "firmware" / "motor")
        build.compile_library(sources, self.folder / build.NAME)
        build_data["force_include"][str(self.folder / build.NAME)] = f"rig/model/{build.NAME}"
        build_data["pure_python"] = False
        # the library knows no Python: one wheel of a platform is for each of its versions
        build_data["tag"] = f"py3-none-{sysconfig.get_platform().replace('-', '_').replace('.', '_')}"
        if os.environ.get("RIG_FIRMWARE") == "required":
            self._add_firmware(build_data)

    def _library_build(self) -> ModuleType:
        place = Path(self.root) / "rig" / "model" / "library_build.py"
        spec = importlib.util.spec_from_file_location("library_build", place)
        assert spec is not None and spec.loader is not None
        module = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(module)
        return module

    def _add_firmware(self, build_data: dict[str, Any]) -> None:
        if not (Path(self.root) / UPLOT).is_file():
            raise RuntimeError(f"{UPLOT} missing: the panel of this wheel would draw no curves; run tools/uplot.sh")
        missing = [tool for tool in TOOLS if shutil.which(tool) is None]
        if missing:
            raise RuntimeError(
                f"{', '.join(missing)} missing, to build the firmware with; Debian: apt-get install {PACKAGES}"
            )
        # a make that runs this build has flags and a job server of its own
        environment = {key: value for key, value in os.environ.items() if not key.startswith(("MAKE", "MFLAGS"))}
        command = ["make", "-s", f"-j{os.cpu_count() or 1}", "-C", str(Path(self.root) / "firmware"), "prebuilt"]
        subprocess.run([*command, f"BUILD={self.folder}"], check=True, env=environment)
        build_data["force_include"][str(self.folder / "prebuilt")] = "rig/_firmware/prebuilt"

    def finalize(self, version: str, build_data: dict[str, Any], artifact_path: str) -> None:
        """Remove what was built: the wheel has it."""
        if hasattr(self, "folder"):
            shutil.rmtree(self.folder)
