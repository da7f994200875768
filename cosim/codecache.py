"""numba's cache of our compiled code, kept where `numba_cache` says, believed only where it is whole.

Every file carries a check sum: one that is empty, cut or flipped is compiled anew, where numba would raise an
error or run it. numba imports this module by the name in ``NUMBA_CACHE_LOCATOR_CLASSES`` when it is about to
cache its first function.
"""

import hashlib
import os
import pickle
from pathlib import Path
from typing import Any, Self

from numba.core import caching
from numba.core.runtime import rtsys

from cosim.numba_cache import PARENTS, ROOT, cache_folder, code_folder

__all__ = ["SourceTreeLocator"]

_SUM = hashlib.sha256
_SUM_BYTES = _SUM().digest_size


class SourceTreeLocator(caching._CacheLocator):  # type: ignore[misc]
    """Places of this project's functions in numba's cache; other functions are left to numba's locators."""

    def __init__(self, line: int, place: Path) -> None:
        self._line, self._place = line, place

    @classmethod
    def from_function(cls, py_func: Any, py_file: str) -> Self | None:
        """Return the locator of a function of ours, and nothing for any other."""
        source = Path(py_file).resolve()
        if not (source.is_relative_to(ROOT / "cosim") or source.is_relative_to(ROOT / "mech")):
            return None
        module = ".".join(source.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__")
        locator = cls(py_func.__code__.co_firstlineno, code_folder(module))
        try:
            locator.ensure_cache_path()
        except OSError:  # a full or read-only disk: nothing is kept
            return None
        return locator

    def get_cache_path(self) -> str:
        """Return the folder of the function's files."""
        return str(self._place)

    def get_source_stamp(self) -> str:
        """Return the folder's name, which tells the sources."""
        return self._place.name

    def get_disambiguator(self) -> str:
        """Return what tells functions of one name in one file apart: the line."""
        return str(self._line)


class _CheckedFile(caching.IndexDataCacheFile):  # type: ignore[misc]
    """Index and data of one function behind their check sums; what does not match was never there.

    In a child process the parent's files are looked at first.
    """

    def __init__(self, cache_path: str, filename_base: str, source_stamp: object) -> None:
        super().__init__(cache_path=cache_path, filename_base=filename_base, source_stamp=source_stamp)
        above = os.environ.get(PARENTS)
        self._parents: _CheckedFile | None = None
        if above is not None and Path(cache_path).parent != Path(above):
            place = str(Path(above) / Path(cache_path).name)
            self._parents = _CheckedFile(place, filename_base, source_stamp)

    def load(self, key: Any) -> Any:
        """Return the compiled code for a signature, or None."""
        found = self._parents.load(key) if self._parents is not None else None
        return found if found is not None else super().load(key)

    def _load_index(self) -> dict[Any, str]:
        try:
            version, stamp, overloads = pickle.loads(_checked(self._index_path))
        except OSError:
            return {}
        return overloads if (version, stamp) == (self._version, self._source_stamp) else {}

    def _save_index(self, overloads: dict[Any, str]) -> None:
        self._write(self._index_path, (self._version, self._source_stamp, overloads))

    def _load_data(self, name: str) -> Any:
        return pickle.loads(_checked(self._data_path(name)))  # numba takes an OSError for a missing file

    def _save_data(self, name: str, data: Any) -> None:
        self._write(self._data_path(name), data)

    def _write(self, path: str, content: Any) -> None:
        body = self._dump(content)
        with self._open_for_write(path) as file:
            file.write(_SUM(body).digest() + body)


def _checked(path: str) -> bytes:
    """Return what stands behind a file's check sum; an `OSError` when it does not match."""
    whole = Path(path).read_bytes()
    body = whole[_SUM_BYTES:]
    if _SUM(body).digest() != whole[:_SUM_BYTES]:
        raise OSError(f"damaged: {path}")
    return body


def _cache_file(cache_path: str, filename_base: str, source_stamp: object) -> Any:
    """Return the files of a function: ours are checked, a user's are as numba keeps them."""
    kind = _CheckedFile if Path(cache_path).parent == Path(cache_folder()) else _Plain
    return kind(cache_path=cache_path, filename_base=filename_base, source_stamp=source_stamp)


def _load_overload(cache: Any, signature: Any, target: Any) -> Any:
    """Return compiled code, or None; numba's tables of functions, 0.1 s of filling, only where it compiles.

    What is in the cache was linked whole; it needs numba's runtime, which `refresh` would start.
    """
    rtsys.initialize(target)
    with cache._guard_against_spurious_io_errors():
        found = cache._load_overload(signature, target)
        if found is not None:
            return found
    return _load_after_refresh(cache, signature, target)


_Plain = caching.IndexDataCacheFile
_load_after_refresh = caching.Cache.load_overload
caching.IndexDataCacheFile = _cache_file
caching.Cache.load_overload = _load_overload
