"""Netlist text as logical lines that remember where they come from."""

import re
from dataclasses import dataclass, replace
from pathlib import Path

from cosim.errors import fail

__all__ = ["Line", "assignments", "join", "number", "read_lines", "tokens"]

_SCALE = {
    "t": 1e12, "g": 1e9, "meg": 1e6, "k": 1e3, "mil": 25.4e-6, "m": 1e-3,
    "u": 1e-6, "µ": 1e-6, "n": 1e-9, "p": 1e-12, "f": 1e-15, "a": 1e-18,
}  # fmt: skip
_NUMBER = re.compile(
    r"([-+]?(?:\d+\.?\d*|\.\d+)(?:e[-+]?\d+)?)(meg|mil|[tgkmuµnpfa])?[a-zµΩ%]*", re.IGNORECASE
)
_CONTROL_CHARACTER = re.compile("[\x00-\x08\x0b-\x1f\x7f\x85\u2028\u2029]")
_EQUALS = re.compile(r"(?<![=<>!])\s*=\s*(?!=)")


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
    """

    text: str
    file: str = ""
    lineno: int = 0
    comment: str = ""

    @property
    def keyword(self) -> str:
        """First word in lower case."""
        return self.text.split(None, 1)[0].lower() if self.text.strip() else ""

    def rewritten(self, text: str) -> "Line":
        """Return the line with another text and the same origin."""
        return replace(self, text=text)


def read_lines(path: Path, *, pspice: bool = False) -> list[Line]:
    """Read a netlist into logical lines; comments go, machine-readable ``*@`` comments stay.

    Parameters
    ----------
    path
        File to read, UTF-8 or Latin-1.
    pspice
        Whether ``$`` is a letter like any other (PSpice) and not the start of a comment.

    Raises
    ------
    InputError
        If the file cannot be read or starts with a continuation line.
    """
    try:
        raw = path.read_bytes()
    except OSError as error:
        fail(f"cannot read the netlist: {error.strerror or error}", file=str(path))
    try:
        text = raw.decode("utf-8-sig")
    except UnicodeDecodeError:
        text = raw.decode("latin-1")
    text = text.replace("\r\n", "\n").replace("\r", "\n")
    if _CONTROL_CHARACTER.search(text):  # some end a line for one reader and not for another
        fail("is not a netlist: it holds control characters", file=str(path))
    lines: list[Line] = []
    in_control = False
    for lineno, row in enumerate(text.split("\n"), 1):
        row = row.strip()
        if row.lower().startswith(".control"):
            in_control = True
        if in_control:  # commands have a syntax of their own
            in_control = not row.lower().startswith(".endc")
            if row:
                lines.append(Line(row, str(path), lineno))
            continue
        if row.startswith("*") and not row.startswith("*@"):
            continue
        statement, comment = (row, "") if row.startswith("*@") else _split_comment(row, pspice)
        if statement.startswith("+"):
            if not lines:
                fail("a continuation line without a line before it", file=str(path), line=lineno, value=row)
            last = lines[-1]
            lines[-1] = replace(
                last,
                text=f"{last.text} {statement[1:].strip()}".rstrip(),
                comment=f"{last.comment} {comment}".strip(),
            )
        elif statement:
            lines.append(Line(statement, str(path), lineno, comment))
    return lines


def _split_comment(row: str, pspice: bool) -> tuple[str, str]:
    """Split at the first ``;``, ``//`` or (preceded by a blank or comma) ``$``, as ngspice does."""
    quote = ""
    for i, c in enumerate(row):
        if quote:
            quote = "" if c == quote else quote
        elif c in "\"'" and row.count(c, i) > 1:
            quote = c
        elif (
            c == ";"
            or row.startswith("//", i)
            or (c == "$" and not pspice and (i == 0 or row[i - 1] in " \t,"))
        ):
            return row[:i].strip(), row[i:].lstrip(";$/ \t").strip()
    return row, ""


def tokens(text: str) -> list[str]:
    """Split a statement at blanks outside braces, parentheses and quotes; ``a = b`` is one token."""
    found: list[str] = []
    depth, quote, current = 0, "", ""
    for c in _EQUALS.sub("=", text):
        if quote:
            quote = "" if c == quote else quote
        elif c in "\"'":
            quote = c
        elif c in "{([":
            depth += 1
        elif c in "})]":
            depth = max(depth - 1, 0)
        elif c.isspace() and depth == 0:
            if current:
                found.append(current)
            current = ""
            continue
        current += c
    return [*found, current] if current else found


def join(words: list[str]) -> str:
    """Put tokens together again."""
    return " ".join(words)


def assignments(words: list[str]) -> dict[str, str]:
    """Return the ``name=value`` tokens among `words`, names in lower case."""
    pairs = (word.split("=", 1) for word in words if "=" in word)
    return {name.lower(): value for name, value in pairs}


def number(text: str) -> float | None:
    """Return the value of a SPICE number such as ``8.2k``, ``3MEG`` or ``100nF``; ``None`` if it is none.

    ``M`` is milli and ``MEG`` mega; a unit after the scale is ignored.
    """
    match = _NUMBER.fullmatch(text.strip())
    if match is None:
        return None
    return float(match[1]) * _SCALE.get((match[2] or "").lower(), 1.0)
