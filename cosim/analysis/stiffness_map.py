"""Maps of exact borders over two numbers of a scene: that of `stability.border`, at a fraction of its cost.

The discrete stiffness k enters the map of a period linearly: the computer's reading is latched before the
circuit sees it, so that M(k) = M0 + k M1 whatever circuit, delay and hold are. Two lifts with one matrix
exponential give both, and what a period forgets (columns of zeros) is taken out. The scan for the border is
then one batch of small eigenvalue problems, and its root a few more: none of them uses the scene any more.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import scipy  # loads its parts when they are used
from numpy.typing import NDArray

from cosim.analysis.control_law import law_point
from cosim.analysis.held_contact import HeldContact, touching
from cosim.analysis.linearise import linearise
from cosim.analysis.period_map import lift
from cosim.analysis.stability import FREE, SCAN
from cosim.circuits.design_constants import DesignConstants
from cosim.circuits.linear_circuit import LinearCircuit
from cosim.scene import Scene
from cosim.scene.table import Table
from cosim.storage.checkpoint import Points
from cosim.types import Array

__all__ = ["Axis", "Pencil", "border_map", "changed", "pencil"]


KEY = "discrete_stiffness_n_per_m"
#: A border is a root to this share of itself.
_RTOL = 1e-10


@dataclass(frozen=True)
class Axis:
    """One axis of a map: a key of the scene, such as ``computer.period_s``, and its values in SI units."""

    key: str
    values: tuple[float, ...]


@dataclass(frozen=True)
class Pencil:
    """The map of a period as M0 + k M1, and how many of its eigenvalues stay at 1 whatever k is."""

    fixed: Array
    slope: Array
    free: int

    def over(self, k: Any) -> Array:
        """Return the largest modulus of an eigenvalue less 1, free ones apart, for each k [N/m]."""
        ks = np.atleast_1d(np.asarray(k, float))
        z: NDArray[Any] = np.linalg.eigvals(self.fixed + ks[:, None, None] * self.slope)
        if self.free:
            order = np.argsort(np.abs(z - 1.0), axis=1, kind="stable")[:, self.free :]
            z = np.take_along_axis(z, order, axis=1)
        excess: Array = np.abs(z).max(axis=1, initial=0.0) - 1.0
        return excess

    def first(self, low: float, high: float) -> float:
        """Return the end of the first stable range of k between two values, as `stability.border` does.

        Infinite when no end was found, 0 when nothing is stable.
        """
        ks = np.geomspace(low, high, max(2, math.ceil(SCAN * math.log10(high / low)) + 1))
        over = self.over(ks)
        stable = np.flatnonzero(over < 0.0)
        if not len(stable):
            return 0.0
        beyond = np.flatnonzero(over[stable[0] :] >= 0.0)
        if not len(beyond):
            return math.inf
        end = int(stable[0] + beyond[0])
        return self.root(float(ks[end - 1]), float(ks[end]))

    def root(self, low: float, high: float) -> float:
        """Return the border between a stable and an unstable value."""
        return float(
            scipy.optimize.brentq(lambda k: float(self.over(k)[0]), low, high, rtol=_RTOL, xtol=1e-300)
        )


def pencil(contact: HeldContact, *, scale: float = 100.0) -> Pencil:
    """Return the map of a period of a held contact over the discrete stiffness.

    Parameters
    ----------
    scale
        A stiffness [N/m] of the borders' size: the two at which the map is made are this and its double.
    """
    first, second = (contact.with_computer(**{KEY: k}) for k in (scale, 2.0 * scale))
    system = linearise(first, preload=False)
    law = law_point(second.scene, second.constants, second.linkage, second.q)
    one = lift(system)
    two = replace(lift(replace(system, law=law)), _steps=one._steps)
    m1, m2 = one.period(), two.period()
    kept = _remembered(m1, m2)
    m1, m2 = m1[np.ix_(kept, kept)], m2[np.ix_(kept, kept)]
    out = Pencil(2.0 * m1 - m2, (m2 - m1) / scale, 0)
    low = np.linalg.eigvals(out.fixed + np.multiply.outer((1e-3, 1.5e-3), scale * out.slope))
    free = int((np.abs(low - 1.0) <= FREE).sum(axis=1).min())
    return replace(out, free=free)


def _remembered(*maps: Array) -> NDArray[np.intp]:
    """Return the indices of the state that influence the next period: all others have the eigenvalue 0."""
    kept: NDArray[np.intp] = np.arange(len(maps[0]))
    while True:
        used = np.zeros(len(kept), bool)
        for m in maps:
            used |= m[np.ix_(kept, kept)].any(axis=0)
        if used.all():
            return kept
        kept = kept[used]


def changed(scene: Scene, key: str, value: float) -> Scene:
    """Return the scene with one number of it changed; the value is taken as it is.

    Raises
    ------
    KeyError
        When the scene has no such key.
    """
    *path, last = key.split(".")
    tables: list[Any] = [scene]
    for name in path:
        table = getattr(tables[-1], name, None)
        if not isinstance(table, Table):
            raise KeyError(key)
        tables.append(table)
    if last not in type(tables[-1]).model_fields:
        raise KeyError(key)
    new: Any = value
    for name, table in zip((last, *reversed(path)), reversed(tables), strict=True):
        new = table.model_copy(update={name: new})
    out: Scene = new
    return out


@dataclass(frozen=True)
class _Row:
    """One row of a map, as a worker gets it."""

    scene: Scene
    constants: DesignConstants
    circuit: LinearCircuit
    row: tuple[str, float]
    columns: Axis
    low: float
    high: float


def border_map(
    scene: Scene,
    constants: DesignConstants,
    circuit: LinearCircuit,
    rows: Axis,
    columns: Axis,
    *,
    low: float = 1.0,
    high: float = 1e5,
    points: Points | None = None,
    workers: int | None = None,
) -> Array:
    """Return the largest stable discrete stiffness [N/m] of the held contact over two numbers of the scene.

    Parameters
    ----------
    rows, columns
        Axes of the map; keys may be any numbers of the scene that the circuit model does not hold itself.
    low, high
        Range of the stiffness that is scanned [N/m].
    points
        Keeps finished rows, shows progress, and lets an interrupted map go on.
    workers
        Processes; one for each processor by default.

    Returns
    -------
    array of shape [rows, columns]; infinite where no end was found, 0 where nothing is stable.
    """
    jobs = {
        f"{rows.key} = {value:.6g}, over {columns.key}": _Row(
            scene, constants, circuit, (rows.key, value), columns, low, high
        )
        for value in rows.values
    }
    if points is None:
        with Points(None) as none:
            borders = none.map(_row, jobs, workers)
    else:
        borders = points.map(_row, jobs, workers)
    return np.array([[math.inf if k is None else k for k in row] for row in borders], float)


def _row(job: _Row) -> list[float | None]:
    """Return the borders of a row, JSON-ready: None is infinite."""
    base = changed(job.scene, *job.row)
    q = touching(base, job.constants)
    borders: list[float] = []
    for value in job.columns.values:
        moved = changed(base, job.columns.key, value)
        contact = HeldContact(moved, job.constants, job.circuit, q)
        borders.append(pencil(contact).first(job.low, job.high))
    return [k if math.isfinite(k) else None for k in borders]
