"""LTspice's idealised diodes as sources that ngspice knows.

A ``.model`` of type D with Ron, Roff, Vfwd, Vrev or Rrev is no junction in LTspice: it is straight in three
regions (LTspice help, `D. Diode`). ngspice passes over these parameters without a word and puts its default
junction there, which clamps at 0.7 V what was to be clamped at Vfwd.
"""

import re
from collections.abc import Iterator, Sequence
from dataclasses import replace

from cosim.ngspice.lines import Line, number, tokens

__all__ = ["as_sources"]

_MODEL = re.compile(r"\.model (\S+) d ?(?:\((.*)\)|(.*))", re.IGNORECASE)
_SETTING = re.compile(r"(\w+) ?= ?(\{[^{}]*\}|[^\s,]+)")
_IDEAL = frozenset("ron roff vfwd vrev rrev".split())
#: The corners can be a little round, which is left out, and the currents limited, which is not read.
_ROUND, _LIMITS = frozenset(("epsilon", "revepsilon")), frozenset(("ilimit", "revilimit"))


def as_sources(rows: Sequence[Line]) -> list[Line]:
    """Return the rows of a file with a source and a resistor in place of each idealised diode ``d1``.

    The resistor ``rd1_off`` is what it shows while it is off, the source ``bd1`` is the rest.
    """
    models = {key: values if _IDEAL & set(values) else None for key, values in _models(rows)}
    if not any(models.values()):
        return list(rows)
    out: list[Line] = []
    for scopes, line in _scoped(rows):
        words = tokens(line.text)
        values = next(
            (models[key] for s in reversed(scopes) if (key := (s, words[3].lower())) in models), None
        ) if line.keyword[:1] == "d" and len(words) > 3 else None  # fmt: skip
        out += [line] if values is None else _regions(line, words, values)
    return out


def _scoped(rows: Sequence[Line]) -> Iterator[tuple[list[int], Line]]:
    """Yield each row with the numbers of the subcircuits around it, the file's own, 0, first."""
    scopes, count = [0], 0
    for line in rows:
        if line.keyword == ".subckt":
            count += 1
            scopes.append(count)
        elif line.keyword in (".ends", ".eom") and len(scopes) > 1:
            scopes.pop()
        yield list(scopes), line


def _models(rows: Sequence[Line]) -> Iterator[tuple[tuple[int, str], dict[str, str]]]:
    """Yield scope and name of every model, with the parameters of a diode's."""
    for scopes, line in _scoped(rows):
        if line.keyword != ".model":
            continue
        match = _MODEL.fullmatch(line.text)
        if match is None:
            yield (scopes[-1], "".join(tokens(line.text)[1:2]).partition("(")[0].lower()), {}
        else:
            text = (match[2] or match[3] or "").lower()
            yield (scopes[-1], match[1].lower()), dict(_SETTING.findall(text))


def _regions(line: Line, words: list[str], values: dict[str, str]) -> list[Line]:
    beyond = [word for word in words[4:] if word.lower() != "off"] + sorted(_LIMITS & set(values))
    if beyond:
        return [replace(line, fault=f"LTspice's idealised diode is not read with {', '.join(beyond)}")]
    name, plus, minus = words[:3]
    ron, roff = _plain(values.get("ron", "1")), _plain(values.get("roff", "1t"))
    volts = f"v({plus},{minus})"
    formula = f"max({volts}-({_plain(values.get('vfwd', '0'))}),0)*(1/({ron})-1/({roff}))"
    if "vrev" in values:
        rrev = _plain(values.get("rrev", values.get("ron", "1")))
        formula += f"-max(-{volts}-({_plain(values['vrev'])}),0)*(1/({rrev})-1/({roff}))"
    told = ", its round corners left out" if _ROUND & set(values) else ""
    note = f"{name} is an idealised diode of LTspice: read as a source and a resistor{told}"
    return [
        replace(line, text=f"b{name} {plus} {minus} i={formula}", note=note),
        replace(line, text=f"r{name}_off {plus} {minus} {roff}"),
    ]


def _plain(value: str) -> str:
    """Return a number without its scale and unit; other values stay."""
    known = number(value)
    return repr(known) if known is not None else value
