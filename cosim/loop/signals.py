"""From the streamed rows of a lockstep to the signals, energies and samples of a `Run`."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cosim.circuits.decks import Drive
from cosim.circuits.design_constants import DesignConstants
from cosim.loop.energy_ledger import summary, torques_and_energy, works
from cosim.loop.jump_rows import REACH, right_limits
from cosim.storage.rawfile import RawWriter
from mech import NoOperator

#: Rows handled at once: memory stays constant however long the run.
_CHUNK = 1 << 15
#: Columns that only the ledger needs.
_PRIVATE = ("rule", "a", "tau_visc", "tau_coul", "tau_stop")
_POWERS = ("p_mot", "p_op", "p_visc", "p_coul", "p_stop")


@dataclass(frozen=True)
class Layout:
    """What the columns of the streamed rows mean.

    Attributes
    ----------
    columns : names, as `cosim.loop.columns` gives them
    circuit : driven pins
    constants : design constants of the board
    linkage : one `LINKAGE` record
    one_sided : whether a jump of the DACs has a row for its limit from the left only, as accepted points are
    """

    columns: tuple[str, ...]
    circuit: Drive
    constants: DesignConstants
    linkage: np.void
    one_sided: bool = False


def signal_names(columns: Sequence[str]) -> tuple[list[str], list[int]]:
    """Return the signals made of streamed columns, and the numbers of the columns that are kept."""
    keep = [i for i, name in enumerate(columns) if name.rstrip("0123456789") not in _PRIVATE or "." in name]
    return [columns[i] for i in keep] + [*_POWERS, "e_kin", "e_grav", "e_spring", "fmx", "fmy"], keep


def write_signals(
    rows_file: Path, raw_file: Path, layout: Layout, title: str, work_j: NDArray[np.float64] | None = None
) -> dict[str, Any]:
    """Write every signal to `raw_file` and return the energy ledger.

    `work_j` [6] is the work of each worker where the integrator has kept account itself; without it, it is
    integrated from the rows with the lockstep's own rules.

    Derived here: powers of the motors, the operator, friction and stops [W], kinetic, gravity and
    commanded-spring energy [J], and the motors' force at the fingertip [N].
    """
    table = np.memmap(rows_file, dtype=np.float64, mode="r").reshape(-1, len(layout.columns))
    with RawWriter(raw_file, signal_names(layout.columns)[0], title=title) as raw:
        return _derived(table, layout, work_j, raw.append)


def held_signals(
    table: NDArray[np.float64], layout: Layout, work_j: NDArray[np.float64] | None = None
) -> tuple[dict[str, NDArray[np.float64]], dict[str, Any]]:
    """Return every signal of rows that are held in memory, and the energy ledger; see `write_signals`."""
    parts: list[NDArray[np.float64]] = []
    ledger = _derived(table, layout, work_j, parts.append)
    columns = np.ascontiguousarray(np.concatenate(parts).T)
    return dict(zip(signal_names(layout.columns)[0], columns, strict=True)), ledger


def _derived(
    table: NDArray[np.float64],
    layout: Layout,
    work_j: NDArray[np.float64] | None,
    keep_rows: Callable[[NDArray[np.float64]], object],
) -> dict[str, Any]:
    """Hand all signals to `keep_rows`, some rows at a time, and return the energy ledger."""
    n, columns = layout.circuit.joints, layout.columns
    _, keep = signal_names(columns)
    shafts = bool(layout.linkage["shaft_on"])
    motors, windup = (columns.index(name) if shafts else -1 for name in ("qm1", "e_shaft"))
    workers, stores = len(_POWERS), 2
    if shafts:
        assert work_j is not None  # whoever turns shafts keeps account of them
        workers, stores = workers + 1, stores + 1
    nobody = NoOperator().pack()[0]
    torque_per_amp = layout.constants.torques_per_amp(n)
    first = columns.index("q1")
    totals = np.zeros(workers)
    held, spring = [], []
    for start in range(0, len(table), _CHUNK):
        # two rows of overlap: the parabola of a step reaches two points back, the limit of a jump some on
        back = min(start, 2)
        rows, accepted = _shown(table, start - back, start, min(start + _CHUNK, len(table)), layout)
        torques = np.empty((len(rows), len(_POWERS), n))
        energies = np.empty((len(rows), 3))
        push = np.empty((len(rows), 2))
        torques_and_energy(
            layout.linkage, nobody, n, torque_per_amp, rows, first, torques, energies, push, motors, windup
        )
        if work_j is None:
            done = np.zeros((np.count_nonzero(accepted), workers))
            works(n, rows[accepted], first, torques[accepted], done)
            totals += done[max(back, 1) :].sum(axis=0)
        speeds = rows[:, first + n : first + 2 * n]
        power = np.einsum("kij,kj->ki", torques, speeds)
        stored = _spring_energy(rows, layout)
        if shafts:
            power[:, 0] = (torques[:, 0] * rows[:, motors + n : motors + 2 * n]).sum(axis=1)
        derived = np.column_stack([rows[:, keep], power, energies[:, :2], stored, push])
        keep_rows(derived[back:])
        held.append(energies[back:, :stores])
        spring.append(stored[back:])
    return summary(
        np.concatenate(held), totals if work_j is None else work_j[:workers], np.concatenate(spring)
    )


def _shown(
    table: NDArray[np.float64], begin: int, start: int, stop: int, layout: Layout
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Return the rows of `table` from `begin` to `stop`, and which of them are accepted points.

    The others, from `start` on, are limits of jumps from the right.
    """
    rows = np.ascontiguousarray(table[begin:stop])
    accepted = np.ones(len(rows), bool)
    if not layout.one_sided:
        return rows, accepted
    at, right = right_limits(table[start : stop + REACH], layout.columns, layout.circuit.channels)
    inside = at < stop - start
    behind = at[inside] + start - begin + 1
    return np.insert(rows, behind, right[inside], axis=0), np.insert(accepted, behind, False)


def _spring_energy(rows: NDArray[np.float64], layout: Layout) -> NDArray[np.float64]:
    """Energy [J] that springs with the commanded gains would hold: (u - q)' Ksp (u - q) / 2."""
    n, columns, constants = layout.circuit.joints, layout.columns, layout.constants
    offset = np.zeros((len(rows), n))
    stiffness = np.zeros((len(rows), n, n))
    for j in range(n):
        if f"u{j + 1}" in columns:
            offset[:, j] = rows[:, columns.index(f"u{j + 1}")] / constants.v_rad
            offset[:, j] -= rows[:, columns.index(f"q{j + 1}")]
        for i in range(n):
            name = f"ksp{i + 1}{j + 1}"
            if name in columns:
                stiffness[:, i, j] = rows[:, columns.index(name)] * constants.k_fs / constants.v_fs
    energy: NDArray[np.float64] = 0.5 * np.einsum("ki,kij,kj->k", offset, stiffness, offset)
    return energy
