"""Work-precision study of a scene: cost and error of each solver setting, and the cheapest that will do.

Errors are against the first of two or three references that share no integrator; their disagreement
is the floor: no error is claimed below it.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

import cosim
from cosim.accuracy.noise_paths import PATHS, NoisePaths, noise_paths, noisy
from cosim.accuracy.pareto import Row, cheapest, clipped, finest, marked
from cosim.accuracy.run_outcome import Failed, First, Second, Summary, instants, peers, summary, trace_errors
from cosim.accuracy.solver_settings import (
    AS_STATED,
    MODELS,
    SHORTEST_S,
    Setting,
    carries,
    grid,
    reference,
    second_reference,
)
from cosim.catalogue import OF_A_RUN, UNITS
from cosim.caution import collected
from cosim.circuits.decks import Tolerances
from cosim.errors import CosimError, InputError, StorageError, fail
from cosim.export.scene_deck import deck_lines
from cosim.ngspice.child import Child, start_early
from cosim.plan import Plan, resolve
from cosim.runner import run
from cosim.scene import Scene, load_scene
from cosim.storage.checkpoint import Points
from cosim.storage.field_types import used
from cosim.storage.staging import disk_errors, scratch_folder
from cosim.types import Progress

__all__ = ["POINTS", "Accuracy", "Row", "accuracy"]

POINTS = "points.jsonl"
_FORM = "accuracy 1"
#: Measures that describe a run, not its accuracy.
_NO_ERROR = frozenset({"ledger_closure", "dac_saturations", "unreachable_samples", "headroom"})
#: Relative tolerances and methods at which the peer, one deck in plain ngspice, is run.
_PEER_RTOL, _PEER_METHODS = (1e-2, 1e-3, 1e-4, 1e-5, 1e-6, 1e-7), ("trap", "gear")
#: Longest steps over the scene's own, at a loose tolerance: a smooth deck may be best by steps alone.
_PEER_STEPS, _PEER_LOOSE = (0.5, 0.25, 0.125, 0.0625), 1e-3
_PEER = "one deck in ngspice"
_TIGHT_PEER = "one deck in ngspice, tight"


@dataclass(frozen=True)
class Accuracy:
    """A finished study.

    Attributes
    ----------
    scene : what was studied
    quantities : what errors are of: 'position', 'force', then measures, those asked for
    references : labels of the references, the first being the one that errors are against
    floor : quantity -> what the references disagree by, as a share
    values : measure -> value of the first reference
    rows : one a setting, peers last
    left_out : model -> what it leaves out of the scene, as overrides
    model_error : model -> quantity -> error of its finest setting, where it leaves something out
    neglected : effect that the scene leaves out -> a-priori share of the peak force, the largest first
    tolerance : what the recommendation has to meet
    cheapest : the recommendation; None where no setting meets the tolerance
    noise : what other paths of the noise say; None where there is none
    """

    scene: Scene
    quantities: tuple[str, ...]
    references: tuple[str, ...]
    floor: Mapping[str, float]
    values: Mapping[str, float]
    rows: tuple[Row, ...]
    left_out: Mapping[str, tuple[str, ...]]
    model_error: Mapping[str, Mapping[str, float]]
    neglected: Mapping[str, float]
    tolerance: float
    cheapest: Row | None
    noise: NoisePaths | None = None

    def as_dict(self) -> dict[str, Any]:
        """Return the study JSON-ready."""
        return {
            "title": self.scene.title,
            "quantities": list(self.quantities),
            "references": list(self.references),
            "floor": dict(self.floor),
            "values": {name: {"value": v, "unit": UNITS.get(name, "")} for name, v in self.values.items()},
            "left_out": {model: list(gone) for model, gone in self.left_out.items()},
            "neglected": dict(self.neglected),
            "model_error": {model: dict(errors) for model, errors in self.model_error.items()},
            "tolerance": self.tolerance,
            "recommended": self.cheapest.setting.lines() if self.cheapest else None,
            "rows": [row.as_dict() for row in self.rows],
            "noise": self.noise.as_dict() if self.noise else None,
        }


def accuracy(
    path: str | Path,
    folder: Path,
    *,
    overrides: tuple[str, ...] = (),
    measures: Sequence[str] = (),
    models: Sequence[str] = MODELS,
    tolerance: float = 1e-3,
    repeats: int = 3,
    peer: bool = True,
    trust: bool = False,
    child: Child | None = None,
    on_progress: Progress | None = None,
) -> Accuracy:
    """Run a scene at many settings of its solver; what is already in `folder` is not run again.

    Parameters
    ----------
    path, overrides, trust
        The scene, as for `load_scene` and `resolve`.
    measures
        Whose errors decide, besides those of position and force; by default those that the scene has of
        `peak_force`, `max_penetration` and `rendered_stiffness`.
    models
        Circuit models to try; one that does not carry all effects of the scene runs without these.
    tolerance
        Largest error of the recommendation, a share.
    repeats
        How often every setting is timed; all settings once, then all again.
    peer
        Whether one deck in plain ngspice is run as well, where the scene can be written as one.

    Raises
    ------
    InputError, SimulationError
        When scene or references cannot be run; a single setting that fails says so in its row.
    """
    useless = [name for name in measures if name not in OF_A_RUN or name in _NO_ERROR]
    if useless:
        fail(
            "has no error that a setting of the solver could make", key="--measure",
            value=", ".join(useless), allowed=", ".join(n for n in OF_A_RUN if n not in _NO_ERROR),
        )  # fmt: skip
    scene = load_scene(path, overrides)
    with collected(forward=False):
        plan = resolve(scene, trust=trust)
    text = f"{_FORM} {cosim.__version__} {scene.digest()} {scene.code_digest()} {plan.board.digest}"
    settings = grid(scene, models)
    stated = [setting for setting in settings if setting.series == AS_STATED]
    seeds = range(scene.seed + 1, scene.seed + 1 + PATHS) if noisy(scene) else ()
    with disk_errors(folder):
        folder.mkdir(parents=True, exist_ok=True)
    file = folder / POINTS
    with (
        Points(file, hashlib.sha256(text.encode()).hexdigest(), on_progress) as points,
        used(str(file), points.restored > 0),
    ):
        points.expect(2 + len(settings) * repeats + len(seeds) * (1 + len(stated)))
        runner = _Runner(path, overrides, trust, child, points)
        try:
            first = runner.reference(reference(scene))
            second = runner.with_peers(second_reference(scene), repeats if peer else 0)
            rounds = [[runner.point(setting, k) for setting in settings] for k in range(repeats)]
            kept = {name: value for name, value in first["measures"].items() if name not in _NO_ERROR}
            judged = partial(_errors, first, tuple(kept))
            quantities = _quantities(first, measures, scene)
            floor = judged(second)
            for name, share in judged(second["decks"].get(_TIGHT_PEER, {})).items():
                floor[name] = max(floor.get(name, 0.0), share)
            rows = [
                _row(setting, [part[i] for part in rounds], judged) for i, setting in enumerate(settings)
            ] + _peer_rows(second["decks"], judged)
            rows = marked([clipped(row, floor) for row in rows], quantities)
            best = cheapest(rows, quantities, tolerance)
            noise = None
            if seeds:  # the recommendation is of one path: what it does to the others is told as well
                told = list(dict.fromkeys([*stated, *([best.setting] if best else [])]))
                points.expect(len(seeds) * (len(told) - len(stated)))
                noise = noise_paths(seeds, runner.point, reference(scene), told, judged, kept)
        finally:
            runner.close()
        left = {model: _left_out(scene, model) for model in models if not carries(scene, model)}
        references = [reference(scene).label, second_reference(scene).label]
        references += [_TIGHT_PEER] if "motion" in second["decks"].get(_TIGHT_PEER, {}) else []
        return Accuracy(
            scene=scene,
            quantities=quantities,
            references=tuple(references),
            floor=floor,
            values=kept,
            rows=tuple(rows),
            left_out=left,
            model_error={model: finest(rows, model) for model in left},
            neglected=_neglected(plan, first),
            tolerance=tolerance,
            cheapest=best,
            noise=noise,
        )


class _Runner:
    """Runs settings of one scene, each kept as a point; replaces a process that a failed run has ended."""

    def __init__(
        self, path: str | Path, overrides: tuple[str, ...], trust: bool, child: Child | None, points: Points
    ) -> None:
        self._path, self._overrides, self._trust = path, overrides, trust
        self._child, self._own, self._points = child, False, points
        self._times: list[float] | None = None
        self._plans: dict[Setting, Plan | InputError] = {}

    def close(self) -> None:
        """End the process that was started here."""
        if self._own and self._child is not None:
            self._child.close()

    def _plan(self, setting: Setting) -> Plan:
        if setting not in self._plans:
            try:
                with collected(forward=False):
                    scene = load_scene(
                        self._path, (*self._overrides, *setting.overrides, "measures.names=[]")
                    )
                    self._plans[setting] = resolve(scene, trust=self._trust)
            except InputError as error:
                self._plans[setting] = error
        plan = self._plans[setting]
        if isinstance(plan, InputError):
            raise plan
        return plan

    def _run(self, setting: Setting, then: Callable[[Any], dict[str, Any]]) -> dict[str, Any]:
        try:
            with scratch_folder("accuracy") as place, collected(forward=False):
                return then(run(self._plan(setting), place / "run", formats=(), child=self._child))
        except StorageError:
            raise
        except CosimError:
            self.close()
            self._child = start_early("cosim.loop.early_imports")  # the other one has ended
            self._own = True
            raise

    def reference(self, setting: Setting) -> dict[str, Any]:
        """Run the first reference; it fixes the instants at which the others are compared with it."""

        def then(result: Any) -> dict[str, Any]:
            times = instants(result)
            return {**summary(result, times), "times": times.tolist()}

        answer = self._points.get(setting.label, lambda: self._run(setting, then), First)
        self._times = answer["times"]
        return dict(answer)

    def with_peers(self, setting: Setting, repeats: int) -> dict[str, Any]:
        """Run the second reference, and from its DACs the decks of the peer."""
        assert self._times is not None
        times = np.array(self._times)

        def then(result: Any) -> dict[str, Any]:
            decks = {}
            lockstep = setting if setting.model == "spice" else None
            if repeats and lockstep is not None:
                try:
                    decks = self._decks(lockstep, result)
                except InputError as error:
                    return {**summary(result, times), "decks": {_PEER: {"reason": error.problems[0].message}}}
            plan = self._plan(setting)
            timed = peers(decks, plan, times, 1, self._child) if decks else {}
            return {**summary(result, times), "decks": timed}

        key = f"{setting.label}, {_PEER if repeats else 'alone'}"
        return dict(self._points.get(key, lambda: self._run(setting, then), Second))

    def _decks(self, setting: Setting, result: Any) -> dict[str, str]:
        """Return the peer's decks by label: a grid of settings, and one that is tight."""
        plan = self._plan(setting)
        given = load_scene(self._path, self._overrides).solver
        coarse = plan.scene.model_copy(
            update={"solver": plan.scene.solver.model_copy(update={"max_step_s": given.max_step_s})}
        )
        decks = {_TIGHT_PEER: replace(plan, tolerances=Tolerances(1e-7, "gear", 1e-13))}
        for method in _PEER_METHODS:
            for rtol in _PEER_RTOL:
                tolerances = Tolerances(rtol, method, given.charge_tolerance_c)
                decks[f"{_PEER}, {method}, rtol {rtol:g}"] = replace(
                    plan, scene=coarse, tolerances=tolerances
                )
        for share in _PEER_STEPS:
            step = max(share * given.max_step_s, SHORTEST_S)
            tolerances = Tolerances(_PEER_LOOSE, "trap", given.charge_tolerance_c)
            finer = {"solver": plan.scene.solver.model_copy(update={"max_step_s": step})}
            label = f"{_PEER}, trap, rtol {_PEER_LOOSE:g}, max_step_s {step:g}"
            decks[label] = replace(plan, scene=plan.scene.model_copy(update=finer), tolerances=tolerances)
        return {label: "\n".join(deck_lines(each, result)) + "\n" for label, each in decks.items()}

    def point(self, setting: Setting, repetition: int) -> dict[str, Any]:
        """Run a setting once; a failure is a point as well."""
        times = np.array(self._times)

        def measured() -> dict[str, Any]:
            try:
                return self._run(setting, lambda result: summary(result, times))
            except StorageError:
                raise
            except CosimError as error:
                return {"failed": error.in_brief}

        return dict(self._points.get(f"{setting.label} #{repetition + 1}", measured, Summary | Failed))


def _quantities(first: Mapping[str, Any], asked: Sequence[str], scene: Scene) -> tuple[str, ...]:
    """Return the quantities whose errors decide: the motion, and the measures asked for."""
    there = {name for name, value in first["measures"].items() if value != 0.0}
    lacking = [name for name in asked if name not in there]
    if lacking:
        fail(
            "this scene has no such measure of a run, or it is zero", key="--measure",
            value=", ".join(lacking), allowed=", ".join(n for n in OF_A_RUN if n in there - _NO_ERROR),
        )  # fmt: skip
    usual = [n for n in ("peak_force", "max_penetration", "rendered_stiffness") if n in there]
    return (*trace_errors(first["motion"], first["motion"]), *(asked or usual))


def _errors(first: Mapping[str, Any], names: tuple[str, ...], other: Mapping[str, Any]) -> dict[str, float]:
    """Return the errors of a run against the first reference, as shares of the reference's value."""
    out = trace_errors(other.get("motion", {}), first["motion"])
    for name in names:
        right, value = first["measures"][name], other.get("measures", {}).get(name)
        if value is not None and right != 0.0:
            out[name] = abs(value - right) / abs(right)
    return out


def _row(setting: Setting, runs: Sequence[Mapping[str, Any]], judged: Callable[..., dict[str, float]]) -> Row:
    failed = next((each["failed"] for each in runs if "failed" in each), "")
    if failed:
        return Row(setting, failed=failed)
    wall_s, cpu_s, setup_s = (
        tuple(float(each[clock]) for each in runs) for clock in ("wall_s", "cpu_s", "setup_s")
    )
    one = runs[0]
    return Row(setting, wall_s, cpu_s, setup_s, one["points"], one["rejected"], one["states"], judged(one))


def _peer_rows(decks: Mapping[str, Any], judged: Callable[..., dict[str, float]]) -> list[Row]:
    rows = []
    for label, got in decks.items():
        if label == _TIGHT_PEER and "motion" in got:
            continue
        setting = Setting("peer", _PEER, label, ())
        if "reason" in got:
            rows.append(Row(setting, failed=got["reason"]))
        else:
            wall_s, cpu_s = (tuple(map(float, got[clock])) for clock in ("wall_s", "cpu_s"))
            errors = judged(got)
            rows.append(Row(setting, wall_s, cpu_s, points=int(got["points"]), errors=errors))
    return rows


def _left_out(scene: Scene, model: str) -> tuple[str, ...]:
    setting = grid(scene, (model,))[0]
    return setting.overrides[:-1]


def _neglected(plan: Plan, first: Mapping[str, Any]) -> dict[str, float]:
    """Return the a-priori sizes of the effects that the scene leaves out, the largest first."""
    peak = first["measures"].get("peak_force", 0.0)
    rows = [row for row in plan.as_dict()["left_out"] if not row["not_applicable"]]
    return {str(row["name"]): float(row["size"]["force_n"]) / peak for row in rows} if peak else {}
