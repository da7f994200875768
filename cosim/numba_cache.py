"""Where compiled code is kept: folders that belong to exactly the sources that went into it.

numba checks only the file of a cached function, not the functions of other files that are inlined into it.
Here the code of a module lies in a folder named after the module and the content of all sources that it
imports, so it cannot be stale, and it serves wherever the same sources are installed.
"""

import hashlib
import os
import re
from functools import cache
from pathlib import Path

__all__ = ["LOCATORS", "PARENTS", "ROOT", "cache_folder", "children_folder", "code_folder", "is_warm"]

ROOT = Path(__file__).resolve().parent.parent
#: numba's setting ``NUMBA_CACHE_LOCATOR_CLASSES``: ours for our own sources, its own for a user's.
LOCATORS = (
    "cosim.codecache.SourceTreeLocator, UserProvidedCacheLocator, InTreeCacheLocator, UserWideCacheLocator, "
    "IPythonCacheLocator, ZipCacheLocator"
)
#: Names the parent's folder to a child process, which reads its code and writes none there.
PARENTS = "COSIM_PARENTS_CODE"
#: Packages with compiled functions, and modules that every run needs compiled.
_FOLDERS = ("mech", "cosim/loop")
_ALWAYS = ("cosim.loop.computer", "mech.kernels")
_IMPORT = re.compile(
    r"^[ \t]*(?:from[ \t]+([\w.]+)[ \t]+import[ \t]+(\([^)]*\)|[^\n]*)|import[ \t]+([^\n]*))", re.M
)


def cache_folder() -> str:
    """Return the folder for `NUMBA_CACHE_DIR`; the user's own setting wins."""
    chosen = os.environ.get("NUMBA_CACHE_DIR")
    if chosen:
        return chosen
    base = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    return str(base / "cosim" / "code")


def children_folder() -> str:
    """Return the folder for what ngspice's child processes compile, beside the parent's.

    They handle what strangers wrote: they may read the parent's code, and the parent never loads theirs.
    """
    return f"{cache_folder()}-children"


def code_folder(module: str) -> Path:
    """Return the folder of a module's compiled code, which need not exist."""
    stamp = hashlib.sha256()
    for name in sorted(_closure(module)):
        stamp.update(name.encode() + b"\0" + _sources()[name] + b"\0")
    return Path(cache_folder()) / f"{module}-{stamp.hexdigest()[:16]}"


def is_warm() -> bool:
    """Return whether code of these sources was compiled on this machine before, by whomever."""
    folders = [code_folder(module) for module in _ALWAYS]
    return all(each.is_dir() or (Path(children_folder()) / each.name).is_dir() for each in folders)


def _closure(module: str) -> set[str]:
    """Return a module with all modules of the compiled packages that it imports, directly or not."""
    found, waiting = set[str](), [module]
    while waiting:
        name = waiting.pop()
        if name not in found and name in _sources():
            found.add(name)
            waiting += _imports(name)
    return found


@cache
def _sources() -> dict[str, bytes]:
    """Return the sources of the compiled packages by module name."""
    paths = (path for folder in _FOLDERS for path in (ROOT / folder).rglob("*.py"))
    names = {path: ".".join(path.relative_to(ROOT).with_suffix("").parts) for path in paths}
    return {name.removesuffix(".__init__"): path.read_bytes() for path, name in names.items()}


@cache
def _imports(module: str) -> tuple[str, ...]:
    """Return names that a module imports; those that are no modules of ours do no harm."""
    found = []
    for package, names, plain in _IMPORT.findall(_sources()[module].decode()):
        words = re.findall(r"[\w.]+", names or plain)
        found += [package, *(f"{package}.{word}" for word in words)] if package else words
    return tuple(found)
