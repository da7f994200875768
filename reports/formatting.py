"""Names and ratios as a reader expects them, and any value of a table as text."""

import math
from typing import Any

from cosim.units import figures

__all__ = ["cell", "plain_name", "ratio", "share"]


def share(value: float) -> str:
    """Return a ratio in per cent with two significant digits."""
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
        return figures(value, 4) if math.isfinite(value) else "not known"
    if isinstance(value, list | tuple):
        return ", ".join(cell(part) for part in value)
    if isinstance(value, dict):
        return ", ".join(f"{plain_name(str(key))} {cell(part)}" for key, part in value.items())
    return str(value)
