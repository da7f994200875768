"""What a child process sees of its parent: variables, module path, files that it may read and write."""

import atexit
import contextlib
import os
import shutil
import sys
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path

from cosim.quick_start import FRUGAL

__all__ = ["allowed_files", "environment"]

_LIBRARIES, _BUILDS_NONE = "COSIM_LIBRARIES", "COSIM_BUILDS_NONE"
"""Variables of `mech.library_files`: where compiled code lies, and that a process builds none."""

_KEPT = (
    "PATH", "LANG", "LC_ALL", "LC_CTYPE", "TZ", "LD_LIBRARY_PATH", "DYLD_LIBRARY_PATH", "SYSTEMROOT",
    "NGSPICE_LIBRARY_PATH", "XDG_CACHE_HOME", "PYTHONHOME", "PYTHONDONTWRITEBYTECODE", "PYTHONHASHSEED",
    "PYTHONWARNINGS", "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS",
)  # fmt: skip
"""What a child gets of its parent's environment."""


def allowed_files(folder: Path, env: Mapping[str, str], reads: Sequence[Path]) -> dict[str, list[str]]:
    """Return the files of a child: its own folder, the caches and the user's Python files."""
    cache = str(Path(env["XDG_CACHE_HOME"]) / "cosim" / "circuits")
    # a Landlock rule needs an existing folder; a read-only system keeps no cache
    with contextlib.suppress(OSError):
        os.makedirs(cache, exist_ok=True)
    return {"reads": [env[_LIBRARIES], *map(str, reads)], "writes": [str(folder), cache]}


def _code_folder(home: Path) -> str:
    """Return where compiled code lies; where none can be kept, a folder for this process and its children."""
    cache = Path(os.environ.get("XDG_CACHE_HOME") or home / ".cache")
    chosen = os.environ.get(_LIBRARIES) or str(cache / "cosim" / "code")
    with contextlib.suppress(OSError):
        os.makedirs(chosen, exist_ok=True)
    if not os.path.isdir(chosen) or not (os.access(chosen, os.W_OK) or os.listdir(chosen)):
        chosen = os.environ[_LIBRARIES] = tempfile.mkdtemp(prefix="cosim-code-")
        atexit.register(shutil.rmtree, chosen, ignore_errors=True)
    return chosen


def environment(folder: Path) -> dict[str, str]:
    """Return the child's environment: a home of its own, the parent's module path, one thread a library."""
    env = {name: value for name, value in os.environ.items() if name in _KEPT}
    home = Path(os.environ.get("HOME") or Path.home())
    # caches lie in the user's own home, which a new HOME must not hide
    env.setdefault("XDG_CACHE_HOME", str(home / ".cache"))
    env[_LIBRARIES], env[_BUILDS_NONE] = _code_folder(home), "1"
    env["HOME"], env["TMPDIR"] = str(folder / "home"), str(folder / "tmp")
    env["PYTHONPATH"] = os.pathsep.join(_modules())
    env["COSIM_NGSPICE_ECHO"] = "1"
    for name, value in {"OMP_NUM_THREADS": "1", **FRUGAL}.items():
        env.setdefault(name, value)
    return env


def _modules() -> list[str]:
    """Return the parent's module path; a working folder that Python put there is no place of modules."""
    here = os.getcwd()
    entries = [os.path.abspath(entry) for entry in sys.path if entry]
    return [each for each in entries if each != here or os.path.isdir(os.path.join(each, "cosim"))]
