"""Netlist text as logical lines that remember where they come from."""

import re
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path

from cosim.errors import fail
from cosim.ngspice.dialect import Dialect
from cosim.storage.bounded_read import read_regular

__all__ = [
    "Line", "assignments", "join", "lines_of", "number", "read_lines", "strange_character", "text_of",
    "tokens",
]  # fmt: skip

MOST_BYTES = 8 << 20
"""Size of a file that is read as a netlist; the largest public library that was met has 3 MB."""

_SCALE = {
    "t": 1e12, "g": 1e9, "meg": 1e6, "k": 1e3, "mil": 25.4e-6, "m": 1e-3,
    "u": 1e-6, "µ": 1e-6, "μ": 1e-6, "n": 1e-9, "p": 1e-12, "f": 1e-15,
}  # fmt: skip
_NUMBER = re.compile(
    r"([-+]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[ed][-+]?[0-9]+)?)(meg|mil|[tgkmuµμnpf])?((?:[^\W0-9_]|[%°])*)",
    re.IGNORECASE,
)
# Some of them end a line for one reader and not for another, some are seen by none but the computer.
_STRANGE = re.compile("[\x00-\x08\x0b-\x1f\x7f-\x9f\u200b-\u200f\u2028-\u202e\u2060-\u2064\ufeff]")
_BLANKS = re.compile(r"\s+")
_MERE_BLANKS = re.compile("[ \t\u00a0\u2000-\u200a\u202f\u205f\u3000]+")
_EQUALS = re.compile(r"(?<![=<>!]) ?= ?(?!=)")
_GROUPED = re.compile(r"[\"'{}()\[\]]")
_COMMENT = re.compile(r"\"[^\"]*\"|'[^']*'|;|//|\$|[^\"';/$]+|.")
_END = re.compile(r"(\.(?:ends|eom))(?![\w\s])", re.IGNORECASE)
_QUOTING = frozenset({".include", ".inc", ".lib"})


@dataclass(frozen=True)
class Line:
    """One statement of a netlist, continuation lines joined, end-of-line comment apart.

    Attributes
    ----------
    text
        The statement.
    file
        File it was read from, or ``""`` for a line of our own.
    lineno
        Number of its first physical line, from 1; 0 for a line of our own.
    comment
        Text of its end-of-line comments, for example ``tol=1% ; Ohm, matched pair``.
    fault
        Why the statement cannot be used, told only if it is needed.
    note
        What was read otherwise than it stands there, in words.
    drawn
        The statement with its distribution functions, where it has any; `text` has their nominal values.
    trusted
        Whether it holds what is refused elsewhere, let through because the user trusts the file.
    """

    text: str
    file: str = ""
    lineno: int = 0
    comment: str = ""
    fault: str = ""
    note: str = ""
    drawn: str = ""
    trusted: bool = False

    @property
    def keyword(self) -> str:
        """First word in lower case."""
        return _first(self.text)

    def rewritten(self, text: str) -> "Line":
        """Return the line with another text and the same origin."""
        return replace(self, text=text)


def read_lines(path: Path, dialect: Dialect = Dialect.NGSPICE) -> list[Line]:
    """Read a netlist into logical lines; comments go, machine-readable ``*@`` comments stay.

    No statement ends the reading: what is wrong with it is told where it is needed.

    Parameters
    ----------
    path
        File to read: UTF-8, UTF-16, or the Western code page of Windows, with any line ends.
    dialect
        Dialect of the file.

    Raises
    ------
    InputError
        If the file cannot be read, is not a regular file, or is larger than `MOST_BYTES`.
    """
    return lines_of(text_of(path), str(path), dialect)


def lines_of(content: str, file: str, dialect: Dialect) -> list[Line]:
    """Return the logical lines of a file's content, which `text_of` has read."""
    lines: list[Line] = []
    for lineno, statements, comments in _statements(content, dialect):
        text = " ".join(statements)
        if _first(text) not in _QUOTING:  # a file's name may hold two blanks in a row
            text = _MERE_BLANKS.sub(" ", text)
        lines.append(Line(text, file, lineno, " ".join(comments)))
    return lines


def strange_character(text: str) -> str | None:
    """Say which character of a statement ends a line for some readers or is not seen, or ``None``."""
    match = _STRANGE.search(text)
    return f"holds control characters or invisible ones: U+{ord(match[0]):04X}" if match else None


def text_of(path: Path) -> str:
    """Return a netlist's text with line feeds only, without the DOS end-of-file mark (see `read_lines`)."""
    try:
        raw = read_regular(path, MOST_BYTES)
    except OSError as error:
        fail(f"cannot read the netlist: {error.strerror or error}", file=str(path))
    text = raw.decode(_encoding(raw), "replace").removeprefix("\ufeff")
    body = text.rstrip("\x1a\0 \t\r\n")
    text = body + text[len(body) :].partition("\x1a")[0]
    if "\0" in text:
        fail("is not a netlist: it holds control characters", file=str(path))
    return text.replace("\r\n", "\n").replace("\r", "\n")


def _encoding(raw: bytes) -> str:
    if raw.startswith((b"\xff\xfe", b"\xfe\xff")):
        return "utf-16"
    for first, name in ((1, "utf-16-le"), (0, "utf-16-be")):
        # of Western text every second byte is zero then
        if raw[first:4096:2].count(0) > 0.9 * len(raw[first:4096:2]) > 0:
            return name
    for name in ("utf-8", "cp1252"):
        try:
            raw.decode(name)
        except UnicodeDecodeError:
            continue
        return name
    return "latin-1"


def _statements(text: str, dialect: Dialect) -> Iterator[tuple[int, list[str], list[str]]]:
    """Yield the number of the first row, the rows and the comments of each statement."""
    number, statement, comments = 0, list[str](), list[str]()
    in_control = False
    for lineno, row in enumerate(text.split("\n"), 1):
        row = row.strip()
        lower = row[:9].lower()
        if not row or (row[0] == "*" and not row.startswith("*@") and not in_control):
            continue
        in_control = in_control or lower.startswith(".control")
        if in_control or row[0] == "*":  # commands have a syntax of their own
            in_control = in_control and not lower.startswith(".endc")
            rest, comment = row, ""
        else:
            rest, comment = _split_comment(row, dialect)
            rest = _END.sub(r"\1 ", rest, count=1) if rest[:1] == "." else rest
        if rest.startswith("+") and statement:
            statement.append(rest[1:].strip())
        elif rest:
            if statement:
                yield number, statement, comments
            number, statement, comments = lineno, [rest], []
        if comment:
            comments.append(comment)
    if statement:
        yield number, statement, comments


def _split_comment(row: str, dialect: Dialect) -> tuple[str, str]:
    """Split at the first ``;``, ``//`` or (preceded by a blank or comma) ``$``, as ngspice does."""
    if ";" not in row and "$" not in row and "//" not in row:
        return row, ""
    for match in _COMMENT.finditer(row):
        at, sign = match.start(), match[0]
        if sign in (";", "//") or (
            sign == "$" and not dialect.dollar_is_letter and (at == 0 or row[at - 1] in " \t,")
        ):
            return row[:at].strip(), row[at:].lstrip(";$/ \t").strip()
    return row, ""


@lru_cache(maxsize=10_000)  # rows are asked for it again and again
def _first(text: str) -> str:
    return text.split(None, 1)[0].lower() if text.strip() else ""


def tokens(text: str) -> list[str]:
    """Split a statement at blanks outside braces, parentheses and quotes; ``a = b`` is one token."""
    return list(_tokens(text))


@lru_cache(maxsize=10_000)  # as `_first`
def _tokens(text: str) -> tuple[str, ...]:
    text = _EQUALS.sub("=", _BLANKS.sub(" ", text))
    if _GROUPED.search(text) is None:
        return tuple(text.split())
    words: list[str] = []
    depth, quote, start = 0, "", 0
    for i, c in enumerate(text):
        if quote:
            quote = "" if c == quote else quote
        elif c in "\"'":
            quote = c
        elif c in "{([":
            depth += 1
        elif c in "})]":
            depth = max(depth - 1, 0)
        elif c == " " and depth == 0:
            words.append(text[start:i])
            start = i + 1
    return tuple(word for word in (*words, text[start:]) if word)


def join(words: list[str]) -> str:
    """Put tokens together again."""
    return " ".join(words)


def assignments(words: list[str]) -> dict[str, str]:
    """Return the ``name=value`` tokens among `words`, names in lower case."""
    pairs = (word.split("=", 1) for word in words if "=" in word)
    return {name.lower(): value for name, value in pairs}


def number(text: str) -> float | None:
    """Return the value of a SPICE number such as ``8.2k``, ``3MEG`` or ``100nF``; ``None`` if it is none.

    ``M`` is milli and ``MEG`` mega; a unit after the scale is ignored. ``1A`` is one ampere.

    Examples
    --------
    >>> number('8.2k'), number('3MEG'), number('1M'), number('ten'), number('1kk'), number('1e')
    (8200.0, 3000000.0, 0.001, None, None, None)
    """
    match = _NUMBER.fullmatch(text.strip())
    if match is None or not _is_unit(match[3].lower(), (match[2] or "").lower()):
        return None
    return float(match[1].lower().replace("d", "e")) * _SCALE.get((match[2] or "").lower(), 1.0)


def _is_unit(text: str, scale: str) -> bool:
    """Whether `text` may follow a number: no second scale (``1kk``, ``1mmeg``), no ``e`` without digits."""
    if text.startswith("meg") or (not text.isascii() and any(c.isnumeric() for c in text)):
        return False
    return text != scale or scale in ("", "m", "f") if scale else text not in ("e", "d")
