"""Forms that PSpice and LTspice accept and ngspice does not, or not everywhere, corrected for ngspice.

Vendors' models were tried on PSpice, which counts no parentheses in a table, takes a comma between nodes for
a blank and asks for no sign of equality behind `TC`. ngspice counts, takes two nodes with a comma for one,
and a coefficient for the resistor's value. LTspice's B sources can have a resistor in parallel, `rpar`.
A parenthesis too many or too few at the end of a ``.model`` is nothing to any of the three, one too many at
the end of a ``.subckt`` is nothing to ngspice as long as every instance states the parameter before it.
"""

import re
from dataclasses import replace

from cosim.ngspice.lines import Line, number, tokens
from cosim.ngspice.syntax import balanced

__all__ = ["put_right", "read_over"]

_TABLE = re.compile(r"([eg]\S* \S+ \S+ table ?(?:\{[^{}]*\}|'[^']*') ?=?)(.*)", re.IGNORECASE)
_COMMA = re.compile(r",(?![^(){}']*[)}'])")
_POLY = re.compile(r"([efgh]\S* .*?poly ?\( ?\d+ ?\))((?: ?, ?\([^()]*\))+)(?= |$)", re.IGNORECASE)
_APART = re.compile(r"[\s(),]+")
_COEFFICIENTS = re.compile(r"([rcl]\S* \S+ \S+ .*?)\btc ([^\s=,]+)(?:[\s,]+([^\s=,]+))?", re.IGNORECASE)
_PARALLEL = re.compile(r"(b\S* (\S+) (\S+)) ([iv]) ?= ?(.*?) rpar ?= ?(\S+)", re.IGNORECASE)


def read_over(line: Line) -> Line:
    """Return a ``.subckt`` or ``.model`` without the parenthesis at its end that matches none, with a note.

    A model whose parenthesis is not closed is closed. Where that does not put the statement in order, it
    stays as it is, so that the fault is told.
    """
    text = line.text.rstrip()
    if line.keyword not in (".subckt", ".model") or balanced(text):
        return line
    if text.endswith(")") and balanced(text[:-1]):
        return replace(line, text=text[:-1].rstrip(), note="a ')' at its end closes nothing: it is read over")
    if line.keyword == ".model" and balanced(text + ")"):
        return replace(line, text=text + ")", note="the '(' of the model is not closed: read as closed")
    return line


def put_right(line: Line) -> Line:
    """Return a statement of a PSpice or LTspice file as that program reads it, with a note on a table.

    A table whose parentheses do not match becomes its pairs of numbers, ``x1 a,b part`` becomes
    ``x1 a b part``, ``poly(2),(a,0),(b,0)`` loses its outer commas, ``tc 1m 2u`` becomes ``tc1=1m tc2=2u``,
    ``b1 a b i=f rpar=r`` becomes ``b1 a b i=(f)+v(a,b)/(r)``; beside a voltage the resistor changes nothing.
    Where other things than numbers stand, nothing is changed.
    """
    text, note = line.text, ""
    if text[:1] in "xX" and "," in text:
        text = _COMMA.sub(" ", text)
    match = _POLY.match(text)
    if match is not None:
        text = match[1] + re.sub(r" ?, ?\(", " (", match[2]) + text[match.end() :]
    match = _TABLE.fullmatch(text)
    if match is not None and balanced(match[1]) and not balanced(match[2]):
        values = [word for word in _APART.split(match[2]) if word]
        if len(values) % 2 == 0 and values and all(number(word) is not None for word in values):
            pairs = zip(values[::2], values[1::2], strict=True)
            text = f"{match[1]} {' '.join(f'({x},{y})' for x, y in pairs)}"
            note = "the parentheses of the table do not match: its pairs are read"
    match = _COEFFICIENTS.match(text)
    if match is not None and len(tokens(match[1])) > 3:
        words = [word for word in match.groups()[1:] if word is not None]
        if all(number(word) is not None for word in words):
            stated = " ".join(f"tc{k}={word}" for k, word in enumerate(words, 1))
            text = f"{match[1]}{stated}{text[match.end() :]}"
    match = _PARALLEL.fullmatch(text)
    if match is not None:
        start, plus, minus, kind, formula, ohms = match.groups()
        shunt = f"+v({plus},{minus})/({ohms.strip('{}')})" if kind in "iI" else ""
        text = f"{start} {kind}=({formula}){shunt}" if shunt else f"{start} {kind}={formula}"
    return line if text == line.text else replace(line, text=text, note=note or line.note)
