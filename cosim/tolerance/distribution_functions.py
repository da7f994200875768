"""Distribution functions in a value, as ngspice, LTspice and PSpice spell them."""

from __future__ import annotations

import re
from collections.abc import Callable

from cosim.ngspice.lines import number
from cosim.ngspice.values import nominal
from cosim.tolerance.distributions import Shape

__all__ = ["extracted_calls"]

_CALL = re.compile(r"(?<![\w.])(agauss|gauss|aunif|unif|limit|mc|flat)\s*\(([^()]*)\)", re.IGNORECASE)


_NO_NUMBER = "its arguments must be numbers to be drawn, or made of parameters that do not vary"


def extracted_calls(
    text: str, constant: Callable[[str], float | None] = number, every: bool = False
) -> tuple[str, dict[str, tuple[float, Shape]], str]:
    """Put a name in the place of every call of a distribution function.

    ngspice: agauss(nominal, deviation, sigmas), gauss(nominal, share, sigmas), aunif(nominal, deviation),
    unif(nominal, share), limit(nominal, deviation). LTspice: mc(nominal, share), flat(deviation), and gauss
    of a standard deviation alone.

    Parameters
    ----------
    text
        Value, as it is written.
    constant
        Gives the number that an argument stands for; ``None`` where it is none, or varies.
    every
        Whether `gauss`, `unif` and `limit` are draws as well, not functions of the user's.

    Returns
    -------
    str, dict, str
        The text; name -> nominal value and deviation; what is wrong, if anything.
    """
    calls: dict[str, tuple[float, Shape]] = {}
    wrong = ""

    def put(match: re.Match[str]) -> str:
        nonlocal wrong
        shape = _shape(match[1].lower(), [constant(part.strip(" {}'")) for part in match[2].split(",")])
        if isinstance(shape, str):
            wrong = wrong or f"{match[0]}: {shape}"
            return "drawn__wrong"  # no number: what depends on it is none either
        name = f"drawn__{len(calls) + 1}"
        calls[name] = shape
        return name

    text = _CALL.sub(put, text)
    known = re.search(r"(?<![\w.])(agauss|aunif|mc|flat)\s*\(", text, re.IGNORECASE)
    left = [known[1]] if known else nominal(text)[1] if every else []
    if left and not wrong:
        wrong = f"{left[0]}: {_NO_NUMBER}"
    return text, calls, wrong


def _shape(name: str, numbers: list[float | None]) -> tuple[float, Shape] | str:
    if any(value is None for value in numbers):
        return _NO_NUMBER
    n = [value or 0.0 for value in numbers]
    if name in ("agauss", "gauss") and len(n) == 3:
        if n[2] <= 0.0:
            return "number of sigmas must be > 0"
        size = abs(n[1]) * (abs(n[0]) if name == "gauss" else 1.0)
        return _drawn(n[0], Shape("gauss", -size, size, n[2], relative=False))
    if name == "gauss" and len(n) == 1:
        return _drawn(0.0, Shape("gauss", -abs(n[0]), abs(n[0]), 1.0, relative=False))
    if name in ("aunif", "unif", "mc") and len(n) == 2:
        size = abs(n[1]) * (1.0 if name == "aunif" else abs(n[0]))
        return _drawn(n[0], Shape("uniform", -size, size, relative=False))
    if name == "flat" and len(n) == 1:
        return _drawn(0.0, Shape("uniform", -abs(n[0]), abs(n[0]), relative=False))
    if name == "limit" and len(n) == 2:
        return _drawn(n[0], Shape("limit", -abs(n[1]), abs(n[1]), relative=False))
    return "wrong number of arguments"


def _drawn(nominal: float, shape: Shape) -> tuple[float, Shape] | str:
    if shape.high == 0.0:
        return "deviates by nothing"
    return nominal, shape
