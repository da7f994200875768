"""Scene -> Plan -> Run, and many runs: sweep and comparison."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cosim.api.python_warnings import doubts
from cosim.caution import collected
from cosim.plan import Plan, resolve
from cosim.scene import load_scene
from cosim.scene.load import SceneLike
from cosim.storage.staging import scratch_folder
from cosim.variants import Setting, Variant, variants

if TYPE_CHECKING:  # each function imports what it needs: a script that simulates need not load comparisons
    from cosim.comparisons.compare_boards import Row, Side
    from cosim.comparisons.sweep import Sweep
    from cosim.ngspice.child import Child
    from cosim.results import Run

__all__ = ["Comparison", "compare", "plan", "run", "sweep"]


@dataclass(frozen=True)
class Comparison:
    """Boards under one scene: the sides, the reference first, and every figure that differs."""

    sides: tuple[Side, ...]
    changes: tuple[Row, ...]


def plan(
    scene: SceneLike | Plan,
    *,
    trust: bool = False,
    child: Child | None = None,
    on_choice: Callable[[str], None] | None = None,
) -> Plan:
    """Return the plan of a run; chooses effects where the scene says ``effects = "auto"``.

    Parameters
    ----------
    scene
        Scene or its file; a plan is returned as it is.
    trust
        Whether the netlists may hold commands and name files.
    child
        Process of `cosim.ngspice.child.start_early` for the runs of a choice.
    on_choice
        Called with a few words before every run of a choice.

    Raises
    ------
    InputError
        For a board that does not fit the scene, or effects that its model cannot carry.

    Examples
    --------
    >>> from cosim.assets import scenes_folder
    >>> plan(scenes_folder() / "press.toml").model
    'spice'
    """
    if isinstance(scene, Plan):
        return scene
    scene = load_scene(scene)
    if not scene.effects.auto:
        return resolve(scene, trust=trust)
    from cosim.comparisons.choose_effects import choose

    with collected(forward=False):  # cautions of a trial come again from the run that is kept
        return choose(scene, child=child, trust=trust, on_progress=on_choice)[0]


def run(
    scene: SceneLike | Plan,
    out: str | Path | None = None,
    *,
    formats: Collection[str] = ("parquet",),
    tolerances: Sequence[str] = (),
    estimate: bool = True,
    free: bool = True,
    trust: bool = False,
    child: Child | None = None,
    on_progress: Callable[[Mapping[str, Any]], None] | None = None,
) -> Run:
    """Simulate a scene and save the result whole, or not at all.

    Parameters
    ----------
    scene
        Scene, its file, or its plan.
    out
        Result folder; a temporary one when not given (its path is ``run.signals.path.parent``).
    formats
        Further forms of the signals: 'parquet', 'csv'.
    tolerances
        Errors that measures may have: ``"1e-3"`` (a share, of every measure), ``"peak_force=0.05 N"``; steps
        are refined until the estimates fit.
    estimate
        Whether every measure gets its error, which costs a second run.
    free
        With tolerances, whether the cheapest model that carries the scene may replace the one it states.
    trust, child
        As for `plan`.
    on_progress
        Called with {'time_s', 'points'} while the simulation runs.

    Returns
    -------
    Run
        Signals [points] and samples [samples] in SI units, measures with units, energy ledger, cautions.

    Raises
    ------
    InputError
        For a board that ngspice does not accept or that is unstable, or a place that cannot be written.
    SimulationError
        For everything that goes wrong while it runs.

    Examples
    --------
    >>> from cosim.assets import scenes_folder
    >>> scene = load_scene(scenes_folder() / "press.toml").with_values({"duration_s": 0.05})
    >>> result = run(scene)
    >>> float(result.signals["time"][-1])
    0.05
    >>> result.signals["q1"].shape == result.signals["time"].shape
    True
    """
    planned = plan(scene, trust=trust, child=child)
    how: dict[str, Any] = {"formats": formats, "on_progress": on_progress, "child": child}
    if tolerances:
        from cosim.accuracy.tolerance_control import parse_tolerances, run_within

        return run_within(planned, out, parse_tolerances(tolerances), free=free, **how)
    from cosim.comparisons.measure_values import run_with_measures

    if not estimate:
        return run_with_measures(planned, out, **how)
    from cosim.accuracy.estimate import estimator

    return run_with_measures(planned, out, errors=estimator(planned, child), **how)


def sweep(
    scene: SceneLike,
    ranges: Mapping[str, str | Sequence[Any]] | Sequence[Setting],
    measures: Sequence[str] = ("peak_force", "max_penetration"),
    out: str | Path | None = None,
    *,
    tolerances: Sequence[str] = (),
    trust: bool = False,
    child: Child | None = None,
    on_progress: Callable[[int, int, str], None] | None = None,
) -> Sweep:
    """Measure a scene at every combination of values; points that `out` holds are not computed again.

    Parameters
    ----------
    ranges
        Key of the scene or name of the netlist -> ``"FROM:TO:COUNT"``, ``"FROM:TO:COUNT:log"`` or a sequence
        of values; the last one changes fastest.
    measures
        Names of `cosim.catalogue`, or ``file.py:Class`` of one's own; nothing is run where none needs it.
    out
        Folder that keeps points and table; none when not given.
    tolerances
        Errors that measures may have, as for `run`; a stated ``solver.model`` among the ranges is kept.
    on_progress
        Called with (points done, points in all, what is computed).

    Returns
    -------
    Sweep
        One value a point and measure, None where a point failed; `failed` says why. With tolerances, `errors`
        has the bounds.

    Raises
    ------
    InputError
        For an unknown name or measure, or when no point can be planned.
    StorageError
        When the folder cannot be written.

    Examples
    --------
    >>> from cosim.assets import scenes_folder
    >>> grid = sweep(scenes_folder() / "press.toml", {"computer.period_s": [0.001, 0.002]}, ["k_max"])
    >>> grid.values, min(grid.measures["k_max"]) > 0.0  # N/m
    ((('0.001',), ('0.002',)), True)
    """
    from cosim.comparisons.sweep import parse_range
    from cosim.comparisons.sweep import sweep as swept

    if isinstance(ranges, Mapping):
        ranges = [
            parse_range(f"{name}={values}") if isinstance(values, str) else Setting.of(name, values)
            for name, values in ranges.items()
        ]
    how: dict[str, Any] = {"child": child, "trust": trust, "on_progress": on_progress}
    if tolerances:
        from cosim.accuracy.tolerance_control import measurer_within, parse_tolerances

        free = all(setting.name != "solver.model" for setting in ranges)
        wanted = replace(parse_tolerances(tolerances), of=frozenset(measures))
        how |= {"measurer": measurer_within(wanted, free=free), "how": f"within {sorted(tolerances)}"}
    with doubts(), _folder(out, "sweep") as folder:
        return swept(scene, ranges, measures, folder, **how)


def compare(
    scene: SceneLike,
    boards: Sequence[str | Path] = (),
    values: Mapping[str, Sequence[Any]] | Sequence[Variant] = (),
    last: str | Path | None = None,
    out: str | Path | None = None,
    *,
    trust: bool = False,
    child: Child | None = None,
    on_progress: Callable[[int, int, str], None] | None = None,
) -> Comparison:
    """Check and run boards, values or an earlier run under one scene, side by side.

    Parameters
    ----------
    boards
        None (the scene's own), one or two netlists; the first is the reference.
    values
        Name -> values to try, all combinations.
    last
        Folder of a stored run, which becomes the reference.
    out
        Folder for the runs; a temporary one, removed afterwards, when not given.

    Raises
    ------
    InputError
        For a board that does not fit the scene, or when nothing is left to compare.
    SimulationError
        When a run fails.

    Examples
    --------
    >>> from cosim.assets import scenes_folder
    >>> scene = load_scene(scenes_folder() / "press.toml").with_values({"duration_s": 0.05})
    >>> comparison = compare(scene, values={"computer.period_s": [0.001]})
    >>> [side.label for side in comparison.sides]
    ['A as it stands', 'B computer.period_s=0.001']
    """
    from cosim.comparisons.compare_boards import changes, sides_of
    from cosim.comparisons.compare_boards import compare as compared

    if isinstance(values, Mapping):
        values = variants([Setting.of(name, each) for name, each in values.items()])
    asked = sides_of([str(board) for board in boards], list(values), Path(last) if last is not None else None)
    with doubts(), _folder(out, "compare") as folder:
        sides = compared(scene, asked, folder, child=child, trust=trust, on_progress=on_progress)
        return Comparison(tuple(sides), tuple(changes(sides)))


@contextmanager
def _folder(out: str | Path | None, what: str) -> Iterator[Path]:
    """Yield the folder asked for, or a temporary one."""
    if out is not None:
        yield Path(out)
    else:
        with scratch_folder(what) as folder:
            yield folder
