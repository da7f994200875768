"""A tolerance as it is written behind a value: ``tol=1%``, ``lot=5% dev=1% uniform``, ``match=net1``."""

from __future__ import annotations

import csv
import io
import math
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path

from cosim.ngspice.flatten import readable
from cosim.ngspice.lines import number
from cosim.storage.bounded_read import read_regular
from cosim.tolerance.distributions import SIGMAS, Histogram, Kind, Shape

__all__ = ["Stated", "Wrong", "begins", "parse", "shape_before"]

_BEGIN = re.compile(r"(?<![\w.])(tol|lot|dev|match|histogram)\s*=", re.IGNORECASE)
_SHAPE_BEFORE = re.compile(
    r"(?<![\w.-])(uniform|flat|gauss|gaussian|normal|truncated|sorted\s*\([^)]*\)|sigmas\s*=\s*[^\s;,]+)[\s,]*$",
    re.IGNORECASE,
)
_WORD = re.compile(r"[^\s(=]+\s*\([^)]*\)|[^\s=]+\s*=\s*[^\s]+|\S+")
_SHAPES: dict[str, Kind] = {
    "gauss": "gauss", "gaussian": "gauss", "normal": "gauss", "truncated": "truncated", "uniform": "uniform",
    "flat": "uniform",
}  # fmt: skip
_KEYS = ("tol", "lot", "dev", "match", "sigmas", "histogram")
_MOST_BYTES = 4 << 20
MOST_SIGMAS = 12.0


class Wrong(Exception):
    """A tolerance that cannot be; the message says why."""


@dataclass(frozen=True)
class Stated:
    """A tolerance as it is stated.

    Attributes
    ----------
    own
        Deviation that each component draws for itself.
    shared
        Deviation that all components of a lot or network have in common.
    match
        Name of the network within which `shared` is drawn; ``board:`` before it: one on the whole board.
        Empty for a lot of all that use the value.
    """

    own: Shape | None = None
    shared: Shape | None = None
    match: str = ""


def begins(comment: str) -> str | None:
    """Return the part of a comment that states a tolerance; ``None`` where it states none.

    It ends at a semicolon, behind which words for people stand.
    """
    match = _BEGIN.search(comment)
    return comment[match.start() :].partition(";")[0].strip() if match else None


def shape_before(comment: str) -> str:
    """Return the shape that stands right before a comment's tolerance, where nothing reads it; else nothing.

    Examples
    --------
    >>> shape_before('uniform tol=5%'), shape_before('tol=5% uniform'), shape_before('flat pack; tol=5%')
    ('uniform', '', '')
    """
    tolerance = _BEGIN.search(comment)
    shape = _SHAPE_BEFORE.search(comment[: tolerance.start()]) if tolerance else None
    return shape[1] if shape else ""


def parse(text: str, folder: Path | None = None, inside: Sequence[Path] | None = ()) -> Stated:
    """Read a tolerance.

    Parameters
    ----------
    text
        As it stands in the comment, or in the scene, where a bare "1%" is ``tol=1%``.
    folder
        Folder that a histogram's file is in; none: there can be no file.
    inside
        Folders besides it that the file may lie in; none: anywhere.

    Raises
    ------
    Wrong
        For anything that cannot be read, and for an impossible one.
    """
    words: dict[str, str] = {}
    shape: tuple[Kind, float] | None = None
    bare = text.strip().rstrip(";,").strip()
    if not bare:
        raise Wrong("states nothing")
    for place, word in enumerate(_WORD.findall(_tight(bare))):
        name, equals, value = (part.strip() for part in word.partition("="))
        lower = word.lower().rstrip(",")
        if equals and name.lower() in _KEYS and "=" not in value:
            if name.lower() in words:
                raise Wrong(f"{name} is stated twice")
            words[name.lower()] = value.rstrip(",")
        elif lower in _SHAPES or lower.startswith("sorted"):
            if shape is not None:
                raise Wrong("states two shapes")
            shape = (_SHAPES[lower], 0.0) if lower in _SHAPES else ("sorted", _inner(lower))
        elif place == 0 and not equals:
            words["tol"] = lower
        else:
            keys = ", ".join(f"{key}=" for key in _KEYS)
            raise Wrong(
                f"'{word}' is no part of a tolerance ({keys}, uniform, gauss, truncated, "
                "sorted(inner=1%)); words for people stand behind a semicolon"
            )
    return _built(words, shape or ("truncated", 0.0), folder, inside)


def _built(
    words: dict[str, str], shape: tuple[Kind, float], folder: Path | None, inside: Sequence[Path] | None
) -> Stated:
    sigmas = number(words["sigmas"]) if "sigmas" in words else SIGMAS
    if sigmas is None or not 0.0 < sigmas <= MOST_SIGMAS:
        raise Wrong(f"sigmas = {words['sigmas']} (allowed: > 0 and <= {MOST_SIGMAS:g})")
    if "tol" in words and ("dev" in words) and "match" not in words:
        raise Wrong("tol and dev are two words for one thing")
    if "tol" in words and "lot" in words:
        raise Wrong("tol and lot cannot both be stated: what each component has for itself is dev")
    make: Callable[[str], Shape] = lambda key: _shape(words[key], key, shape, sigmas)  # noqa: E731
    if "histogram" in words:
        if {"tol", "lot", "dev"} & words.keys():
            raise Wrong("a histogram stands instead of tol, lot and dev")
        return Stated(own=_measured(words["histogram"], folder, inside))
    if "match" in words:
        if words["match"].rpartition(":")[0] not in ("", "board") or not words["match"].rpartition(":")[2]:
            raise Wrong(f"match = {words['match']} (allowed: the name of a network, or board: and the name)")
        size = "lot" if "lot" in words else "tol"
        return Stated(
            make("dev") if "dev" in words else None,
            make(size) if size in words else None,
            words["match"].lower(),
        )
    if "lot" in words:
        return Stated(make("dev") if "dev" in words else None, make("lot"))
    return Stated(make("dev" if "dev" in words else "tol"))


def _shape(text: str, key: str, shape: tuple[Kind, float], sigmas: float) -> Shape:
    low, high, relative = _limits(text, key)
    kind, inner = shape
    distribution = Shape(kind, low, high, sigmas, inner, relative)
    if kind == "sorted":
        if not relative:
            raise Wrong("sorted needs a tolerance in per cent")
        if not 0.0 < inner < min(high, -low):
            raise Wrong(f"sorted(inner={100 * inner:g}%) leaves nothing of {key} = {text}")
    return distribution


def _limits(text: str, key: str) -> tuple[float, float, bool]:
    """Return least and largest deviation, and whether they are shares."""
    parts = [part.strip() for part in re.split(r"[/,]", text.removeprefix("+-").removeprefix("±"))]
    read = [(_finite(part.removesuffix("%")), part.endswith("%")) for part in parts]
    if len(read) > 2 or any(value is None for value, _ in read) or len({share for _, share in read}) > 1:
        raise Wrong(
            f"{key} = {text} is no tolerance (allowed: 1%, -1%/+2%, or an amount in the value's unit)"
        )
    relative = read[0][1]
    sizes = [(value or 0.0) / (100.0 if relative else 1.0) for value, _ in read]
    low, high = (-sizes[0], sizes[0]) if len(sizes) == 1 else (min(sizes), max(sizes))
    if not low <= 0.0 <= high or (len(sizes) == 1 and sizes[0] < 0.0):
        raise Wrong(f"{key} = {text}: the deviations are negative, or both to one side")
    if low == high:
        raise Wrong(f"{key} = {text} is no deviation at all: leave it out")
    return low, high, relative


def _finite(text: str) -> float | None:
    value = number(text) if "%" not in text else None  # to `number` a sign of per cent is a unit
    return value if value is not None and math.isfinite(value) else None


def _inner(word: str) -> float:
    match = re.fullmatch(r"sorted\s*\(\s*(?:inner\s*=\s*)?([^)\s]+)%\s*\)", word)
    inner = number(match[1]) if match else None
    if inner is None:
        raise Wrong(f"'{word}' must look like sorted(inner=1%)")
    return inner / 100.0


def _tight(text: str) -> str:
    """Take out the blanks around the equals signs and commas of a tolerance, and before per cent."""
    return re.sub(r"\s+%", "%", re.sub(r"\s*([=,/])\s*", r"\1", text))


def _measured(name: str, folder: Path | None, inside: Sequence[Path] | None) -> Shape:
    """Read a histogram: CSV with the column ``percent``, or with ``from,to,count`` in per cent."""
    if folder is None:
        raise Wrong("a histogram has no file here")
    file = folder / name
    if inside is not None and not readable(file, (folder, *inside)):
        raise Wrong(
            f"the histogram {file} lies outside the project's folder "
            f"(--include {file.resolve().parent} or --trust allows it)"
        )
    try:
        rows = list(csv.reader(io.StringIO(read_regular(file, _MOST_BYTES).decode("utf-8-sig"))))
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise Wrong(f"cannot read the histogram {file}: {error}") from None
    # what is in a file that is no histogram is not repeated: it may be anything
    head = [cell.strip().lower() for cell in rows[0]] if rows else []
    try:
        data = [[float(cell) for cell in row] for row in rows[1:] if row]
    except ValueError:
        raise Wrong(f"{file}: what follows the heading must be rows of numbers") from None
    if any(len(row) != len(head) for row in data) or any(
        abs(x) > 1e30 or x != x for row in data for x in row
    ):
        raise Wrong(f"{file}: rows of finite numbers, {len(head)} each, must follow the heading")
    if head == ["percent"] and len(data) >= 2:
        values = sorted(row[0] / 100.0 for row in data)
        shares = [k / (len(values) - 1) for k in range(len(values))]
        edges = _apart(values, file)
        shape = Histogram(edges, tuple(shares), file.name)
    elif head == ["from", "to", "count"] and data:
        shape = _binned(data, file)
    else:
        raise Wrong(
            f"{file} must have the heading percent (one measured part a row), or from,to,count (per cent)"
        )
    return Shape("histogram", min(shape.edges[0], 0.0), max(shape.edges[-1], 0.0), histogram=shape)


def _apart(values: list[float], file: Path) -> tuple[float, ...]:
    if values[0] == values[-1]:
        raise Wrong(f"{file}: all parts are equal")
    return tuple(values)


def _binned(data: list[list[float]], file: Path) -> Histogram:
    data = sorted(data)
    if any(row[0] >= row[1] or row[2] < 0 for row in data) or any(a[1] > b[0] for a, b in pairwise(data)):
        raise Wrong(f"{file}: bins must be wider than nothing, not overlap, and hold no negative count")
    total = sum(row[2] for row in data)
    if total <= 0.0:
        raise Wrong(f"{file}: all bins are empty")
    edges, shares, below = list[float](), list[float](), 0.0
    for low, high, count in data:
        edges += [low / 100.0, high / 100.0]
        shares += [below / total, (below + count) / total]
        below += count
    return Histogram(tuple(edges), tuple(shares), file.name)


def merged(stated: Stated, under: Stated | None) -> Stated:
    """Return a tolerance whose shared draw has the size of `under` where it states none."""
    if under is None or stated.shared is not None or not stated.match:
        return stated
    return replace(stated, shared=under.shared or under.own)
