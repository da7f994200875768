"""Thin long signals for drawing without losing a peak.

A run holds up to millions of points, a figure is some 700 pixels wide. Of every pixel column only the
first, the lowest, the highest and the last point can be seen: these are kept, at their own times.
"""

import numpy as np

from cosim.types import Array

__all__ = ["BINS", "keep_peaks", "merge_spans"]

#: Columns of a full-width figure; four points each keep a page of a long run below 3 MB.
BINS = 480


def keep_peaks(time: Array, value: Array, bins: int = BINS) -> tuple[Array, Array]:
    """Return at most ``4 * bins`` points of a signal that draw the same picture.

    Parameters
    ----------
    time
        Times in rising order (equal neighbours are allowed), shape ``(points,)`` [s].
    value
        Signal, shape ``(points,)``, any unit.
    bins
        Number of columns of equal width in time.

    Returns
    -------
    tuple of arrays
        Times and values kept; every one is a point of the input, the extremes of each column are among them.
    """
    if time.size <= 4 * bins or time[-1] <= time[0]:
        return time, value
    edges = np.searchsorted(time, np.linspace(time[0], time[-1], bins + 1)[1:-1])
    starts = np.concatenate(([0], edges))
    stops = np.concatenate((edges, [time.size]))
    keep: list[int] = []
    for start, stop in zip(starts.tolist(), stops.tolist(), strict=True):
        if stop > start:
            piece = value[start:stop]
            keep += sorted({start, start + int(piece.argmin()), start + int(piece.argmax()), stop - 1})
    return time[keep], value[keep]


def merge_spans(spans: list[tuple[float, float]], gap_s: float) -> list[tuple[float, float]]:
    """Join spans ``(from, to)`` in rising order that lie closer than `gap_s`, too close to be seen apart."""
    merged: list[tuple[float, float]] = []
    for start, stop in spans:
        if merged and start - merged[-1][1] <= gap_s:
            merged[-1] = (merged[-1][0], max(stop, merged[-1][1]))
        else:
            merged.append((start, stop))
    return merged
