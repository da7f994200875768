"""Many built devices, and the paper's studies, from a script."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from cosim.api.python_warnings import doubts
from cosim.scene import load_scene
from cosim.scene.load import SceneLike
from cosim.storage.staging import scratch_folder

if TYPE_CHECKING:  # loaded when they are called
    from cosim.studies.study import StudyResult
    from cosim.tolerance.study_results import Findings
    from cosim.tolerance.unit_cube import Method

__all__ = ["monte_carlo", "study"]


def monte_carlo(
    scene: SceneLike,
    specs: Sequence[str] = (),
    *,
    measures: Sequence[str] = (),
    samples: int = 200,
    sampling: Method = "plain",
    seed: int | None = None,
    until: str = "",
    worst_case: bool = False,
    trust: bool = False,
    out: str | Path | None = None,
    workers: int | None = None,
    on_progress: Callable[[int, int, str], None] | None = None,
) -> Findings:
    """Measure many devices built from one design: their yield, and which component is to blame.

    Parameters
    ----------
    scene
        Scene or its file; tolerances stand in the netlist and in ``[tolerance]``.
    specs
        What a device must do to pass: ``"rendered_stiffness in 103.5..105.5"``, ``"k_max > 500"``.
    measures
        Further measures of each device.
    samples, sampling, seed
        How many devices, 'plain', 'lhs' or 'sobol', and the seed of the draws (default: the scene's).
    until
        Instead of `samples`: ``"yield +- 0.5%"`` or ``"k_max +- 5 N/m"``.
    worst_case
        Whether to search the worst device within all limits as well.
    trust
        Whether the netlists may hold commands and name files.
    out
        Folder that keeps finished samples, and to go on from; measured in this process when not given.
    workers
        Processes of a study that is kept in `out`.
    on_progress
        Called with (devices done, devices in all, what is done).

    Returns
    -------
    Findings
        Summaries, yields, fitted surfaces and the tolerance bill; shows itself in a notebook.

    Raises
    ------
    InputError
        For anything wrong with scene, tolerances, measures or numbers; where nothing varies.

    Examples
    --------
    >>> from cosim.assets import scenes_folder
    >>> batch = monte_carlo(scenes_folder() / "press.toml", ["eta < 0.1"], samples=3)
    >>> {spec: share.value for spec, share in batch.yields.items()}
    {'eta <= 0.1': 1.0}
    """
    from cosim.tolerance.scene_study import Asked, Processes, check_folder, prepare
    from cosim.tolerance.scene_study import monte_carlo as drawn
    from cosim.tolerance.spec import parse_specs

    asked = Asked(
        load_scene(scene), (), tuple(measures), parse_specs(specs), samples, sampling, seed, until,
        corners=worst_case, trust=trust,
    )  # fmt: skip
    with doubts():
        prepared = prepare(asked)
        processes = None
        if out is not None:
            check_folder(Path(out), prepared.digest())
            processes = Processes(Path(out), workers)
        return drawn(prepared, on_progress, processes)


def study(
    file: str | Path,
    changes: Sequence[str] = (),
    out: str | Path | None = None,
    *,
    on_progress: Callable[[int, int, str], None] | None = None,
) -> StudyResult:
    """Run a study file, such as those of the paper.

    Parameters
    ----------
    file
        TOML file with ``study``, ``scene``, ``set`` and ``[parameters]``.
    changes
        Changes of its scene, as ``--set`` writes them: ``"r_sum_spring=24k"``.
    out
        Folder that keeps result and finished points; none when not given.
    on_progress
        Called with (points done, points in all, what is computed).

    Returns
    -------
    StudyResult
        Tables, verdicts and notes; shows itself in a notebook.

    Raises
    ------
    InputError
        With every problem of the file or of its scene.

    Examples
    --------
    >>> from cosim.assets import scenes_folder
    >>> paper = study(scenes_folder() / "paper/0_2_passive.toml")
    >>> [verdict.id for verdict in paper.verdicts if verdict.holds is False]
    []
    """
    from cosim.studies.study import load_study, run_study

    spec = load_study(file, tuple(changes))
    with doubts():
        if out is not None:
            return run_study(spec, Path(out), on_progress=on_progress)
        with scratch_folder("study") as folder:
            return run_study(spec, folder / "result", on_progress=on_progress)
