"""Numbers with a unit in the prose of a page, and what on the same page accounts for them.

A number is accounted for if the page types it (a command, a file, code within a line) or if it rounds what a
checked output, or a check behind a comment, holds. `tests/test_quoted_numbers.py` knows all others.
"""

import re
from dataclasses import dataclass

from doc_blocks import blocks

UNITS = (
    "kN/m", "N/m", "N s/m", "N", "mm", "m", "mrad", "rad", "°", "V/rad", "V", "A", "kHz", "Hz", "dB", "µs",
    "ms", "s", "minutes?", "seconds?", "hours?", "%", "MB", "samples", "devices", "errors",
)  # fmt: skip
_NUMBER = r"[-+±]?\d[\d.]*\d(?:e[-+]?\d+)?|[-+±]?\d"
_QUOTED = re.compile(
    rf"(?<![\w./-])(?P<first>{_NUMBER})(?P<more>(?: (?:and|to) (?:{_NUMBER}))?) ?"
    rf"(?P<unit>{'|'.join(UNITS)})(?![\w/])"
)
_ANY = re.compile(r"(?<![\w.])-?\d+(?:\.\d+)?(?:e[-+]?\d+)?")
_PREFIX = {"k": 1e3, "M": 1e6, "m": 1e-3, "µ": 1e-6}
_FENCE = r"^ *```.*?^ *```$"
#: What is no prose: front matter, fences, comments, code, targets of links, displayed equations.
_NO_PROSE = (r"\A---\n.*?^---$", _FENCE, r"<!--.*?-->", r"`[^`]*`", r"(?<=\])\([^)]*\)", r"\$\$.*?\$\$")


@dataclass(frozen=True)
class Quoted:
    """A number of a sentence: its digits, its unit, and where the pair stands in `prose`."""

    number: str
    unit: str
    start: int
    stop: int


def prose(text):
    """Return a page's sentences on one line."""
    for pattern in _NO_PROSE:
        text = re.sub(pattern, "", text, flags=re.MULTILINE | re.DOTALL)
    return " ".join(text.split())


def quoted(text):
    """Return the numbers with a unit in a page's sentences."""
    return [
        Quoted(number.lstrip("+±"), match["unit"], match.start(), match.end())
        for match in _QUOTED.finditer(prose(text))
        for number in (match["first"], *_ANY.findall(match["more"]))
    ]


def unaccounted(page, known=()):
    """Return the quoted numbers that neither the page nor a known phrase accounts for, with their words."""
    typed, held = _numbers(page)
    sentences = prose(page)
    spans = [match.span() for phrase in known for match in re.finditer(re.escape(phrase), sentences)]
    return [
        f"{each.number} {each.unit}: … {sentences[max(0, each.start - 50) : each.stop + 20]} …"
        for each in quoted(page)
        if not _is_typed(each, typed)
        and not _rounds(each, held)
        and not any(start <= each.start and each.stop <= stop for start, stop in spans)
    ]


def _numbers(page):
    typed, held = [], []
    for block in blocks(page):
        checked = block.kind == "check" or block.mark.startswith("output ")
        (held if checked else typed).extend(float(each) for each in _ANY.findall(block.text))
    for code in re.findall(r"`([^`\n]+)`", re.sub(_FENCE, "", page, flags=re.MULTILINE | re.DOTALL)):
        typed += [float(each) for each in _ANY.findall(code)]
    return typed, held


def _is_typed(each, typed):
    scale = _PREFIX.get(each.unit[0], 1.0) if len(each.unit) > 1 else 1.0
    return any(abs(float(each.number) * factor - value) <= 1e-9 for factor in (1.0, scale) for value in typed)


def _rounds(each, held):
    digits = len(each.number.partition(".")[2])
    shares = (1.0, 100.0) if each.unit == "%" else (1.0,)
    return any(
        abs(round(value * share, digits)) == abs(float(each.number)) for value in held for share in shares
    )
