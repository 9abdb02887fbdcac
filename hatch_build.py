"""Compiles the kernels when a wheel or an editable install is made; see
mjtactile/kernels/build.py."""

from __future__ import annotations

import os
import runpy
from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface

_TARGET = "MJTACTILE_WHEEL"  # the environment variable that names another platform, for a wheel


class Kernels(BuildHookInterface):
    """A wheel holds a library for each instruction set of its platform; an editable install uses
    the one in the checkout."""

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        if self.target_name != "wheel":  # a source distribution is compiled where it is installed
            return
        build = runpy.run_path(str(Path(self.root) / "mjtactile" / "kernels" / "build.py"))
        if version == "editable":
            build["library"]()
            return
        target = os.environ.get(_TARGET) or build["this_platform"]()
        if _TARGET in os.environ and target not in build["PLATFORMS"]:
            raise SystemExit(f"{_TARGET}={target}: choose from {', '.join(build['PLATFORMS'])}")
        made = [build["library"](name, target) for name in build["instruction_sets"](target)]
        build_data["force_include"].update(
            {str(path): f"mjtactile/kernels/made/{path.name}" for path in made}
        )
        build_data["pure_python"] = False
        build_data["tag"] = build["wheel_tag"](target)
