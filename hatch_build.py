"""Compiles the kernels when a wheel or an editable install is made; see
mjtactile/kernels/build.py."""

from __future__ import annotations

import runpy
import sysconfig
from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface


class Kernels(BuildHookInterface):
    """A wheel holds a library for each instruction set; an editable install uses the one in the
    checkout."""

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        build = runpy.run_path(str(Path(self.root) / "mjtactile" / "kernels" / "build.py"))
        if version == "editable":
            build["library"]()
            return
        made = [build["library"](name) for name in build["instruction_sets"]()]
        build_data["force_include"].update(
            {str(path): f"mjtactile/kernels/made/{path.name}" for path in made}
        )
        build_data["pure_python"] = False
        build_data["tag"] = "py3-none-" + sysconfig.get_platform().replace("-", "_").replace(
            ".", "_"
        )
