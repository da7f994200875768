"""Files of compiled code: named after what they are made from, checked, and built where they are missing.

A package's compiled functions are one file of object code. Its name tells the content of all sources that
went into it and the processor that it was made for: it cannot be stale, and serves wherever the same
sources are installed. It is believed where its check sum holds. Building takes half a minute and happens in
a process of its own (`mech.build`), the only one that imports numba.
"""

from __future__ import annotations

import atexit
import contextlib
import functools
import hashlib
import importlib.util
import os
import platform
import re
import shutil
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

__all__ = [
    "BUILDS_NONE",
    "FOLDER",
    "PACKAGES",
    "closure",
    "file_of",
    "folder",
    "is_built",
    "library_of",
    "modules_of",
    "pack",
    "ready",
    "sources",
    "stamp",
    "unpack",
]

ROOT = Path(__file__).resolve().parent.parent
#: Names the folder of the libraries, in the environment of a process that builds none.
FOLDER = "COSIM_LIBRARIES"
#: What two processes build at once, in the same time: packages, and a module that has a library of its own.
_HALVES = (
    ("cosim.loop", "cosim.loop.linear"),
    ("mech", "cosim.loop.linear.exact_steps", "cosim.loop.spice"),
)
#: Packages (and that module) with compiled functions.
PACKAGES = tuple(each for half in _HALVES for each in half)
#: What builds them: its changes make other libraries, too.
_BUILDER = "mech.build"
#: Set in processes that build no libraries: they could not keep one.
BUILDS_NONE = "COSIM_BUILDS_NONE"
#: Folders whose modules' imports are followed: of what lies elsewhere compiled functions use constants
#: at most.
_FOLLOWED = ("mech", "cosim.loop")
_OFFERS = re.compile(r"\n@(?:entry|callback)\(")
_IMPORT = re.compile(
    r"^[ \t]*(?:from[ \t]+([\w.]+)[ \t]+import[ \t]+(\([^)]*\)|[^\n]*)|import[ \t]+([^\n]*))", re.M
)
_SUM = hashlib.sha256
_HEAD = b"cosim library 1\n"
#: More bytes than a library has; time between looks at those who build [s].
_LARGEST, _LOOK_S = 1 << 20, 0.02
#: Libraries of a package that are kept, those last used, and for how long. One that was used within a day may
#: be about to be loaded: each process that looks for it says so in the file's time, half a day at the latest.
_KEPT, _KEPT_S, _IN_USE_S = 8, 30 * 86400.0, 86400.0


def folder() -> Path:
    """Return the folder of the libraries, which need not exist.

    The variable `FOLDER` names it, or ``XDG_CACHE_HOME`` its parent.
    """
    chosen = os.environ.get(FOLDER)
    if chosen:
        return Path(chosen)
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "cosim" / "code"


def file_of(package: str) -> Path:
    """Return the file of a package's library."""
    return folder() / f"{package}-{stamp(package)}.library"


@functools.cache
def stamp(package: str) -> str:
    """Return what tells the sources of a package's library, what builds it, and the processor."""
    digest = _SUM(_processor() + _translator())
    for name in sorted(closure((*modules_of(package), _BUILDER))):
        digest.update(name.encode() + b"\0" + sources()[name] + b"\0")
    return digest.hexdigest()[:16]


def library_of(module: str) -> str:
    """Return the library with a module's functions: that of its package, or its own."""
    return module if module in PACKAGES else module.rpartition(".")[0]


@functools.cache
def modules_of(package: str) -> tuple[str, ...]:
    """Return the modules that offer compiled functions in a package's library."""
    place = ROOT / package.replace(".", "/")
    if not place.is_dir():
        return (package,)
    paths = sorted(path for path in place.glob("*.py") if _OFFERS.search(path.read_text("utf-8")))
    modules = [f"{package}.{path.stem}" for path in paths]
    return tuple(module for module in modules if library_of(module) == package)


def is_built() -> bool:
    """Return whether all libraries are there."""
    return all(file_of(package).is_file() for package in _packages())


@functools.cache
def _packages() -> tuple[str, ...]:
    """Return the packages that are installed: the mechanics serve alone, too."""
    places = {each: ROOT / each.replace(".", "/") for each in PACKAGES}
    return tuple(
        each for each, place in places.items() if place.is_dir() or place.with_suffix(".py").is_file()
    )


def pack(code: bytes) -> bytes:
    """Return a library's file."""
    return _HEAD + _SUM(code).digest() + code


def unpack(file: Path) -> bytes | None:
    """Return the object code of a file, or None where it is missing or damaged."""
    try:
        content = file.read_bytes()
    except OSError:
        return None
    code = content[len(_HEAD) + _SUM().digest_size :]
    return code if content == pack(code) else None


def closure(modules: Sequence[str]) -> set[str]:
    """Return modules with all that they import of ours, directly or, within `_FOLLOWED`, not."""
    reached, waiting = set[str](), list(modules)
    while waiting:
        name = waiting.pop()
        if name in reached or name not in sources():
            continue
        reached.add(name)
        if name.startswith(_FOLLOWED):
            waiting += _imports(name)
    return reached


class _Sources(dict[str, bytes]):
    """Sources of our modules by name, read when they are asked for."""

    def __contains__(self, name: object) -> bool:
        return self.get(str(name)) is not None

    def get(self, name: str, default: Any = None) -> Any:
        if not super().__contains__(name):
            self[name] = self._read(name)
        return super().__getitem__(name)

    def __getitem__(self, name: str) -> bytes:
        return bytes(self.get(name))

    @staticmethod
    def _read(name: str) -> Any:
        if name.partition(".")[0] not in ("mech", "cosim"):
            return None
        place = ROOT / name.replace(".", "/")
        for path in (place.with_suffix(".py"), place / "__init__.py"):
            if path.is_file():
                return path.read_bytes()
        return None


@functools.cache
def sources() -> Any:
    """Return the sources of our modules by name."""
    return _Sources()


@functools.cache
def _imports(module: str) -> tuple[str, ...]:
    """Return names that a module imports; those that are no modules of ours do no harm."""
    names: list[str] = []
    for package, listed, plain in _IMPORT.findall(sources()[module].decode()):
        words = re.findall(r"[\w.]+", listed or plain)
        names += [package, *(f"{package}.{word}" for word in words)] if package else words
    return tuple(names)


@functools.cache
def _translator() -> bytes:
    """Return what numba states of its version, without its import."""
    found = importlib.util.find_spec("numba")
    if found is None or found.origin is None:
        return b""
    with contextlib.suppress(OSError):
        return Path(found.origin).with_name("_version.py").read_bytes()
    return b""


@functools.cache
def _processor() -> bytes:
    """Return what tells processors apart that need different code, and the loader's version."""
    import llvmlite

    try:
        with open("/proc/cpuinfo", encoding="utf-8", errors="replace") as stream:
            first = stream.read(8192).partition("\n\n")[0].splitlines()
    except OSError:
        first = [platform.processor()]
    told = ("model name", "flags", "Features", "CPU implementer", "CPU part")
    lines = [line for line in first if line.startswith(told)] or first
    return "\n".join([platform.machine(), llvmlite.__version__, *lines]).encode()


def ready(tell: Callable[[str, float], None] | None = None) -> None:
    """Build the libraries that are missing or damaged.

    Parameters
    ----------
    tell
        Called with a package and the seconds since the beginning when it is there.

    Raises
    ------
    RuntimeError
        When one cannot be built.
    """
    missing = [package for package in _packages() if not _is_whole(file_of(package))]
    for package in _packages():
        if package not in missing:
            _note_use(file_of(package))
    if not missing:
        return
    if BUILDS_NONE in os.environ:
        names = ", ".join(str(file_of(package)) for package in missing)
        raise RuntimeError(f"compiled code is missing, and this process builds none: {names}")
    _see_to_folder()
    begun = time.perf_counter()
    # what the libraries of a half share is translated once
    halves = [[each for each in half if each in missing] for half in _HALVES]
    builders = [_Builder(half) for half in halves if half]
    try:
        working = True
        while working:
            working = any(builder.works() for builder in builders)
            for package in [each for each in missing if unpack(file_of(each)) is not None]:
                missing.remove(package)
                if tell is not None:
                    tell(package, time.perf_counter() - begun)
            failed = [each for each in builders if not (each.works() or each.is_done())]
            if failed:
                raise RuntimeError(f"the compiled code cannot be built: {failed[0].last_words()}")
            time.sleep(_LOOK_S)
    finally:
        for builder in builders:
            builder.end()
    _tidy_up()


def _is_whole(file: Path) -> bool:
    """Whether a library is there and undamaged; the same file is read once, as each run asks thrice."""
    try:
        known = file.stat()
    except OSError:
        return False
    return _was_whole(file, known.st_size, known.st_mtime_ns)


@functools.lru_cache(maxsize=len(PACKAGES))
def _was_whole(file: Path, size: int, changed_ns: int) -> bool:
    return unpack(file) is not None


def _note_use(file: Path) -> None:
    """Give a library the present time, where its own is half of `_IN_USE_S` old."""
    with contextlib.suppress(OSError):  # a child, or a folder of somebody else's
        if time.time() - file.stat().st_mtime > 0.5 * _IN_USE_S:
            os.utime(file)


def _tidy_up() -> None:
    """Remove libraries that other versions have left, and what a builder that was ended has begun."""
    for package in PACKAGES:
        files = [(_unused_s(file), file) for file in folder().glob(f"{package}-*.library*")]
        for rank, (unused_s, file) in enumerate(sorted(files)):
            if unused_s > _KEPT_S or (rank >= _KEPT and unused_s > _IN_USE_S):
                with contextlib.suppress(OSError):
                    file.unlink()


def _unused_s(file: Path) -> float:
    try:
        return time.time() - file.stat().st_mtime
    except OSError:  # another process tidies up
        return 0.0


class _Builder:
    """The process that builds the libraries of packages."""

    def __init__(self, packages: Sequence[str]) -> None:
        import subprocess  # few processes build

        self._packages, self._words = packages, tempfile.TemporaryFile()
        # sources and packages lie where this process finds them
        path = os.pathsep.join([str(ROOT), *(os.path.abspath(each) for each in sys.path if each)])
        self._process = subprocess.Popen(
            [sys.executable, "-P", "-m", "mech.build", *packages],
            # O2 runs as fast as O3, and builds in nine tenths of the time
            env={**os.environ, "COSIM_BUILDS_LIBRARIES": "1", "PYTHONPATH": path, FOLDER: str(folder()),
                 "NUMBA_DISABLE_ERROR_MESSAGE_HIGHLIGHTING": "1", "NUMBA_OPT": "2"},
            stdin=subprocess.DEVNULL, stdout=self._words, stderr=self._words,
        )  # fmt: skip

    def works(self) -> bool:
        """Return whether it still runs."""
        return self._process.poll() is None

    def is_done(self) -> bool:
        """Return whether its libraries are there."""
        return all(unpack(file_of(package)) is not None for package in self._packages)

    def end(self) -> None:
        """End it, where it runs."""
        self._process.kill()
        self._process.wait()
        self._words.close()

    def last_words(self) -> str:
        """Return why it failed."""
        self._words.seek(0)
        lines = self._words.read().decode(errors="replace").strip().splitlines()
        return lines[-1] if lines else f"it ended with {self._process.returncode}"


def _see_to_folder() -> None:
    """Make the folder; where nothing can be written, take one for this process and its children alone."""
    try:
        folder().mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder()) as stream:
            stream.write(bytes(_LARGEST))
    except OSError:
        place = tempfile.mkdtemp(prefix="cosim-code-")
        atexit.register(shutil.rmtree, place, ignore_errors=True)
        os.environ[FOLDER] = place
