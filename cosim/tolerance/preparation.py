"""What a Monte Carlo of a scene is asked for, and the scene made ready for it, before the first sample."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Protocol

import cosim
from cosim.caution import Caution, warn
from cosim.comparisons.measure_values import check_blocks, check_measures, needs_a_run
from cosim.errors import InputError, Problem, fail
from cosim.plan import Plan, resolve
from cosim.scene import load_scene
from cosim.scene.load import SceneLike
from cosim.tolerance.batch import Batch
from cosim.tolerance.engine import Job, Work
from cosim.tolerance.missing import Missing, of_measures
from cosim.tolerance.monte_carlo import Measurer
from cosim.tolerance.random_variables import Tolerances
from cosim.tolerance.scene_variables import tolerances
from cosim.tolerance.spec import Spec
from cosim.tolerance.trim import Trimmed, trims
from cosim.tolerance.unit_cube import Method
from cosim.tolerance.value_expression import Recipe
from cosim.types import Array

__all__ = ["MOST", "Asked", "Points", "Prepared", "prepare"]

#: Samples of a study, at most.
MOST = 10_000_000


class Points(Protocol):
    """Points of the unit cube by their number: what a sampling is, and a choice of its samples."""

    def uniforms(self, first: int, count: int) -> Array:
        """Return points ``first`` to ``first + count - 1`` (count, variables)."""
        ...

    def as_dict(self) -> dict[str, Any]:
        """Return what they depend on, JSON-ready."""
        ...


@dataclass(frozen=True)
class Asked:
    """What ``cosim mc`` is asked for.

    Attributes
    ----------
    scene, overrides, trust
        As for `load_scene` and `resolve`.
    measures, specs
        Names; limits, whose measures come on top.
    n, method, seed
        Samples; `seed` is the scene's where it is None.
    until
        As ``yield +- 0.5%`` or ``k_max +- 5 N/m``: `n` is then found by a pilot.
    wanted
        Yield that the bill's loosest tolerances keep.
    corners
        Whether to search the worst case.
    two_level, rare
        Whether a cheaper model corrects the estimates; whether failures too rare for samples are searched.
    """

    scene: SceneLike
    overrides: tuple[str, ...] = ()
    measures: tuple[str, ...] = ()
    specs: tuple[Spec, ...] = ()
    n: int = 200
    method: Method = "plain"
    seed: int | None = None
    until: str = ""
    wanted: float | None = None
    corners: bool = False
    trust: bool = False
    two_level: bool = False
    rare: bool = False


@dataclass(frozen=True)
class Prepared:
    """A scene that is ready to be drawn: plan, what varies, measures, seed."""

    asked: Asked
    plan: Plan
    tolerances: Tolerances
    names: tuple[str, ...]
    seed: int

    def batch(self, names: Sequence[str], model: str) -> Measurer:
        """Return the measurer of devices, with trimming if the scene asks for it."""
        trimmers = trims(self.plan.scene)
        needed = tuple(dict.fromkeys((*names, *(trim.measure for trim in trimmers))))
        designed = self.tolerances.nominal.tolist()
        measurer: Measurer = Batch(self.plan, self.tolerances.keys, needed, model, designed)
        for trim in trimmers:
            measurer = Trimmed(measurer, needed, trim, _columns(trim.resistor, self.tolerances))
        return measurer if needed == tuple(names) else _Some(measurer, tuple(names))

    def job(self, points: Points, n: int, model: str | None = None) -> Job:
        """Return samples as the engine takes them; `model` where it is not the study's."""
        identity = [self.digest(), points.as_dict(), *([model] if model is not None else [])]
        digest = hashlib.sha256(json.dumps(identity, sort_keys=True).encode()).hexdigest()
        return Job(digest, self.names, n, _Work(self, points, model or self.plan.model))

    def digest(self) -> str:
        """SHA-256 of all that the samples depend on."""
        scene, asked = self.plan.scene, self.asked
        # to the board's digest a tolerance is a comment, and a scene names the file of a histogram only
        drawn = [f"{each.key} {each.recipe!r}" for each in self.tolerances.components]
        parts = (
            cosim.__version__, scene.digest(), scene.code_digest(), self.plan.board.digest, self.plan.model,
            *self.names, asked.method, str(asked.n), asked.until, str(self.seed),
            *self.tolerances.variables, *drawn,
        )  # fmt: skip
        return hashlib.sha256("\n".join(parts).encode()).hexdigest()


@dataclass(frozen=True)
class _Work:
    """Makes the measurer of a study's samples in a process of the engine."""

    prepared: Prepared
    points: Points
    model: str

    def __call__(self) -> Work:
        batch = self.prepared.batch(self.prepared.names, self.model)

        def work(first: int, count: int) -> tuple[Array, Missing]:
            values = self.prepared.tolerances.values(self.points.uniforms(first, count))
            return batch.measures(values), dict(batch.failures)

        return work


def prepare(asked: Asked) -> Prepared:
    """Load, resolve and check everything before the first sample.

    Raises
    ------
    InputError
        For anything wrong with the scene, its tolerances, measures and numbers.
    """
    names = tuple(dict.fromkeys((*asked.measures, *(spec.measure for spec in asked.specs))))
    check_measures(names)
    if not 1 <= asked.n <= MOST:
        fail("is not a possible number of samples", key="-n", value=asked.n, allowed=f"1 to {MOST}")
    if asked.seed is not None and not 0 <= asked.seed < 2**63:
        fail(
            "is not a valid seed",
            key="--seed",
            value=asked.seed,
            allowed="0 to 9223372036854775807, as the scene's",
        )
    if asked.wanted is not None and not 0.0 < asked.wanted < 1.0:
        fail("is not a yield", key="--yield", value=f"{100 * asked.wanted:g}%", allowed="> 0% and < 100%")
    scene = load_scene(asked.scene, asked.overrides)
    trims(scene)
    plan = resolve(scene, trust=asked.trust)
    check_blocks(names, (plan.board,))
    if scene.tolerance.calibration == "gains" and plan.model == "spice" and needs_a_run(names):
        file = str(scene.file) if scene.file else None
        fail("runs on the models linear and ideal only: set solver.model to linear", file=file,
             key="tolerance.calibration", value="gains")  # fmt: skip
    variables = tolerances(scene, board=plan.board, trust=asked.trust)
    for name in variables.idle:
        warn(
            Caution(
                "tolerance-unused",
                f"tolerance.{name}: nothing that is in force belongs to it",
                "switch the effect on that uses it, or take it out",
            )
        )
    seed = scene.seed if asked.seed is None else asked.seed
    own = tuple(name for name in scene.measures.names if ":" not in name)
    names = names or own or ("peak_force", "max_penetration")
    return Prepared(asked, plan, _with_trimmers(plan, variables), names, seed)


def _with_trimmers(plan: Plan, variables: Tolerances) -> Tolerances:
    """Return what varies and what is trimmed: a trimmer without a tolerance begins at its nominal value."""
    missing = [trim.resistor for trim in trims(plan.scene) if not _columns(trim.resistor, variables)]
    if not missing:
        return _resistors(plan, variables)
    table = plan.scene.tolerance
    named = {**table.components, **dict.fromkeys(missing, "1%")}
    scene = plan.scene.model_copy(update={"tolerance": table.model_copy(update={"components": named})})
    try:
        every = tolerances(scene, board=plan.board, trust=plan.trust)
    except InputError as error:
        raise InputError(
            replace(problem, key=(problem.key or "").replace("components", "trim"))
            for problem in error.problems
        ) from None
    still = [
        replace(each, distribution="trimmed", lots=(), recipe=Recipe(each.nominal))
        for each in every.components
        if each.key not in variables.keys
    ]
    return _resistors(plan, replace(variables, components=(*variables.components, *still)))


def _resistors(plan: Plan, variables: Tolerances) -> Tolerances:
    """Return what varies, or refuse a trimmer that is another kind of part: those are resistors."""
    file = str(plan.scene.file) if plan.scene.file else None
    problems = [
        Problem(
            f"{each.key} is no resistor", file, f"tolerance.trim.{name}", text,
            allowed="a resistor, or a parameter in Ohm",
        )
        for name, text in plan.scene.tolerance.trim.items()
        for each in (variables.components[place] for place in _columns(name.lower(), variables))
        if each.unit in ("F", "H")
    ]  # fmt: skip
    if problems:
        raise InputError(problems)
    return variables


def _columns(name: str, variables: Tolerances) -> tuple[int, ...]:
    """Return the places of a resistor's components: its own, or those of all instances or of a parameter."""
    return tuple(
        place
        for place, each in enumerate(variables.components)
        if name in (each.key, each.key.rpartition(".")[2], *each.names)
    )


class _Some:
    """A batch of which the first measures, `names`, are wanted."""

    def __init__(self, batch: Measurer, names: tuple[str, ...]) -> None:
        self._batch, self._names = batch, names
        self.failures: Missing = {}

    def measures(self, values: Any) -> Any:
        """Return the first measures."""
        rows = self._batch.measures(values)
        self.failures = of_measures(self._batch.failures, self._names)
        return rows[:, : len(self._names)]
