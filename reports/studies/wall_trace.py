"""Traces of a wall: forces and places side by side, and what an ideal circuit changes."""

from collections.abc import Collection, Mapping

import numpy as np

from cosim.studies import table_columns as col
from cosim.studies.study import StudyResult, Table
from cosim.types import Array
from reports.style import FAINT, JOINTS, Drawn, figure, legend

__all__ = ["draw"]

_NORMAL, _TANGENT, _DEPTH = col.NORMAL_FORCE, col.TANGENTIAL_FORCE, col.DEPTH


def draw(result: StudyResult) -> list[tuple[str, str, Drawn]]:
    """Return the runs over time, the difference to an ideal circuit, and the quasi-static force's error."""
    runs = _by_run(result.table("signals"))
    about = result.table("runs").columns
    pairs = [(a, b) for a, b in zip(about["run"], about[col.IDEAL_OF], strict=True) if b]
    apart = {name for pair in pairs[1:] for name in pair} | {ideal for ideal, _ in pairs}
    beside = {a: b for a, b in zip(about["run"], about[col.ALL_OF], strict=True) if b}
    shown = {name: run for name, run in runs.items() if name not in apart and name not in beside}
    pictures = [("runs", "Normal and tangential force, depth", _runs(shown))]
    if beside:
        names = dict.fromkeys((*beside.values(), *beside))
        drawn = _runs({name: runs[name] for name in names})
        pictures.append(("more", "The same with all that the plain runs leave out", drawn))
    for number, (ideal, name) in enumerate(pairs, start=1):
        drawn = _difference(name, runs[name], runs[ideal])
        pictures.append((f"footnote1_{number}", f"What an ideal circuit changes: {name}", drawn))
    pictures.append(("quasi_static", "The quasi-static force", _quasi(result.table("quasi_static"), shown)))
    return pictures


def _by_run(table: Table) -> dict[str, dict[str, Array]]:
    names = np.array(table.columns["run"])
    return {
        name: {key: np.asarray(v, float)[names == name] for key, v in table.columns.items() if key != "run"}
        for name in dict.fromkeys(table.columns["run"])
    }


def _runs(runs: Mapping[str, Mapping[str, Array]]) -> Drawn:
    drawing, axes = figure(6.6, 3, 1, sharex=True)
    for number, (name, run) in enumerate(runs.items()):
        for place, key in zip(axes[:, 0], (_NORMAL, _TANGENT, _DEPTH), strict=True):
            place.plot(run[col.TIME], run[key], color=JOINTS[number], label=name)
    for place, key in zip(axes[:, 0], (_NORMAL, _TANGENT, _DEPTH), strict=True):
        place.set_ylabel(key)
        place.axhline(0.0, color=FAINT, linewidth=0.7)
    axes[2, 0].invert_yaxis()
    axes[2, 0].set_xlabel("time [s]")
    legend(axes[0, 0], columns=3)
    return Drawn(
        drawing, "Force of the device on the hand along the wall's axes; depth, down is into the wall."
    )


def _difference(name: str, full: Mapping[str, Array], ideal: Mapping[str, Array]) -> Drawn:
    drawing, axes = figure(4.4, 2, 1, sharex=True)
    time = full[col.TIME]
    for number, key in enumerate((_NORMAL, _TANGENT)):
        axes[0, 0].plot(time, 1e3 * (ideal[key] - full[key]), color=JOINTS[number], label=key.split(" ")[0])
    axes[0, 0].set_ylabel("change of the force [mN]")
    for number, key in enumerate((_DEPTH, col.ALONG_THE_WALL)):
        axes[1, 0].plot(time, 1e3 * (ideal[key] - full[key]), color=JOINTS[number], label=key.split(" [")[0])
    axes[1, 0].set_ylabel("change of the place [µm]")
    axes[1, 0].set_xlabel("time [s]")
    for place in axes[:, 0]:
        place.axhline(0.0, color=FAINT, linewidth=0.7)
        legend(place)
    return Drawn(drawing, f"{name}: what would be different if the circuit had no dynamics (footnote 1).")


def _quasi(table: Table, shown: Collection[str]) -> Drawn:
    drawing, axes = figure(3.6)
    names = np.array(table.columns["run"])
    for number, name in enumerate(dict.fromkeys(table.columns["run"])):
        if name not in shown:
            continue
        mine = names == name
        axes[0, 0].plot(
            np.asarray(table.columns[col.ACCELERATION], float)[mine],
            np.asarray(table.columns[col.ERROR_FORCE], float)[mine],
            ".", color=JOINTS[number], markersize=2.5, label=name,
        )  # fmt: skip
    axes[0, 0].set_xlabel("acceleration of the tip along the normal [m/s²]")
    axes[0, 0].set_ylabel("force at the hand less J⁻ᵀτ [N]")
    legend(axes[0, 0], columns=3)
    return Drawn(
        drawing, "In motion the hand feels the arm's inertia besides: the error of the quasi-static force."
    )
