"""Values as they are written: what ngspice would read otherwise than it stands there.

ngspice stops reading a number at the first character that does not fit and drops the rest: ``24k3`` is 24k
to it, ``0x10`` is 0 x-something, ``4,7k`` is 7k, ``1kk`` is 1k, ``1e`` is 1 and ``1k 5%`` is 5 Ohm. Such a
value is translated where the file's dialect gives it a meaning, else it is a fault. What one ngspice reads
otherwise than another is written so that all read the same. Distribution functions give their nominal value:
tolerances are drawn elsewhere, once for each placed component and repeatably.
"""

import re
from collections.abc import Callable, Collection, Iterator
from dataclasses import replace

from cosim.ngspice.dialect import Dialect
from cosim.ngspice.lines import Line, join, number, tokens
from cosim.ngspice.model_tolerances import as_elements_mean, without_tolerances

__all__ = ["as_meant", "nominal"]

#: Distribution function -> number of arguments -> whether its nominal value is the first argument, else 0.
_DISTRIBUTIONS = {
    "agauss": {3: True}, "gauss": {3: True, 1: False}, "aunif": {2: True}, "unif": {2: True},
    "limit": {2: True}, "mc": {2: True}, "flat": {1: False},
}  # fmt: skip
MOST_DRAWN = 100
"""Calls of distribution functions in one statement."""
_CALL = re.compile(rf"(?<![\w.])({'|'.join(_DISTRIBUTIONS)})\s*\(", re.IGNORECASE)
_MICRO = re.compile(r"(?<![\w.])(\d+\.?\d*|\.\d+)(e[-+]?\d+)?[µμ]", re.IGNORECASE)
#: An ampere: ngspice 39 drops the letter, 44 takes it for atto. An electronvolt: 47 misses digits behind e.
_UNIT_INSIDE = re.compile(
    r"(?<![\w.$#:@])((?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:e[-+]?[0-9]+)?)(?:a[a-z]*|e[a-z]+)(?![\w.])",
    re.IGNORECASE,
)
#: A thousandth of an inch: 25.4u to an element of ngspice, but 1m to a parameter.
_MIL_INSIDE = re.compile(
    r"(?<![\w.$#:@])((?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:e[-+]?[0-9]+)?)mils?(?![\w.])", re.IGNORECASE
)
_MEGA_MEANT = re.compile(r"(?<![\w.])([0-9.]+)M(Hz|Ohms?|Ω)(?!\w)")
_RKM = re.compile(r"([-+]?\d+)(meg|mil|[tgkmunpfar])(\d+)([^\W\d_]*)", re.IGNORECASE)
_RKM_INSIDE = re.compile(rf"(?<![\w.$#:@]){_RKM.pattern}(?![\w.])", re.IGNORECASE)
_PROBE = re.compile(r"\b[vi]\([^()]*\)", re.IGNORECASE)
_NUMERIC = re.compile(r"[-+]?(\d|\.\d)")
_OPERATOR = re.compile(r"[*/^?<>&|!{}'\"()]|(?<![ed])[-+]", re.IGNORECASE)
_PARTS = re.compile(r"[\s(){}\[\],]+")
_DECIMAL_COMMA = re.compile(r"=\s*([-+]?[0-9]+,[0-9]\w*)")
_POLY = re.compile(r"poly\s*\(\s*(\d+)\s*\)", re.IGNORECASE)
_SUSPECT = re.compile(
    r"(?![0-9])\d|\d[^\x00-\x7f]|\d[a-z]_|\d[^\W\d_]+[\d.]|\d[^\s\w.=(){}*/+\-\"^]|\d_|[µμ]|\d\s+[\d.]|\d\.\d*\."
    r"|\d\.?(?:[ed](?![-+\w]|\s*=)|e[-+](?!\d)|([kunpgt])\1|[a-z]+meg|mil|a|e[a-z]|mhz|mohm|mΩ)|[ =]\.(?!\w)",
    re.IGNORECASE,
)
#: Statements of which the words can hold values.
_VALUED = frozenset({".param", ".params", ".csparam", ".model", ".func"})
#: Model parameters whose value is a name.
_NAMES = ("mfg=", "type=")


def as_meant(line: Line, dialect: Dialect, functions: Collection[str] = ()) -> Line:
    """Return a statement with the values that its author meant, with a fault where that is not known.

    Parameters
    ----------
    line
        The statement.
    dialect
        Dialect of its file.
    functions
        Names of the functions that the file itself defines, in lower case: they mean what it says.
    """
    text = line.text
    if text.startswith("*@") or line.fault:
        return line
    if line.keyword == ".model":
        line = without_tolerances(line)
    elif text[0] in "rclRCL":
        line = as_elements_mean(line)
    if line.fault:
        return line
    text = line.text
    if dialect is Dialect.LTSPICE and text[0] in "aA":
        return replace(line, fault="an A device of LTspice's, which no other simulator has")
    if "(" in text:
        text, drawn = nominal(text, functions)
        if len(drawn) > MOST_DRAWN:
            return replace(line, fault="draws too many values")
        if drawn:
            note = f"{', '.join(drawn)} taken at the nominal value: {text}"
            line = replace(line, text=text, note=note, drawn=line.drawn or line.text)
    if _SUSPECT.search(text) is None:
        return replace(line, fault=_second_value(line) or "")
    text = _MICRO.sub(r"\1\2u", text)
    if dialect.reads_rkm:
        text = _translated(text, _RKM_INSIDE, _with_point)
    text = _translated(text, _UNIT_INSIDE, lambda match: match[1])
    text = _translated(text, _MIL_INSIDE, lambda match: f"{float(match[1]) * 25.4:.12g}u")
    line = line.rewritten(text)
    for value in _values(line):
        if (_NUMERIC.match(value) or value == ".") and number(value) is None:
            return replace(line, fault=_fault(value))
    if (mega := _MEGA_MEANT.search(text)) is not None:
        note = f"{mega[0]} is {mega[1]} m{mega[2]}: in SPICE m and M are milli, write {mega[1]}meg for mega"
        line = replace(line, note=f"{line.note}; {note}" if line.note else note)
    return replace(line, fault=_second_value(line) or "")


def nominal(text: str, functions: Collection[str] = ()) -> tuple[str, list[str]]:
    """Replace calls of distribution functions by their nominal value; return their names as well."""
    drawn: list[str] = []
    at = 0
    while len(drawn) <= MOST_DRAWN and (call := _CALL.search(text, at)) is not None:
        name = call[1].lower()
        arguments, end = _arguments(text, call.end())
        first = _DISTRIBUTIONS[name].get(len(arguments))
        at = call.end()
        if end is None:
            break  # the form is told elsewhere
        if first is None or name in functions or text[:5].lower() == ".func":
            continue  # a clamp, or no call at all
        drawn.append(name)
        value = arguments[0].strip() if first else "0"
        simple = re.fullmatch(r"[\w.]+", value)
        text = f"{text[: call.start()]}{value if simple else f'({value})'}{text[end:]}"
        at = call.start()
    return text, drawn


def _arguments(text: str, start: int) -> tuple[list[str], int | None]:
    """Return the arguments of a call that opens before `start`, and the place behind it."""
    depth, words, begin = 1, list[str](), start
    for i in range(start, len(text)):
        c = text[i]
        if c in "([":
            depth += 1
        elif c in ")]":
            depth -= 1
        if (c == "," and depth == 1) or depth == 0:
            words.append(text[begin:i])
            begin = i + 1
        if depth == 0:
            return words, i + 1
    return words, None


def _fault(value: str) -> str:
    rkm = _RKM.fullmatch(value)
    if rkm is None:
        why = " (digits must be 0 to 9)" if any(c.isnumeric() and not c.isascii() for c in value) else ""
        return f"{value} is not a SPICE number: ngspice reads its beginning and drops the rest{why}"
    scale = "" if rkm[2].lower() == "r" else rkm[2]
    return (
        f"{value}: ngspice reads {rkm[1]}{scale} and drops what stands behind; "
        f"write {rkm[1]}.{rkm[3]}{scale}, or read the file in dialect ltspice"
    )


def _with_point(match: re.Match[str]) -> str:
    """Write a value with its scale in place of the point the usual way."""
    scale = "" if match[2].lower() == "r" else match[2]
    return f"{match[1]}.{match[3]}{scale}"


def _translated(text: str, pattern: re.Pattern[str], written: Callable[[re.Match[str]], str]) -> str:
    """Write every value that matches `pattern` otherwise, nodes left alone."""
    if pattern.search(text) is None:
        return text

    def outside(piece: str) -> str:
        """Translate an expression, the arguments of V() and I() left alone."""
        kept, at = [], 0
        for probe in _PROBE.finditer(piece):
            kept += [pattern.sub(written, piece[at : probe.start()]), probe[0]]
            at = probe.end()
        return "".join([*kept, pattern.sub(written, piece[at:])])

    words = tokens(text)
    first = _first_value(words)
    return join([*words[:first], *(_pair(word, outside) for word in words[first:])])


def _pair(word: str, translate: Callable[[str], str]) -> str:
    name, equals, value = word.partition("=")
    return f"{name}={translate(value)}" if equals else translate(word)


def _first_value(words: list[str]) -> int:
    """Return the place of the first token that can hold a value and is no node and no name."""
    letter = words[0][0].lower()
    if letter in "rclvi":
        return 3
    if letter in "egfh":
        place, ports = (3, 2) if letter in "eg" else (3, 1)
        poly = _POLY.fullmatch(words[3]) if len(words) > 3 else None
        if poly is None:
            return place if len(words) > 3 and "=" in words[3] else place + ports
        wanted, place = int(poly[1]) * ports, 4
        while wanted > 0 and place < len(words):
            wanted -= len([part for part in _PARTS.split(words[place]) if part])
            place += 1
        return place
    if letter == "b":
        return 3
    if words[0].lower() in _VALUED:
        return 2 if words[0].lower() == ".model" else 1
    if letter == "." and words[0].lower() != ".subckt":
        return len(words)
    return next((i for i, word in enumerate(words) if "=" in word), len(words))


def _values(line: Line) -> Iterator[str]:
    """Yield what must be a whole number if it begins like one."""
    words = tokens(line.text)
    letter = words[0][0].lower()
    for word in words[_first_value(words) :]:
        name, equals, value = word.partition("=")
        if letter == ".":
            if line.keyword == ".model":
                yield from _settings(word)
            elif equals and line.keyword in (".param", ".params", ".csparam", ".subckt"):
                yield from _plain(value)
        elif equals and letter != "b" and not name.lower().endswith(("value", "table")):
            yield from _plain(value) if letter not in "rclkxdqjmswt" or "," not in value else ()
        elif not equals and letter in "vi":
            yield from _PARTS.split(word.rstrip(",")) if "(" in word else [word.rstrip(",")]
        elif not equals and letter in "rcl":
            yield word.rstrip(",")
        elif not equals and letter in "egfh":
            yield from _plain(word)


def _plain(value: str) -> Iterator[str]:
    if _OPERATOR.search(value) is None:
        yield value.rstrip(",")


def _settings(word: str) -> Iterator[str]:
    """Yield the numbers among a model's ``(name=value ...)``."""
    yield from _DECIMAL_COMMA.findall(word)
    for part in _PARTS.split(word):
        _, equals, value = part.partition("=")
        if equals and not part.lower().startswith(_NAMES):
            yield from _plain(value)


def _second_value(line: Line) -> str | None:
    """Say where a resistor, capacitor or inductor has two values: ngspice takes the last one."""
    if line.text[0] not in "rclRCL":
        return None
    if line.text.count(" ") < 4:
        return None
    plain = [word for word in tokens(line.text)[3:] if "=" not in word]
    numbers = [word for word in plain if number(word) is not None or word[0] in "{'"]
    if len(numbers) < 2:
        return None
    return f"has two values, {numbers[0]} and {numbers[1]}: ngspice takes the last one"
