"""Builds the firmware of every variant, of Uno and Pico, into a wheel of rig: `rig flash` needs no compiler there.

hatchling runs it for each wheel. Without both compilers the wheel has none, and says so; with RIG_FIRMWARE=required
that is an error. The same goes for uPlot, which draws the panel's curves and which the set-up brings.
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
        """Build the variants, unless the installation is editable."""
        if version == "editable":
            return
        if not (Path(self.root) / UPLOT).is_file():
            self._lack(f"{UPLOT} missing: the panel of this wheel draws no curves", "run tools/uplot.sh")
        missing = [tool for tool in TOOLS if shutil.which(tool) is None]
        if missing:
            self._lack(
                f"{', '.join(missing)} missing: this wheel has no prebuilt firmware, and `rig flash` will need them",
                f"Debian: apt-get install {PACKAGES}",
            )
            return
        self.folder = Path(tempfile.mkdtemp(prefix="rig-firmware-"))
        # a make that runs this build has flags and a job server of its own
        environment = {key: value for key, value in os.environ.items() if not key.startswith(("MAKE", "MFLAGS"))}
        command = ["make", "-s", f"-j{os.cpu_count() or 1}", "-C", str(Path(self.root) / "firmware"), "prebuilt"]
        subprocess.run([*command, f"BUILD={self.folder}"], check=True, env=environment)
        build_data["force_include"][str(self.folder / "prebuilt")] = "rig/_firmware/prebuilt"

    def _lack(self, words: str, cure: str) -> None:
        """Say what the wheel will not have; an error with RIG_FIRMWARE=required."""
        if os.environ.get("RIG_FIRMWARE") == "required":
            raise RuntimeError(f"{words}; {cure}")
        self.app.display_warning(f"{words}; {cure}")

    def finalize(self, version: str, build_data: dict[str, Any], artifact_path: str) -> None:
        """Remove what was built: the wheel has it."""
        if hasattr(self, "folder"):
            shutil.rmtree(self.folder)
