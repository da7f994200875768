"""Fresh figures against the committed ones: what became worse beyond the noise fails `make bench`.

Most figures are ratios of two things measured in turn in one process: the machine's speed drops out and its
noise is left. Repeated measurements on one idle machine spread by 5 to 15 % about their median (`min` and
`max` of the committed figures).
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path

from benchmarks.figure import Figure

__all__ = ["BAND", "BANDS", "allowed", "committed", "worse"]

#: Share of the committed figure by which a fresh one may exceed it.
BAND = 0.30
#: Figures with another band: counts are the same everywhere but for rounding, memory but for the allocator;
#: plain times follow the machine's speed, a map of borders is held against a call of a millisecond, and a
#: batch against the start of a whole process.
BANDS = {
    "lockstep_vs_replay_points": 0.02,
    "growth_exponent": 0.15,
    "memory_100s_mb": 0.10,
    "warm_run_outside_s": 1.0,
    "warm_linear_outside_s": 1.0,
    "stability_s": 1.0,
    "extraction_cached_ms": 1.0,
    "border_map": 0.60,
    "batch_vs_single": 1.0,
}


def committed(path: Path) -> dict[str, float]:
    """Return the committed figures by name; none where there is no file."""
    if not path.exists():
        return {}
    return {row["name"]: float(row["ratio"]) for row in json.loads(path.read_text(encoding="utf-8"))}


def allowed(name: str, before: float) -> float:
    """Return the largest fresh figure that noise explains."""
    return before * (1.0 + BANDS.get(name, BAND))


def worse(fresh: Sequence[Figure], before: dict[str, float]) -> list[str]:
    """Return a line for every figure that became worse beyond its band; smaller is better for all of them."""
    return [
        f"{each.name}: {each.ratio:.4g}, committed {before[each.name]:.4g}, "
        f"allowed up to {allowed(each.name, before[each.name]):.4g}"
        for each in fresh
        if each.name in before and not each.ratio <= allowed(each.name, before[each.name])
    ]
