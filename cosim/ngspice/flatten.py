"""From files that include files to one list of lines."""

import os
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, field, replace
from functools import lru_cache
from pathlib import Path

from cosim.errors import InputError, Problem, fail, nearest
from cosim.ngspice.dialect import Dialect
from cosim.ngspice.foreign_functions import in_own_words
from cosim.ngspice.ideal_diodes import as_sources
from cosim.ngspice.lax_forms import put_right, read_over
from cosim.ngspice.lines import Line, lines_of, text_of
from cosim.ngspice.values import as_meant

__all__ = ["Reader", "including", "readable", "sections"]

_granted: ContextVar[tuple[Path, ...]] = ContextVar("granted", default=())
"""Folders outside the project that netlists may include files of."""


@contextmanager
def including(folders: Iterable[str | Path]) -> Iterator[None]:
    """Let netlists include files of these folders, too, inside the block; nothing else is allowed there.

    Raises
    ------
    InputError
        For what is not a folder.
    """
    paths = tuple(Path(folder) for folder in folders)
    missing = [path for path in paths if not os.path.isdir(path)]
    if missing:
        raise InputError(Problem("is not a folder", key="--include", value=str(path)) for path in missing)
    before = _granted.set(paths)
    try:
        yield
    finally:
        _granted.reset(before)


def readable(path: Path, folders: Iterable[Path]) -> bool:
    """Whether a file lies in one of these folders, or in one that `including` allows, wherever links lead."""
    place = path.resolve()
    return any(place.is_relative_to(folder.resolve()) for folder in (*folders, *_granted.get()))


MOST_LINES = 200_000
"""Statements that a board may be made of, included files counted as often as they are included."""
MOST_FILES = 1_000
"""Includes that are followed for one board."""
MOST_NESTED = 40
"""Depth of files that include files."""


@dataclass(frozen=True)
class Reader:
    """Reads netlists and inlines ``.include`` and ``.lib``; what cannot be inlined stays, with its fault.

    Attributes
    ----------
    root
        Folder that includes may not leave.
    trust
        Whether to allow everything.
    dialect
        Dialect of the files.
    """

    root: Path
    trust: bool = False
    dialect: Dialect = Dialect.NGSPICE
    _read: dict[Path, list[Line]] = field(default_factory=dict, repr=False, compare=False)
    _places: dict[Path, Path] = field(default_factory=dict, repr=False, compare=False)

    def read(self, path: Path, section: str | None = None) -> list[Line]:
        """Return the lines of `path`, or of one ``.lib`` section of it, with all that they include.

        Raises
        ------
        InputError
            For a file that cannot be read or lacks the section, and beyond `MOST_LINES` and `MOST_FILES`.
        """
        rows = self.rows(path)
        if section is not None and section not in self.sections(path):
            named = self.sections(path)
            near = nearest(section, named)
            fail(f"no section '{section}'" + (f", nearest is '{near}'" if near else ""), file=str(path),
                 allowed=", ".join(named) or "the file has no .lib sections")  # fmt: skip
        lines: list[Line] = []
        files = 0
        for line in self._walk(path, rows, section, ()):
            if line.text:
                lines.append(line)
            else:
                files += 1
            if len(lines) > MOST_LINES or files > MOST_FILES:
                fail(f"includes grow to more than {MOST_LINES} lines or {MOST_FILES} files", file=str(path))
        return lines

    def rows(self, path: Path) -> list[Line]:
        """Return the lines of one file, its values as its dialect means them."""
        place = self._place(path)
        if place not in self._read:
            self._read[place] = list(_as_meant(text_of(path), str(path), self.dialect))
        return self._read[place]

    def _place(self, path: Path) -> Path:
        """Return where a path leads; like a file's lines it is looked up once, and boards include a lot."""
        if path not in self._places:
            self._places[path] = path.resolve()
        return self._places[path]

    def sections(self, path: Path) -> list[str]:
        """Return the names of a file's ``.lib`` sections in lower case."""
        return sections(self.rows(path), self.dialect)

    def _walk(
        self,
        path: Path,
        rows: list[Line],
        section: str | None,
        stack: tuple[tuple[Path, str | None], ...],
    ) -> Iterator[Line]:
        place = (self._place(path), section)
        includes = self.dialect.lib_includes and not any(line.keyword == ".endl" for line in rows)
        inside: str | None = None
        opened: Line | None = None
        for line in rows:
            word = line.keyword
            if word not in (".include", ".inc", ".lib", ".endl"):
                if inside == section:
                    yield line
                continue
            words = line.text.split(None, 1)
            arguments = _arguments(words[1]) if len(words) > 1 else []
            if word == ".endl":
                inside, opened = None, None
            elif word == ".lib" and len(arguments) == 1 and not includes:
                inside, opened = arguments[0].lower(), line
            elif inside == section:
                inner = arguments[1].lower() if word == ".lib" and len(arguments) > 1 else None
                yield replace(
                    line, text=""
                )  # counts, so that includes of nothing but includes come to an end
                yield from self._included(path, line, arguments[:1], inner, (*stack, place))
        if opened is not None:
            name = _arguments(opened.text.split(None, 1)[1])[0]
            fault = (
                f"opens a section '{name}' that no .endl closes; to include a file write .include {name} "
                "(the dialects pspice and ltspice include by .lib)"
            )
            yield replace(opened, fault=fault)

    def _included(
        self,
        path: Path,
        line: Line,
        names: list[str],
        section: str | None,
        stack: tuple[tuple[Path, str | None], ...],
    ) -> Iterator[Line]:
        """Yield what an include stands for, or the line with the reason why it cannot be followed."""
        fault = line.fault or ("" if names else "names no file")
        target = path.parent / names[0] if names else path  # an absolute name stands for itself
        place = self._place(target)
        inside = any(place.is_relative_to(self._place(each)) for each in (self.root, *_granted.get()))
        if not fault and not self.trust and not inside:
            lifted = f"--include {target.parent} or --trust allows it"
            fault = f"include leaves the project's folder {self.root} ({lifted})"
        elif not fault and not os.path.isfile(target):
            there = [entry.name for entry in target.parent.iterdir()] if os.path.isdir(target.parent) else []
            near = nearest(target.name, there)
            fault = f"there is no file {target}" + (f"; nearest is {near}" if near else "")
        elif (place, section) in stack:
            fault = "includes itself"
        elif len(stack) > MOST_NESTED:
            fault = f"files include files more than {MOST_NESTED} deep"
        if not fault:
            rows = self.rows(target)
            if section is None or section in self.sections(target):
                yield from self._walk(target, rows, section, stack)
                return
            near = nearest(section, self.sections(target))
            fault = f"{target} has no section '{section}'" + (f", nearest is '{near}'" if near else "")
        yield replace(line, fault=fault)


@lru_cache(maxsize=32)  # a run has its board at two sets of levels, a study at hundreds of sets of values
def _as_meant(content: str, file: str, dialect: Dialect) -> tuple[Line, ...]:
    """Return a file's lines, their values as the dialect means them."""
    rows = [read_over(line) for line in lines_of(content, file, dialect)]
    functions = {line.text.split(None, 1)[-1].partition("(")[0].strip().lower()
                 for line in rows if line.keyword == ".func"}  # fmt: skip
    if dialect is Dialect.LTSPICE:
        rows = as_sources(rows)
    if dialect is not Dialect.NGSPICE:
        rows = [replace(row, text=in_own_words(row.text, dialect, functions)) for row in map(put_right, rows)]
    return tuple(as_meant(line, dialect, functions) for line in rows)


def sections(rows: list[Line], dialect: Dialect = Dialect.NGSPICE) -> list[str]:
    """Return the names of the ``.lib`` sections that `rows` define, in lower case."""
    if dialect.lib_includes and not any(line.keyword == ".endl" for line in rows):
        return []
    arguments = (_arguments(line.text.partition(" ")[2]) for line in rows if line.keyword == ".lib")
    return [arguments[0].lower() for arguments in arguments if len(arguments) == 1]


def _arguments(text: str) -> list[str]:
    """Split the arguments of an include; a name with blanks stands in quotes."""
    parts: list[str] = []
    rest = text.strip()
    while rest and len(parts) < 3:
        end = rest.find(rest[0], 1) if rest[0] in "\"'" else -1
        if end > 0:
            parts.append(rest[1:end])
            rest = rest[end + 1 :].strip()
        else:
            words = rest.split(None, 1)
            parts.append(words[0])
            rest = words[1] if len(words) > 1 else ""
    return parts
