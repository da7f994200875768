"""From files that include files to one list of lines."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from cosim.errors import InputError, Problem, nearest
from cosim.ngspice.form import malformed
from cosim.ngspice.lines import Line, read_lines
from cosim.ngspice.safety import refusal

__all__ = ["Reader", "sections"]


@dataclass(frozen=True)
class Reader:
    """Reads netlists, inlines ``.include`` and ``.lib``, and refuses what is not safe.

    Attributes
    ----------
    root
        Folder that includes may not leave.
    trust
        Whether to allow everything.
    pspice
        Whether the files are in PSpice's dialect.
    """

    root: Path
    trust: bool = False
    pspice: bool = False

    def read(self, path: Path, section: str | None = None) -> list[Line]:
        """Return the lines of `path`, or of one ``.lib`` section of it, with all that they include.

        Raises
        ------
        InputError
            Telling all refused lines, missing files and sections at once.
        """
        problems: list[Problem] = []
        lines = list(self._walk(path, section, (), problems, None))
        if problems:
            raise InputError(problems)
        return lines

    def _walk(
        self,
        path: Path,
        section: str | None,
        stack: tuple[tuple[Path, str | None], ...],
        problems: list[Problem],
        origin: Line | None,
    ) -> Iterator[Line]:
        place = (path.resolve(), section)
        if place in stack:
            problems.append(_at(origin, "includes itself"))
            return
        rows = read_lines(path, pspice=self.pspice)
        if section is not None and section not in sections(rows):
            named = sections(rows)
            near = nearest(section, named)
            problems.append(
                Problem(
                    f"no section '{section}'" + (f", nearest is '{near}'" if near else ""),
                    file=str(path),
                    line=origin.lineno if origin and origin.file == str(path) else None,
                    allowed=", ".join(named) or "the file has no .lib sections",
                )
            )
            return
        inside: str | None = None
        for line in rows:
            words = line.text.split(None, 1)
            arguments = _arguments(words[1]) if len(words) > 1 else []
            if line.keyword == ".lib" and len(arguments) == 1:
                inside = arguments[0].lower()
                continue
            if line.keyword == ".endl":
                inside = None
                continue
            if inside != section:
                continue
            refused = None if self.trust else refusal(line) or malformed(line)
            if refused is not None:
                problems.append(refused)
            elif line.keyword in (".include", ".inc", ".lib"):
                target = self._target(path, line, arguments, problems)
                if target is not None:
                    inner = arguments[1].lower() if line.keyword == ".lib" else None
                    yield from self._walk(target, inner, (*stack, place), problems, line)
            else:
                yield line

    def _target(self, path: Path, line: Line, arguments: list[str], problems: list[Problem]) -> Path | None:
        """Return the file that an include names, relative to the file that states it."""
        if not arguments:
            problems.append(_at(line, "names no file"))
            return None
        target = Path(arguments[0])
        target = target if target.is_absolute() else path.parent / target
        if not self.trust and not target.resolve().is_relative_to(self.root.resolve()):
            problems.append(_at(line, f"include leaves the project's folder {self.root} (--trust allows it)"))
            return None
        if not target.is_file():
            there = [entry.name for entry in target.parent.iterdir()] if target.parent.is_dir() else []
            near = nearest(target.name, there)
            problems.append(
                _at(line, f"there is no file {target}" + (f"; nearest is {near}" if near else ""))
            )
            return None
        return target


def sections(rows: list[Line]) -> list[str]:
    """Return the names of the ``.lib`` sections that `rows` define, in lower case."""
    found = []
    for line in rows:
        if line.keyword == ".lib":
            arguments = _arguments(line.text.split(None, 1)[1]) if len(line.text.split()) > 1 else []
            if len(arguments) == 1:
                found.append(arguments[0].lower())
    return found


def _arguments(text: str) -> list[str]:
    """Split the arguments of an include; a name with blanks stands in quotes."""
    found: list[str] = []
    rest = text.strip()
    while rest:
        if rest[0] in "\"'" and rest.find(rest[0], 1) > 0:
            end = rest.find(rest[0], 1)
            found.append(rest[1:end])
            rest = rest[end + 1 :].strip()
        else:
            word, _, rest = rest.partition(" ")
            found.append(word)
            rest = rest.strip()
    return found


def _at(line: Line | None, message: str) -> Problem:
    if line is None:
        return Problem(message)
    return Problem(message, file=line.file, line=line.lineno, value=line.text)
