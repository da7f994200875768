"""The one path: Scene -> Plan -> Run."""

from __future__ import annotations

import platform
import sys
import tempfile
import time
import uuid
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from functools import cache, cached_property, partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cosim import plausibility
from cosim.caution import Caution, collected, warn
from cosim.circuits.design_constants import DesignConstants
from cosim.circuits.instability.stability_verdict import Verdict
from cosim.errors import fail
from cosim.loop.run_messages import RunAnswer, RunRequest
from cosim.measures import chosen, headroom, own_measures, standard
from cosim.ngspice import deck_file
from cosim.ngspice.child import OUTBOX, Child, call
from cosim.plan import Plan, resolve
from cosim.provenance import packages, provenance, run_date
from cosim.results import Run, written_files
from cosim.scene import PythonOperator, Scene
from cosim.stability_gate import answer_of, bent, coupled, latched, left, question, reached, verdict
from cosim.storage.field_types import prepare
from cosim.storage.rawfile import RAW, Signals, read_raw, stamp
from cosim.storage.run_record import Record
from cosim.storage.staging import Staging, disk_errors, scratch_folder
from cosim.types import Measures
from cosim.units import quantity
from mech.library_files import ready

__all__ = ["Errors", "measures_of", "path_of", "request_of", "resolve", "run"]

#: Returns the measures of what was simulated with their errors; see `run`.
Errors = Callable[["Simulated", Callable[[], object]], Mapping[str, dict[str, Any]]]

#: What simulates a circuit model, in the child process.
_TARGETS = {
    "spice": "cosim.loop.spice.run_spice",
    "linear": "cosim.loop.linear.run_linear",
    "ideal": "cosim.loop.linear.run_linear",
}
#: A simulation without progress for this long [s] counts as hanging.
_STALL_S = 60.0
#: A run is not started if its predicted time is this many times the limit.
_HOPELESS = 10.0


def run(
    plan: Plan,
    out: str | Path | None = None,
    *,
    formats: Collection[str] = ("parquet",),
    on_progress: Callable[[Mapping[str, Any]], None] | None = None,
    child: Child | None = None,
    command: list[str] | None = None,
    more: Measures | None = None,
    errors: Errors | None = None,
) -> Run:
    """Simulate a plan and save the result whole, or not at all.

    Parameters
    ----------
    plan
        From `resolve`.
    out
        Result folder; a temporary one when not given (its path is `Run.signals.path.parent`).
    formats
        Further forms of the signals, see `cosim.results.FORMATS`.
    on_progress
        Called with {'time_s', 'points'} while the simulation runs.
    child
        A process from `cosim.ngspice.child.start_early`; it can serve several runs.
    command
        Command line for the provenance.
    more
        Measures that need no run, to be kept with its own (`cosim.comparisons.measure_values`).
    errors
        Called with what was simulated, and with what it may call, once, while it waits for the child; returns
        the run's own measures with their errors (`cosim.accuracy.estimate`).

    Raises
    ------
    InputError
        For a board that ngspice does not accept or that is unstable, or a place that cannot be written.
    SimulationError
        For everything that goes wrong while it runs.
    """
    with collected() as cautions:
        warn(*plan.cautions)
        return _run(plan, out, formats, on_progress, child, command, more or {}, errors, cautions)


def _run(
    plan: Plan,
    out: str | Path | None,
    formats: Collection[str],
    on_progress: Callable[[Mapping[str, Any]], None] | None,
    child: Child | None,
    command: list[str] | None,
    more: Measures,
    errors: Errors | None,
    cautions: Sequence[Caution],
) -> Run:
    """Simulate and save, with the `cautions` raised until the result was complete."""
    begun = time.perf_counter()
    scene = plan.scene
    target = Path(out) if out is not None else Path(tempfile.gettempdir()) / f"cosim-run-{uuid.uuid4().hex}"
    with Staging(target, written_files) as stage:  # refuses the place before anything is computed
        judged = _judged(plan, child)
        told = cache(partial(_told_before, plan, stage.path))
        done = _simulated(plan, stage.path, child, on_progress, told)
        answer, samples, signals = done.answer, done.samples, done.signals
        constants, ledger, amplifiers = done.constants, answer.ledger, done.amplifiers
        stamp(stage.path / RAW, run_date())
        looked = cache(partial(_looked_at, done))
        measures = {**(errors(done, looked) if errors is not None else done.measures), **more}
        own = _own(plan, constants, stage.path / RAW, samples, child)
        measures |= own["rows"]
        warn(*looked())
        if answer.end is not None:
            limits = {a["node"]: a["swing_v"] for a in amplifiers if a["swing_v"]}
            warn(*latched(plan, answer.end, limits, child), *left(plan, answer.end))
        if not judged.unjudged and (poses := reached(plan, _angles(signals, scene.joints))):
            warn(*coupled(plan, child, poses))
        if answer.circuit is not None:
            warn(*plausibility.of_circuit(answer.circuit, constants))
        stats = dict(answer.stats)
        stats["total_s"] = time.perf_counter() - begun
        result = Run(
            scene=scene,
            signals=signals,
            samples=samples,
            plan={
                **told(),
                "circuit_states": told()["circuit_states"] or plan.circuit_states(),  # extracted since
                "constants": constants.as_dict(),
                "amplifiers": headroom(amplifiers),
                "certificate": answer.circuit.certificate if answer.circuit is not None else {},
                "component_noise": answer.component_noise,
                "stability": judged.as_dict(),
            },
            events=_events(samples),
            measures=chosen(measures, scene),
            ledger=ledger,
            stats=stats,
            printed=(*answer.printed, *own["printed"]),
            warnings=tuple(cautions),
            provenance=provenance(
                scene,
                command=command if command is not None else list(sys.argv),
                ngspice=answer.ngspice,
                deck_digest=plan.board.digest,
            ),
        )
        result.write_into(stage.path, formats)  # last: it seals what is there
        stage.publish()
    return Run.load(target)


def _judged(plan: Plan, child: Child | None) -> Verdict:
    """Return the verdict on the circuit's stability, and say what it and its response leave in doubt."""
    plan.stated(child)
    _check_duration(plan)
    solver, file = plan.scene.solver, str(plan.board.path)
    judged = verdict(question(plan), plan.board.path, child, solver.time_limit_s)
    if not solver.allow_unstable:
        judged.require(file)
    _, floating, node = judged.unjudged.partition("floating node: ")
    if floating:  # a transient would try for a minute
        fail(floating + node, file=file)
    warn(*judged.cautions())
    if not judged.unjudged:
        warn(*coupled(plan, child))
        if plan.model == "spice":  # the other models tell it of the circuit that they simulate
            stated = plan.stated().constants()
            warn(*plausibility.of_response(answer_of(plan, child), stated, lambda: bent(plan, child)))
    return judged


def _told_before(plan: Plan, folder: Path) -> dict[str, Any]:
    """Keep the board in the result's folder and return what the record tells of the plan, while it waits.

    What is slow to look up for its other parts is looked up, too, and kept where it is: 30 ms of a run.
    """
    with disk_errors(folder):
        deck_file.save(plan.board, folder)
    packages()
    platform.platform()
    prepare(Record)
    return plan.as_dict()


def _looked_at(done: Simulated) -> list[Caution]:
    """Return what the run itself leaves in doubt."""
    return plausibility.of_run(
        done.scene, done.constants, done.signals, done.samples,
        done.measures, done.amplifiers, done.answer.ledger,
    )  # fmt: skip


@dataclass(frozen=True)
class Simulated:
    """A finished simulation: the child's answer, and what was read from it.

    Attributes
    ----------
    scene, constants : what was simulated
    answer : the child's
    samples, signals : by name, one value a sample, and one a time point
    amplifiers : peak and limit of each
    """

    scene: Scene
    constants: DesignConstants
    answer: RunAnswer
    samples: dict[str, NDArray[np.float64]]
    signals: Signals
    amplifiers: list[dict[str, Any]]

    @cached_property
    def measures(self) -> dict[str, dict[str, Any]]:
        """A run's own measures."""
        return standard(
            self.scene, self.constants, self.signals, self.samples, self.amplifiers, self.answer.ledger
        )

    @property
    def contacts(self) -> tuple[int, ...]:
        """Numbers of the samples at which contact is made or lost."""
        return tuple(np.flatnonzero(np.diff(self.samples["contact"], prepend=0.0)).tolist())


def _simulated(
    plan: Plan,
    folder: Path,
    child: Child | None,
    on_progress: Callable[[Mapping[str, Any]], None] | None = None,
    meanwhile: Callable[[], object] | None = None,
) -> Simulated:
    """Simulate in the child process, and call `meanwhile` beside it; the signals land in the folder."""
    scene = plan.scene
    asked = request_of(plan, child)
    ready()
    answer: RunAnswer = call(
        f"{_TARGETS[plan.model]}:simulate",
        asked,
        time_limit_s=scene.solver.time_limit_s,
        stall_limit_s=_STALL_S,
        on_progress=on_progress,
        deck=str(plan.board.path),
        child=child,
        reads=_python_folders(scene),
        collect=folder,
        meanwhile=meanwhile,
    )
    samples = _read_samples(folder / "samples.f64", answer.sample_columns)
    signals = read_raw(folder / RAW)
    return Simulated(scene, asked.constants, answer, samples, signals, _amplifiers(plan, answer))


def request_of(plan: Plan, child: Child | None = None) -> RunRequest:
    """Return the request to a time loop for a plan; it leaves its result in `OUTBOX`."""
    return RunRequest(
        scene=plan.scene,
        board=plan.board,
        constants=plan.stated(child).constants(),
        model=plan.model,
        recorded=plan.recorded,
        watched=plan.watched,
        tolerances=plan.tolerances,
        predicted_points=plan.cost()["points"],
        folder=OUTBOX,
    )


def measures_of(
    plan: Plan, child: Child | None, meanwhile: Callable[[], object] | None = None
) -> tuple[dict[str, dict[str, Any]], tuple[int, ...]]:
    """Simulate a plan whose board was judged before, and call `meanwhile` beside it; nothing is kept.

    Returns its measures, and the numbers of the samples at which contact is made or lost. Raises as `run`.
    """
    with scratch_folder("measures") as folder:
        done = _simulated(plan, folder, child, meanwhile=meanwhile)
        return done.measures, done.contacts


def path_of(
    plan: Plan, child: Child | None, meanwhile: Callable[[], object] | None = None
) -> tuple[dict[str, NDArray[np.float64]], tuple[int, ...]]:
    """Return the signals of a plan's simulation by name, and contacts, as `measures_of` does."""
    with scratch_folder("path") as folder:
        done = _simulated(plan, folder, child, meanwhile=meanwhile)
        return {name: np.array(values) for name, values in done.signals.items()}, done.contacts


def _python_folders(scene: Scene) -> list[Path]:
    """Return the folders of the user's Python files, which may import what lies beside them."""
    base = scene.file.parent if scene.file is not None else Path()
    named = [scene.computer.law] if scene.computer.law is not None else []
    named += [scene.operator.file] if isinstance(scene.operator, PythonOperator) else []
    named += own_measures(scene)
    return list(dict.fromkeys((base / each.rpartition(":")[0]).resolve().parent for each in named))


def _own(
    plan: Plan,
    constants: DesignConstants,
    raw: Path,
    samples: Mapping[str, NDArray[np.float64]],
    child: Child | None,
) -> dict[str, Any]:
    """Evaluate the user's own measures in the child, which runs their laws too: 'rows', 'printed'."""
    names = own_measures(plan.scene)
    if not names:
        return {"rows": {}, "printed": []}
    asked = {"scene": plan.scene, "constants": constants, "raw": raw, "samples": samples, "names": names}
    answer: dict[str, Any] = call(
        "cosim.loop.usermeasure:measured",
        asked,
        time_limit_s=plan.scene.solver.time_limit_s,
        deck=str(plan.board.path),
        child=child,
        reads=[raw.parent, *_python_folders(plan.scene)],
    )
    return answer


def _check_duration(plan: Plan) -> None:
    """Refuse a run that cannot end in time, by a prediction good to a factor of a few."""
    seconds, limit = plan.cost()["seconds"], plan.scene.solver.time_limit_s
    if seconds > _HOPELESS * limit:
        fail(
            f"the run would compute for about {quantity(seconds, 's')} (see cosim plan): check "
            f"duration_s, "
            "computer.period_s, solver.max_step_s and the noise, or raise this limit",
            file=plan.scene.file_name,
            key="solver.time_limit_s",
            value=limit,
            unit="s",
        )


def _read_samples(file: Path, columns: Sequence[str]) -> dict[str, NDArray[np.float64]]:
    """Columns of the computer's samples; deletes the streamed file."""
    table = np.fromfile(file).reshape(-1, len(columns))
    file.unlink()
    return {name: np.ascontiguousarray(table[:, i]) for i, name in enumerate(columns)}


def _amplifiers(plan: Plan, answer: RunAnswer) -> list[dict[str, Any]]:
    """Peak output of every amplifier against its limit."""
    out = []
    stated = plan.board.text.lower()
    for amplifier in plan.board.amplifiers:
        peak = answer.peaks.get(amplifier.out_node)
        swing = answer.swings.get(amplifier.out_node)
        if peak is None:
            continue
        out.append(
            {
                "path": amplifier.path,
                "part": amplifier.part,
                "role": amplifier.role,
                "node": amplifier.out_node,
                "peak_v": peak,
                "swing_v": swing,
                "swing_stated": f".csparam {amplifier.swing_param}=" in stated,
                "clipped_s": answer.clipped_s.get(amplifier.out_node, 0.0),
                "headroom": 1.0 - peak / swing if swing else 0.0,
            }
        )
    return out


def _angles(signals: Signals, joints: int) -> NDArray[np.float64]:
    return np.column_stack([signals[f"q{k + 1}"] for k in range(joints)])


def _events(samples: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Contacts made and lost, as the computer saw them."""
    events: list[dict[str, Any]] = []
    before = 0.0
    for at, contact, pen in zip(samples["time"], samples["contact"], samples["pen"], strict=True):
        if contact != before:
            kind = "contact" if contact else "release"
            events.append({"time_s": float(at), "kind": kind, "penetration_m": float(pen)})
        before = contact
    return events
