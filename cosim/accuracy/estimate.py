"""The error of each measure of a run, from a twin: the same scene, solved far more closely by another solver.

Where the model `linear` carries the scene, its loop is the twin of a lockstep with ngspice: it shares neither
the integrator of the circuit nor the coupling, and costs a small part. What the tolerances of its own circuit
may hide (fit, reduction, gains that are not quite proportional) is added as a share of the value. A scene
that only ngspice carries is its own twin, with tolerances ten times tighter (of charges a hundred times) and
half the longest step, of those allowed and of those taken, or a quarter of a period.

The difference of run and twin is the error of the run plus the twin's own, which is smaller: the bound is the
difference times a margin.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from cosim.accuracy.noise_paths import noisy
from cosim.accuracy.solver_settings import carries
from cosim.caution import Caution, collected, warn
from cosim.circuits.linear_circuit import LinearCircuit
from cosim.errors import CosimError
from cosim.ngspice.child import Child
from cosim.plan import Plan, resolve
from cosim.runner import Errors, Simulated, measures_of

__all__ = ["Twin", "estimator", "twin_of"]

Measures = Mapping[str, Mapping[str, Any]]

#: The bound over the difference of run and twin. Were the twin exact, 1 would do: it is not, and where rows
#: miss a peak its error falls with the first power of the step only. Measured over shipped scenes
#: (`python -m benchmarks.estimates`), 95 % of the errors are within the bound with 1.4.
_MARGIN = 1.6
#: Of a twin with half the step: at first order its error is half of the run's, as large as the difference.
OWN_MARGIN = 2.5
#: Steps grow twofold behind a sample, so that the longest is half a period: an own twin has half of it.
_WITHIN = 4.0
#: Beside the charges of a board, of 1e-12 C to 1e-9 C, its usual tolerance is large: with a tenth of it the
#: steps behind a DAC's jump would be those of the run.
_LESS_CHARGE = 100.0
#: Looser relative tolerances, too, leave those steps as they are: an own twin has a tenth of this at most.
_USUAL_RTOL = 1e-4
#: The twin's steps are an eighth of the scene's, of its period, and of this, the usual longest step [s].
_FINER, _USUAL_STEP_S = 8.0, 2e-3
#: Runs and twins are right to this share of a value, whatever their difference: steps are controlled to
#: 1e-10 rad of joints that turn by a tenth of a radian.
_RESOLVED = 1e-9
#: Measures of a run's accuracy have no error of their own.
_WITHOUT = frozenset({"ledger_closure"})


@dataclass(frozen=True)
class Twin:
    """The plan that a run is held against.

    Attributes
    ----------
    plan : what is simulated
    margin : bound over the difference
    words : what it is, for people
    """

    plan: Plan
    margin: float
    words: str


def twin_of(plan: Plan, *, own: bool = False, taken_s: float = math.inf) -> Twin:
    """Return the twin of a plan; with `own` the same model, more tightly solved.

    Parameters
    ----------
    plan : what was run
    own : whether the twin has the run's model although another carries the scene
    taken_s : the longest step [s] that the run took: bounds that are not the scene's (a shaft's oscillation,
        the back-EMF's) hold for run and twin alike

    Raises
    ------
    InputError
        Where the other model does not take the scene.
    """
    scene, solver = plan.scene, plan.scene.solver
    model = "linear" if plan.model == "spice" and carries(scene, "linear") and not own else plan.model
    if model == "spice":
        longest_s = min(min(solver.max_step_s, taken_s) / 2.0, scene.computer.period_s / _WITHIN)
        finer = {
            "rtol": max(min(solver.rtol, _USUAL_RTOL) / 10.0, 1e-9),
            "max_step_s": max(longest_s, 1e-9),
            "coupling_tolerance_rad": max(solver.coupling_tolerance_rad / 10.0, 1e-14),
            "charge_tolerance_c": max(solver.charge_tolerance_c / _LESS_CHARGE, 1e-18),
        }
        words, margin = "the same model with tolerances ten times tighter", OWN_MARGIN
    else:
        finer = {
            "max_step_s": max(min(solver.max_step_s, scene.computer.period_s, _USUAL_STEP_S) / _FINER, 1e-9),
            "coupling_tolerance_rad": max(1e-3 * min(solver.coupling_tolerance_rad, 1e-7), 1e-14),
            # its default is a bound over the band of a hand; what overshoots behind a jump is faster
            "reduction_tolerance": min(solver.reduction_tolerance, 1e-9),
        }
        words, margin = f"the model {model}, an eighth of the step and tight tolerances", _MARGIN
    update = {"solver": solver.model_copy(update={**finer, "model": type(solver.model)(model)})}
    with collected(forward=False):
        other = resolve(scene.model_copy(update=update), trust=plan.trust, board=plan.board)
    return Twin(other, margin, words)


def estimator(plan: Plan, child: Child | None) -> Errors:
    """Return what `cosim.runner.run` calls for the errors of its measures.

    Every row gets 'error', a bound in the measure's unit, or None with 'no_error' saying why. In a scene with
    noise it gets what `noise_of` returns, too: the twin is on the run's path and knows nothing of others.
    Where run and twin make contact at different samples the bounds span both sequences, and a caution says
    so: neither is close to the other, and tighter tolerances may give a third.
    """

    def errors(done: Simulated, meanwhile: Callable[[], object]) -> dict[str, dict[str, Any]]:
        why, drawn_anew = "", noisy(plan.scene)
        taken_s = float(np.diff(done.signals["time"]).max()) if plan.model == "spice" else math.inf

        def beside() -> None:
            meanwhile()
            if drawn_anew:
                import cosim.accuracy.noise_interval  # noqa: F401  theory, and all of scipy: 0.2 s

        for own in (False, True):
            try:
                twin = twin_of(plan, own=own, taken_s=taken_s)
                with collected(forward=False):
                    nominal, others = measures_of(twin.plan, child, beside)
                break
            except CosimError as error:
                why = error.in_brief
        else:
            return {name: {**row, "error": None, "no_error": why} for name, row in done.measures.items()}
        if done.contacts != others:
            warn(_other_sequence(done.contacts, others))
        circuit = done.answer.circuit
        share = doubt(circuit)
        noise: Measures = {}
        if drawn_anew:
            from cosim.accuracy.noise_interval import noise_of

            noise = noise_of(done.measures, twin.plan, circuit, done.contacts, child)
        return {
            name: {**_with_error(name, row, nominal.get(name), twin, share), **noise.get(name, {})}
            if name not in _WITHOUT
            else dict(row)
            for name, row in done.measures.items()
        }

    return errors


def _other_sequence(contacts: tuple[int, ...], others: tuple[int, ...]) -> Caution:
    apart = next(
        (k for k, pair in enumerate(zip(contacts, others, strict=False)) if pair[0] != pair[1]),
        min(len(contacts), len(others)),
    )
    at = [f"sample {each[apart]}" if apart < len(each) else "none" for each in (contacts, others)]
    return Caution(
        "sequence-differs",
        f"in a closer run contact changes at other samples: change {apart + 1} of contact comes at {at[0]}, "
        f"there at {at[1]}; the bounds span both",
        "tighten the tolerances (--tol) until both agree, or take measures that do not depend on it",
    )


def doubt(circuit: LinearCircuit | None) -> float:
    """Return how far wrong a linear circuit may be, as a share: the worst that its certificate states."""
    certificate = circuit.certificate if circuit is not None else {}
    names = ("error", "measured_error", "fit_error", "control_nonlinearity", "not_through_multipliers")
    return max(
        (float(certificate[name]) for name in names if isinstance(certificate.get(name), int | float)),
        default=0.0,
    )


def _with_error(
    name: str, row: Mapping[str, Any], other: Mapping[str, Any] | None, twin: Twin, share: float
) -> dict[str, Any]:
    if other is None:
        return {**row, "error": None, "no_error": f"{twin.words} has no such measure"}
    value = float(row["value"])
    apart = abs(value - float(other["value"]))
    return {**row, "error": twin.margin * apart + (share + _RESOLVED) * abs(value)}
