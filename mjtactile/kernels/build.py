"""Location and build of the kernel library.

The file name of a library holds a hash of its source, its platform and its instruction set. The
build of a wheel or of an editable install (`hatch_build.py`) compiles it, or else the first import.
The compiler is Zig's, a pip package (`ziglang`), or the system's. Zig cross-compiles for the oldest
system that the wheel tag promises: glibc 2.17 on Linux, macOS 11. This module imports no other
module of the package, because the build runs it first.
"""

from __future__ import annotations

import hashlib
import importlib.util
import os
import platform
import re
import shlex
import shutil
import subprocess
import sys
import sysconfig
import tempfile
from pathlib import Path

FOLDER = Path(__file__).parent
MADE = "made"  # the folder of libraries
# Sums may be reordered and vectorised. NaN and infinity are respected, since they mean "unknown".
_FLAGS = [
    "-std=c11",
    "-O3",
    "-fPIC",
    "-shared",
    "-g0",
    "-fno-math-errno",
    "-fno-trapping-math",
    "-fno-signed-zeros",
    "-fassociative-math",
    "-ffp-contract=fast",
    "-Wall",
    "-Wextra",
    "-Werror",
]
# GCC warns that vector arguments are passed differently without AVX. No external code passes
# vectors to these functions.
_SYSTEM_FLAGS = ["-Wno-psabi"]
# Targets of the Zig compiler, and the corresponding wheel tags.
PLATFORMS = {
    "linux-x86_64": ("x86_64-linux-gnu.2.17", "manylinux_2_17_x86_64.manylinux2014_x86_64"),
    "linux-aarch64": ("aarch64-linux-gnu.2.17", "manylinux_2_17_aarch64.manylinux2014_aarch64"),
    "darwin-arm64": ("aarch64-macos.11.0", "macosx_11_0_arm64"),
    "darwin-x86_64": ("x86_64-macos.11.0", "macosx_11_0_x86_64"),
}
# Without Zig's runtime library: the kernels do not use it, and compiling it doubles the build time.
# A missing symbol is an error of the build.
_ZIG_FLAGS = {"linux": ["-nostdlib", "-Wl,-z,defs"], "darwin": ["-nostdlib"]}
# Instruction sets with a separate library, the best first: name, required processor features,
# compiler flags.
_X86_SETS = [("avx2", {"avx2", "fma", "bmi2"}, ["-mavx2", "-mfma", "-mbmi2"]), ("sse2", set(), [])]
_OTHER_SETS = [("plain", set(), [])]


def sources() -> list[Path]:
    return _files(".c")


def _files(suffix: str) -> list[Path]:
    # not by `glob`, whose open folder would be reported where a signal interrupts it
    return sorted(path for path in FOLDER.iterdir() if path.suffix == suffix)


def this_platform() -> str:
    """Return system and processor, such as those of `PLATFORMS`."""
    return f"{sys.platform}-{platform.machine()}"


def wheel_tag(target: str) -> str:
    """Return the wheel tag of the platform `target`; without Zig the plain platform tag."""
    if _has_zig() and target in PLATFORMS:
        return f"py3-none-{PLATFORMS[target][1]}"
    return "py3-none-" + re.sub(r"[-.]", "_", sysconfig.get_platform())


def instruction_sets(target: str) -> list[str]:
    """Return the names of all instruction sets in a wheel for this platform."""
    return [name for name, _, _ in _sets(target)]


def best_set() -> str:
    """Return the name of the best instruction set of this processor."""
    has = _processor_flags()
    return next(name for name, needs, _ in _sets(this_platform()) if needs <= has)


def library(instructions: str | None = None, target: str | None = None) -> Path:
    """Return the path of the kernel library. Build it if it does not exist.

    `instructions` default to the best set of this processor, `target` to this platform. Raises
    RuntimeError with a remedy if there is no compiler, or it fails.
    """
    if sys.platform == "win32":
        raise RuntimeError("mjtactile runs on Linux and macOS; on Windows, inside WSL")
    instructions = best_set() if instructions is None else instructions
    target = this_platform() if target is None else target
    name = f"kernels-{_hash()}-{target}-{instructions}.so"
    for folder in _folders():
        if (folder / name).exists():
            return folder / name
    for folder in _folders():
        try:
            folder.mkdir(parents=True, exist_ok=True)
            with tempfile.TemporaryDirectory(dir=folder) as work:
                made = Path(work) / name
                _compile(made, instructions, target)
                made.replace(folder / name)
                _forget_others(folder / name, f"{target}-{instructions}")
        except PermissionError:  # read-only installation
            continue
        return folder / name
    raise RuntimeError(
        f"mjtactile's kernels cannot be written to {' or '.join(map(str, _folders()))}"
    )


def _forget_others(library: Path, kind: str) -> None:
    """Delete libraries of other source versions in a checkout. Running processes keep theirs."""
    if library.parent == FOLDER / MADE:
        for old in library.parent.glob(f"kernels-*-{kind}.so"):
            if old != library:
                old.unlink(missing_ok=True)


def _sets(target: str) -> list[tuple[str, set[str], list[str]]]:
    return _X86_SETS if target.endswith("-x86_64") else _OTHER_SETS


def _processor_flags() -> set[str]:
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        return set()
    return next(
        (set(line.partition(":")[2].split()) for line in lines if line.startswith("flags")), set()
    )


def _hash() -> str:
    text = hashlib.sha256(repr((_FLAGS, PLATFORMS, _ZIG_FLAGS)).encode())
    for path in [*sources(), *_files(".h")]:
        text.update(path.read_bytes())
    return text.hexdigest()[:12]


def _folders() -> list[Path]:
    cache = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return [FOLDER / MADE, Path(cache) / "mjtactile"]


def _has_zig() -> bool:
    return importlib.util.find_spec("ziglang") is not None


def _compiler(target: str) -> list[str]:
    """Return the command that compiles for the platform `target`."""
    if _has_zig():
        zig = [sys.executable, "-m", "ziglang", "cc"]
        # Without a target Zig compiles for this very processor, whatever it has.
        if target in PLATFORMS:
            system = target.partition("-")[0]
            return [*zig, "-target", PLATFORMS[target][0], *_ZIG_FLAGS[system]]
        return zig
    if target != this_platform():
        raise RuntimeError(f"only Zig compiles for {target} here: pip install ziglang")
    found = os.environ.get("CC") or shutil.which("cc")
    if not found:
        raise RuntimeError(
            "mjtactile's kernels are not built and there is no C compiler: pip install ziglang"
        )
    return shlex.split(found)


def _compile(out: Path, instructions: str, target: str) -> None:
    flags = next(flags for name, _, flags in _sets(target) if name == instructions)
    extra_flags = [] if _has_zig() else _SYSTEM_FLAGS
    command = [
        *_compiler(target),
        *_FLAGS,
        *extra_flags,
        *flags,
        "-o",
        str(out),
        *map(str, sources()),
    ]
    command += ["-lc", "-lm"]
    # a build folder of its own: a user's home may not be writable
    environment = {
        **os.environ,
        "ZIG_LOCAL_CACHE_DIR": str(out.parent),
        "ZIG_GLOBAL_CACHE_DIR": str(out.parent),
    }
    done = subprocess.run(command, capture_output=True, text=True, check=False, env=environment)
    if done.returncode:
        raise RuntimeError(
            f"mjtactile's kernels do not compile: {shlex.join(command)}\n{done.stderr}"
        )
