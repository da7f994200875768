"""Numbers and names as a reader expects them: three digits, a prefix, a unit."""

import math
from typing import Any

__all__ = ["cell", "plain_name", "quantity", "ratio", "scale", "share"]

_PREFIXES = {-12: "p", -9: "n", -6: "µ", -3: "m", 0: "", 3: "k", 6: "M"}
#: Units that take a prefix; all others are written as they are.
_PREFIXED = {"s", "m", "N", "A", "V", "J", "W", "rad", "Hz"}

#: Units that keep their tenths: 0.876 N, not 876 mN.
_BARE = {"N", "A", "V", "W"}


def quantity(value: float, unit: str = "", digits: int = 3) -> str:
    """Return ``4.29 mm`` for 0.00429 and ``"m"``.

    Parameters
    ----------
    value
        Number in SI units.
    unit
        Its unit; a prefix is put before simple units only (m, s, N, A, V, J, W, rad, Hz).
    digits
        Significant digits.
    """
    if not math.isfinite(value):
        return "not known"
    if unit not in _PREFIXED or value == 0.0:
        return f"{_digits(value, digits)} {unit}".rstrip()
    # Rounded first, so that 0.99996 becomes 1.00 and not 1000 m.
    rounded = float(f"{value:.{digits - 1}e}")
    power = min(max(3 * math.floor(math.log10(abs(rounded)) / 3 + 1e-12), -12), 6)
    if (unit == "s" and power > 0) or (unit in _BARE and 0.1 <= abs(rounded) < 1.0):
        power = 0
    return f"{_digits(rounded / 10.0**power, digits)} {_PREFIXES[power]}{unit}"


def scale(largest: float, unit: str) -> tuple[float, str]:
    """Return the factor and the unit with prefix in which an axis up to `largest` reads well (10 mJ, 1e3)."""
    if not 0.0 < largest < math.inf:
        return 1.0, unit
    # From 0.3 on the bare unit is kept: 0.5 N reads better than 500 mN.
    power = min(max(3 * math.floor(math.log10(largest / 0.3) / 3), -12), 6)
    return 10.0**-power, _PREFIXES[power] + unit


def _digits(value: float, digits: int) -> str:
    if value == 0.0:
        return "0"
    if float(value).is_integer() and abs(value) < 1e7:
        return f"{value:.0f}"
    size = abs(value)
    if 1e-4 <= size < 1e6:
        decimals = max(digits - 1 - math.floor(math.log10(size)), 0)
        return f"{value:.{decimals}f}"
    return f"{value:.{digits - 1}e}"


def share(value: float) -> str:
    """Return a ratio in per cent with two digits that matter."""
    if 0.0 < abs(value) < 5e-4:
        return "below 0.1 %"
    return f"{100 * value:.2g} %" if abs(value) < 0.0995 else f"{100 * value:.0f} %"


def ratio(value: float) -> str:
    """Return a small ratio: in per cent, and as a power of ten where that would be all zeros."""
    return share(value) if value >= 1e-3 or value == 0.0 else f"{value:.1e}".replace("e-0", "e-")


def plain_name(name: str) -> str:
    """Return ``peak current 1`` for ``peak_current_1``."""
    return name.replace("_", " ")


def cell(value: Any) -> str:
    """Return any value of a table as text."""
    if isinstance(value, bool):
        return "yes" if value else "no"
    if value is None:
        return "not known"
    if isinstance(value, float):
        return _digits(value, 4) if math.isfinite(value) else "not known"
    if isinstance(value, list | tuple):
        return ", ".join(cell(part) for part in value)
    if isinstance(value, dict):
        return ", ".join(f"{plain_name(str(key))} {cell(part)}" for key, part in value.items())
    return str(value)
