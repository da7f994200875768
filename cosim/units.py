"""Units of what a run records, and numbers with units as a reader expects them: digits, a prefix, a unit."""

import math

__all__ = ["figures", "heading", "name_of", "quantity", "sample_unit", "scale", "signal_unit", "signed"]

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
    """Return the unit of a signal; a node of the board is a voltage."""
    if "." in name:
        return "V"
    plain = name.rstrip("0123456789")
    if plain.startswith(("p_", "e_")):
        return "W" if plain.startswith("p_") else "J"
    return _SIGNALS.get(plain, "")


def sample_unit(name: str) -> str:
    """Return the unit of a column of the computer's samples; gains and commands are at the joints."""
    return _SAMPLES.get(name.rstrip("0123456789"), "")


def heading(name: str, unit: str) -> str:
    """Return a column's heading: ``peak_force [N]``."""
    return f"{name} [{unit}]" if unit else name


def name_of(heading: str) -> str:
    """Return the name in a column's heading, with or without a unit."""
    return heading.partition(" [")[0]


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
        return f"{figures(value, digits)} {unit}".rstrip()
    # Rounded first, so that 0.99996 becomes 1.00 and not 1000 m.
    rounded = float(f"{value:.{digits - 1}e}")
    power = min(max(3 * math.floor(math.log10(abs(rounded)) / 3 + 1e-12), -12), 6)
    if (unit == "s" and power > 0) or (unit in _BARE and 0.1 <= abs(rounded) < 1.0):
        power = 0
    return f"{figures(rounded / 10.0**power, digits)} {_PREFIXES[power]}{unit}"


def signed(value: float, unit: str = "", digits: int = 3) -> str:
    """Return a change as `quantity` writes it, a rise with its plus: ``+4.29 mm``."""
    return ("+" if value > 0.0 else "") + quantity(value, unit, digits)


def scale(largest: float, unit: str) -> tuple[float, str]:
    """Return the factor and the unit with prefix in which an axis up to `largest` reads well (10 mJ, 1e3)."""
    if not 0.0 < largest < math.inf:
        return 1.0, unit
    # From 0.3 on the bare unit is kept: 0.5 N reads better than 500 mN.
    power = min(max(3 * math.floor(math.log10(largest / 0.3) / 3), -12), 6)
    return 10.0**-power, _PREFIXES[power] + unit


def figures(value: float, digits: int) -> str:
    """Return a number with so many significant digits; whole numbers as they are."""
    if value == 0.0:
        return "0"
    if float(value).is_integer() and abs(value) < 1e7:
        return f"{value:.0f}"
    size = abs(value)
    if 1e-4 <= size < 1e6:
        decimals = max(digits - 1 - math.floor(math.log10(size)), 0)
        return f"{value:.{decimals}f}"
    return f"{value:.{digits - 1}e}"
