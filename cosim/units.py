"""Units of what a run records, and numbers with units as a reader expects them: digits, a prefix, a unit."""

import math
import re
from collections.abc import Mapping
from typing import Any

__all__ = ["figures", "heading", "measured", "name_of", "of_measure", "pretty", "quantity", "sample_unit",
           "scale", "signal_unit", "signed", "unit_in"]  # fmt: skip

_SIGNALS = {
    "time": "s", "x": "m", "y": "m", "fx": "N", "fy": "N", "fmx": "N", "fmy": "N",
    "q": "rad", "v": "rad/s", "qm": "rad", "vm": "rad/s", "pot": "rad", "imot": "A", "tau_shaft": "N m",
    "u": "V", "ksp": "V", "ksd": "V", "cmd": "V",
}  # fmt: skip
_SAMPLES = {
    "time": "s", "pen": "m", "x": "m", "y": "m", "q_enc": "rad", "v_enc": "rad/s", "u_rad": "rad",
    "cmd_nm": "N m", "ksp": "N m/rad", "ksd": "N m s/rad",
}  # fmt: skip

_PREFIXES = {-12: "p", -9: "n", -6: "µ", -3: "m", 0: "", 3: "k", 6: "M"}
#: Units that take a prefix; all others are written as they are.
_PREFIXED = {"s", "m", "N", "A", "V", "J", "W", "rad", "Hz"}

#: Units that keep their tenths: 0.876 N, not 876 mN.
_BARE = {"N", "A", "V", "W", "Hz"}


def signal_unit(name: str) -> str:
    """Return the unit of a signal; a node of the board is a voltage.

    Examples
    --------
    >>> signal_unit('q1'), signal_unit('imot2'), signal_unit('xdiff1.out')
    ('rad', 'A', 'V')
    """
    if "." in name:
        return "V"
    plain = name.rstrip("0123456789")
    if plain.startswith(("p_", "e_")):
        return "W" if plain.startswith("p_") else "J"
    return _SIGNALS.get(plain, "")


def sample_unit(name: str) -> str:
    """Return the unit of a column of the computer's samples; gains and commands are at the joints.

    Examples
    --------
    >>> sample_unit('ksp12'), sample_unit('pen')
    ('N m/rad', 'm')
    """
    return _SAMPLES.get(name.rstrip("0123456789"), "")


def heading(name: str, unit: str) -> str:
    """Return a column's heading: ``peak_force [N]``.

    Examples
    --------
    >>> heading('peak_force', 'N')
    'peak_force [N]'
    """
    return f"{name} [{unit}]" if unit else name


def name_of(heading: str) -> str:
    """Return the name in a column's heading, with or without a unit.

    Examples
    --------
    >>> name_of('peak_force [N]')
    'peak_force'
    """
    return heading.partition(" [")[0]


def unit_in(heading: str) -> str:
    """Return the unit in a column's heading, nothing where it has none.

    Examples
    --------
    >>> unit_in('peak_force [N]'), unit_in('tick')
    ('N', '')
    """
    return heading.partition(" [")[2].removesuffix("]")


_POWERS = {"2": "²", "3": "³"}
_POWER = re.compile(r"\^([23])(?![\d.])")
#: A micro of a file, ``[us]`` or ``2 us``; a word that begins with u has no digit or bracket before it.
_MICRO = re.compile(r"((?<=\[)|(?<=\d )|(?<=\d\u00a0))u(?=[smJNAVW]\b)")


def pretty(text: str) -> str:
    """Return text with its units as people read them; files keep ASCII, ``us`` and ``m/s^2``.

    Examples
    --------
    >>> pretty('delay [us]'), pretty('3 A^2 s'), pretty('+-1 % of 2^24 codes')
    ('delay [µs]', '3 A² s', '±1 % of 2^24 codes')
    """
    return _MICRO.sub("µ", _POWER.sub(lambda match: _POWERS[match[1]], text)).replace("+-", "±")


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

    Examples
    --------
    >>> quantity(0.00429, 'm'), quantity(0.876, 'N'), quantity(1e5, 'N/m')
    ('4.29 mm', '0.876 N', '100000 N/m')
    """
    if not math.isfinite(value):
        return "not known"
    if unit not in _PREFIXED or value == 0.0:
        return f"{figures(value, digits)} {pretty(unit)}".rstrip()
    power = _power(value, unit, digits)
    rounded = float(f"{value:.{digits - 1}e}")
    return f"{figures(rounded / 10.0**power, digits)} {_PREFIXES[power]}{unit}"


def _power(value: float, unit: str, digits: int) -> int:
    """Return the power of ten of the prefix that suits a value; 0 for units that take none."""
    if unit not in _PREFIXED or value == 0.0:
        return 0
    # Rounded first, so that 0.99996 becomes 1.00 and not 1000 m.
    rounded = float(f"{value:.{digits - 1}e}")
    power = min(max(3 * math.floor(math.log10(abs(rounded)) / 3 + 1e-12), -12), 6)
    bare = (unit == "s" and power > 0) or (unit in _BARE and 0.1 <= abs(rounded) < 1.0)
    return 0 if bare else power


#: An error is written with this many digits of its value at most, however small it is.
_MOST_DIGITS = 6


def measured(value: float, error: float, unit: str = "") -> str:
    """Return ``104.47 ± 0.02 N/m``: a value to the digit of its error, which is rounded up to one figure.

    Parameters
    ----------
    value, error
        Numbers in SI units, the error >= 0.
    unit
        As `quantity` takes it; value and error have one prefix.
    """
    if not (math.isfinite(value) and math.isfinite(error)):
        return quantity(value, unit, 4)
    power = _power(max(abs(value), error), unit, 4)
    value, error = value / 10.0**power, error / 10.0**power
    least = 10.0 ** (math.floor(math.log10(abs(value))) - _MOST_DIGITS + 1) if value else 0.0
    size = max(error, least)
    if size == 0.0:
        return f"0 {pretty(unit)}".rstrip()
    place = math.floor(math.log10(size))
    up = math.ceil(size / 10.0**place - 1e-9)
    if up == 10:
        place, up = place + 1, 1
    decimals = max(-place, 0)
    return f"{value:.{decimals}f} ± {up * 10.0**place:.{decimals}f} {_PREFIXES[power]}{pretty(unit)}".rstrip()


def of_measure(row: Mapping[str, Any]) -> str:
    """Return a measure as text: its value, with the bound of its error and what noise does, where known.

    Examples
    --------
    >>> of_measure({'value': 104.4738, 'unit': 'N/m', 'error': 0.0123, 'noise': 0.31})
    '104.47 ± 0.02 N/m, noise ± 0.31 N/m'
    """
    value, unit = float(row["value"]), str(row.get("unit") or "")
    error, noise = row.get("error"), row.get("noise")
    text = measured(value, float(error), unit) if error else quantity(value, unit, 4)
    return f"{text}, noise ± {quantity(float(noise), unit, 2)}" if noise else text


def signed(value: float, unit: str = "", digits: int = 3) -> str:
    """Return a change as `quantity` writes it, a rise with its plus: ``+4.29 mm``.

    Examples
    --------
    >>> signed(0.00429, 'm'), signed(-2.0, 'N')
    ('+4.29 mm', '-2 N')
    """
    return ("+" if value > 0.0 else "") + quantity(value, unit, digits)


def scale(largest: float, unit: str) -> tuple[float, str]:
    """Return the factor and the unit with prefix in which an axis up to `largest` reads well (10 mJ, 1e3).

    Examples
    --------
    >>> scale(0.012, 'J')
    (1000.0, 'mJ')
    """
    if not 0.0 < largest < math.inf:
        return 1.0, unit
    # From 0.3 on the bare unit is kept: 0.5 N reads better than 500 mN.
    power = min(max(3 * math.floor(math.log10(largest / 0.3) / 3), -12), 6)
    return 10.0**-power, _PREFIXES[power] + unit


def figures(value: float, digits: int) -> str:
    """Return a number with so many significant digits; whole numbers as they are.

    Examples
    --------
    >>> figures(3.14159, 3), figures(1200.0, 3), figures(1.5e-7, 2)
    ('3.14', '1200', '1.5e-07')
    """
    if value == 0.0:
        return "0"
    if float(value).is_integer() and abs(value) < 1e7:
        return f"{value:.0f}"
    size = abs(value)
    if 1e-4 <= size < 1e6:
        decimals = max(digits - 1 - math.floor(math.log10(size)), 0)
        return f"{value:.{decimals}f}"
    return f"{value:.{digits - 1}e}"
