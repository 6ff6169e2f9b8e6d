"""Builds the firmware of every variant, of Uno and Pico, into a wheel of rig: `rig flash` needs no compiler there.

hatchling runs it for each wheel; it does so only with RIG_FIRMWARE=required, as `make wheel` and `make dist` have it.
Then both compilers, and uPlot, which draws the panel's curves, have to be there. Else an installation is quick, and
`rig flash` compiles what it flashes.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import tempfile
from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface

TOOLS = ("make", "cc", "avr-gcc", "avr-objcopy", "arm-none-eabi-gcc", "arm-none-eabi-objcopy", "sha256sum")
UPLOT = "rig/panel/static/vendor/uPlot.esm.js"
PACKAGES = "make gcc gcc-avr avr-libc binutils-avr gcc-arm-none-eabi binutils-arm-none-eabi"


class FirmwareHook(BuildHookInterface):  # type: ignore[type-arg]
    """Adds ``rig/_firmware/prebuilt``: the .hex and .uf2 files and SHA256SUMS."""

    PLUGIN_NAME = "custom"

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Build the variants, if that is asked for."""
        if version == "editable" or os.environ.get("RIG_FIRMWARE") != "required":
            return
        if not (Path(self.root) / UPLOT).is_file():
            raise RuntimeError(f"{UPLOT} missing: the panel of this wheel would draw no curves; run tools/uplot.sh")
        missing = [tool for tool in TOOLS if shutil.which(tool) is None]
        if missing:
            raise RuntimeError(
                f"{', '.join(missing)} missing, to build the firmware with; Debian: apt-get install {PACKAGES}"
            )
        self.folder = Path(tempfile.mkdtemp(prefix="rig-firmware-"))
        # a make that runs this build has flags and a job server of its own
        environment = {key: value for key, value in os.environ.items() if not key.startswith(("MAKE", "MFLAGS"))}
        command = ["make", "-s", f"-j{os.cpu_count() or 1}", "-C", str(Path(self.root) / "firmware"), "prebuilt"]
        subprocess.run([*command, f"BUILD={self.folder}"], check=True, env=environment)
        build_data["force_include"][str(self.folder / "prebuilt")] = "rig/_firmware/prebuilt"

    def finalize(self, version: str, build_data: dict[str, Any], artifact_path: str) -> None:
        """Remove what was built: the wheel has it."""
        if hasattr(self, "folder"):
            shutil.rmtree(self.folder)
