"""Trial of a foreign MJCF file in a child process with limited memory and time.

A small file may name others, repeat itself, or have textures and height fields of any size, so that
its own size bounds nothing. MuJoCo therefore reads and compiles it in a child process first. A
file that exceeds a limit, or crashes MuJoCo, ends the child only.
"""

from __future__ import annotations

import contextlib
import importlib
import json
import re
import subprocess
import sys
import xml.etree.ElementTree as ElementTree
from functools import lru_cache
from pathlib import Path

from mjtactile.core import memory_limit, process, resources, scaled_clock
from mjtactile.core.errors import InputError

MEMORY = 1 << 30
"""Maximum additional memory for reading and compiling a file, bytes."""
TIME = 10
"""Maximum processor time for it, s."""
_WAIT = 60.0  # time limit, s; the computer may be busy
_PLAIN_MAX = 2000
"""Maximum number of elements of a file that is read without a trial."""
_NUMBER = re.compile(r"(?<![\d.])\d{5}|[eE]\+?\d")
"""Number that may be a large count: five digits before the point, or an exponent."""
_HEAVY = frozenset(
    (
        "size",
        "include",
        "attach",
        "model",
        "replicate",
        "composite",
        "flexcomp",
        "texture",
        "hfield",
    )
    + ("mesh", "skin", "flex", "plugin", "extension")
)
"""Elements whose memory or time is not bounded by the size of the file."""
_FOLDERS = ("assetdir", "meshdir", "texturedir")  # attributes of <compiler>
_NO_MEMORY = ("alloc", "unknown exception")
"""Words of MuJoCo's errors without memory."""
_TOO_MUCH = f"needs more than {MEMORY >> 30} GiB of memory or {TIME} s of processor time"


def refusal(path: Path, root: ElementTree.Element | None) -> str:
    """Return the reason why the file `path` cannot be read within the limits; "" if it can be.

    `root` is its parsed content, None for unknown content. Shipped files and plain ones need no
    trial.
    """
    if root is not None and not _is_heavy(root):
        return ""
    absolute = path.absolute()
    if absolute.is_relative_to(resources.folder("models")):
        return ""
    state = absolute.stat()
    return _trial_outcome(absolute, state.st_mtime_ns, state.st_size)


def _is_heavy(root: ElementTree.Element) -> bool:
    for count, element in enumerate(root.iter()):
        if count > _PLAIN_MAX or element.tag in _HEAVY or "file" in element.attrib:
            return True
        if any(map(_NUMBER.search, element.attrib.values())):
            return True
    return False


@lru_cache(256)
def _trial_outcome(path: Path, *_state: int) -> str:
    """Return the outcome of a trial, once for each state of the file."""
    child = process.start(__name__, path, TIME, MEMORY, talk=True)
    try:
        text, _ = child.communicate(timeout=scaled_clock.wall(_WAIT))
    except subprocess.TimeoutExpired:
        return f"is not read within {_WAIT:g} s"
    finally:
        process.stop(child)
    with contextlib.suppress(ValueError, TypeError, KeyError):
        return str(json.loads(text)["refusal"])
    if child.returncode in (-9, -24):  # the system's or the limit's signal
        return _TOO_MUCH
    return f"{_TOO_MUCH}, or MuJoCo fails to read it ({process.how_it_ended(child)})"


def main(path: str, seconds: str, memory: str) -> None:
    """Read and compile the file in this process, with the limits. Write the outcome to stdout.

    Args:
        path: Path of the file.
        seconds: Maximum processor time, s.
        memory: Maximum additional memory, bytes.
    """
    import mujoco

    maximum = int(seconds)

    with contextlib.suppress(ImportError, ValueError, OSError):
        resource = importlib.import_module("resource")
        resource.setrlimit(resource.RLIMIT_CPU, (maximum, maximum + 1))
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    outcome = ""
    with memory_limit.limited(int(memory)) as limit:
        limit()
        try:
            _require_files(Path(path), set())
            mujoco.MjSpec.from_file(path).compile()
        except InputError as error:
            outcome = str(error)
        except MemoryError:
            outcome = _TOO_MUCH
        except (ValueError, RuntimeError, mujoco.FatalError) as error:
            # other errors are reported by the parent, with the field
            is_memory = any(words in str(error) for words in _NO_MEMORY)
            outcome = _TOO_MUCH if is_memory else ""
    sys.stdout.write(json.dumps({"refusal": outcome}) + "\n")


def _require_files(path: Path, done: set[Path]) -> None:
    """Raise InputError if the file, or one that it names, is a pipe or a device."""
    if path in done:
        return
    done.add(path)
    try:
        root = ElementTree.parse(path).getroot()
    except (ElementTree.ParseError, OSError):
        return  # MuJoCo reports it better
    folders = {
        "",
        *(value for compiler in root.iter("compiler") for value in map(compiler.get, _FOLDERS)),
    }
    for element in root.iter():
        name = element.get("file")
        for folder in folders if name else ():
            named = path.parent / (folder or "") / (name or "")
            if named.exists() and not named.is_file():
                raise InputError(f"names {name!r}, which is not a regular file")
            if named.is_file() and element.tag in ("include", "model"):
                _require_files(named, done)


if __name__ == "__main__":
    main(*sys.argv[1:])
