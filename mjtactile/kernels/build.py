"""The library of kernels: where it lies, and how it is made where it does not lie yet.

A library's name holds a hash of its source and its instruction set, so that one of another source
is never loaded. Made by the build of a wheel or of an editable install (`hatch_build.py`), else by
the first import: with Zig's C compiler, which pip installs (`ziglang`), or with the system's.
Stands alone: the build runs it before this package can be imported.
"""

from __future__ import annotations

import hashlib
import importlib.util
import os
import platform
import shlex
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

FOLDER = Path(__file__).parent
MADE = "made"  # the folder of libraries
# Sums may be reordered and thus vectorised; not-a-number and infinity are honoured, since they mean
# "unknown".
_FLAGS = [
    "-std=c11",
    "-O3",
    "-fPIC",
    "-shared",
    "-fno-math-errno",
    "-fno-trapping-math",
    "-fno-signed-zeros",
    "-fassociative-math",
    "-ffp-contract=fast",
    "-Wall",
    "-Wextra",
    "-Werror",
]
# Instruction sets that are worth a library of their own, the best first: what the processor must
# have, and the flag.
_SETS = {
    "x86_64": [
        ("avx2", {"avx2", "fma", "bmi2"}, ["-mavx2", "-mfma", "-mbmi2"]),
        ("sse2", set(), []),
    ]
}


def sources() -> list[Path]:
    return sorted(FOLDER.glob("*.c"))


def instruction_sets() -> list[str]:
    """Names of all that a wheel for this kind of processor holds."""
    return [name for name, _, _ in _sets()]


def best_set() -> str:
    """The best that this very processor can run."""
    has = _processor_flags()
    return next(name for name, needs, _ in _sets() if needs <= has)


def library(instructions: str | None = None) -> Path:
    """The library for `instruction_sets`' one (default: the best), made if it does not exist.
    Raises RuntimeError with what to do where no compiler is found or the compiler fails."""
    instructions = best_set() if instructions is None else instructions
    name = f"kernels-{_hash()}-{instructions}.so"
    for folder in _folders():
        if (folder / name).exists():
            return folder / name
    for folder in _folders():
        try:
            folder.mkdir(parents=True, exist_ok=True)
            with tempfile.TemporaryDirectory(dir=folder) as work:
                made = Path(work) / name
                _compile(made, instructions)
                made.replace(folder / name)
                _forget_others(folder / name, instructions)
        except PermissionError:  # an installation that belongs to somebody else
            continue
        return folder / name
    raise RuntimeError(
        f"mjtactile's kernels cannot be written to {' or '.join(map(str, _folders()))}"
    )


def _forget_others(library: Path, instructions: str) -> None:
    """Delete what was made of other sources in a checkout; a process that uses it keeps it."""
    if library.parent == FOLDER / MADE:
        for old in library.parent.glob(f"kernels-*-{instructions}.so"):
            if old != library:
                old.unlink(missing_ok=True)


def _sets() -> list[tuple[str, set[str], list[str]]]:
    return _SETS.get(platform.machine(), [("plain", set(), [])])


def _processor_flags() -> set[str]:
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        return set()
    return next(
        (set(line.partition(":")[2].split()) for line in lines if line.startswith("flags")), set()
    )


def _hash() -> str:
    text = hashlib.sha256(repr(_FLAGS).encode())
    for path in [*sources(), *sorted(FOLDER.glob("*.h"))]:
        text.update(path.read_bytes())
    return text.hexdigest()[:12]


def _folders() -> list[Path]:
    cache = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return [FOLDER / MADE, Path(cache) / "mjtactile"]


def _compiler() -> list[str]:
    if importlib.util.find_spec("ziglang"):
        return [sys.executable, "-m", "ziglang", "cc"]
    found = os.environ.get("CC") or shutil.which("cc")
    if not found:
        raise RuntimeError(
            "mjtactile's kernels are not built and there is no C compiler: pip install ziglang"
        )
    return shlex.split(found)


def _compile(out: Path, instructions: str) -> None:
    flags = next(flags for name, _, flags in _sets() if name == instructions)
    command = [*_compiler(), *_FLAGS, *flags, "-o", str(out), *map(str, sources()), "-lm"]
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
