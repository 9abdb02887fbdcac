"""`python -m tests.sanitized [PYTEST ARGUMENTS]`: tests with kernels that detect every read and
write beyond an array and all undefined behavior (gcc's or clang's address and undefined-behavior
sanitizers).

It compiles the kernels with the system's compiler into build/sanitized. It restarts Python with the
sanitizers' libraries loaded before all others, and runs pytest there, in one process. A finding
ends the process with the location in C. Exit codes are pytest's, and 1 for a finding.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from mjtactile.kernels import build

FLAGS = ["-std=c11", "-O1", "-g", "-fPIC", "-shared", "-fno-omit-frame-pointer", "-mavx2", "-mfma"]
CHECKS = ["address", "undefined", "float-cast-overflow"]
TESTS = [
    "tests/unit/kernels/test_random_arguments.py",
    "tests/unit/kernels",
    "tests/unit/quasistatic",
    "tests/unit/sensing",
    # these run the same code of the kernels with more and larger images
    "-m",
    "not slow",
    # this test reads the name of the default library
    "--deselect=tests/unit/kernels/test_bindings.py::test_another_source_is_another_library",
]
DRAWS = "40"
INSIDE = "MJTACTILE_SANITIZED"


def main(words: list[str]) -> int:
    if os.environ.get(INSIDE):
        library = Path(os.environ[INSIDE])
        build.library = lambda *_, **__: library
        return pytest.main(["-n", "0", "--capture=no", "-p", "no:cacheprovider", *(words or TESTS)])
    compiler = os.environ.get("CC") or shutil.which("gcc") or shutil.which("cc")
    if compiler is None:
        sys.exit("no compiler with sanitizers here: gcc or clang")
    return subprocess.run(
        [sys.executable, "-m", "tests.sanitized", *words],
        env={**os.environ, **_environment(compiler)},
        check=False,
    ).returncode


def _environment(compiler: str) -> dict[str, str]:
    """Compile the kernels, and return the environment in which Python loads the result."""
    out = Path("build", "sanitized", "kernels.so").resolve()
    out.parent.mkdir(parents=True, exist_ok=True)
    sources = map(str, build.sources())
    checks = f"-fsanitize={','.join(CHECKS)}"
    subprocess.run(
        [compiler, *FLAGS, checks, "-fno-sanitize-recover=all", *sources, "-o", str(out), "-lm"],
        check=True,
    )
    return {
        INSIDE: str(out),
        "LD_PRELOAD": f"{_library_of(compiler, 'libasan.so')} {_library_of(compiler, 'libubsan.so')}",
        # Python itself frees little at its end
        "ASAN_OPTIONS": "detect_leaks=0:allocator_may_return_null=1",
        "UBSAN_OPTIONS": "print_stacktrace=1",
        # every array from malloc, whose bounds are watched
        "PYTHONMALLOC": "malloc",
        "MJTACTILE_DRAWS": os.environ.get("MJTACTILE_DRAWS", DRAWS),
    }


def _library_of(compiler: str, name: str) -> str:
    found = subprocess.run(
        [compiler, f"-print-file-name={name}"], check=True, capture_output=True, text=True
    )
    return found.stdout.strip()


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
