"""The interval of a noisy run's measures: how far 95 % of all paths of the noise lie from their mean.

A run shows one path. Means over the end of a run that rests in contact are linear in the noise, and its
exact covariance (`cosim.analysis.noise_of_means`) is carried to them by their tangents. Peaks, heat and rms
are not: they are taken of paths drawn with that covariance (`cosim.accuracy.noise_by_drawing`). What neither
carries gets no interval, and the reason instead.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from contextlib import suppress
from functools import cache, partial
from typing import Any

import numpy as np

from cosim.accuracy.noise_by_drawing import DRAWN, drawn_halves, require_one_gain
from cosim.accuracy.noise_paths import noisy
from cosim.analysis.control_law import law_point, resting_pose
from cosim.analysis.extracted import circuit_of
from cosim.analysis.held_contact import HeldContact
from cosim.analysis.noise_covariance import NoiseCovariance, moments_about
from cosim.analysis.noise_of_means import noise_of_means
from cosim.caution import collected
from cosim.circuits.linear_circuit import LinearCircuit
from cosim.effects.sampling import COMPUTER
from cosim.effects.sensing import SENSING
from cosim.errors import CosimError, InputError, fail
from cosim.measures import STEADY
from cosim.ngspice.child import Child
from cosim.plan import Plan, resolve
from cosim.runner import path_of
from cosim.scene import PotNoise
from cosim.types import Array, Measures

__all__ = ["noise_of"]

#: Of the normal distribution, for 95 % of it about its mean.
_NORMAL = 1.959963984540054
#: How far the mean depth of a run that rests may be from that at rest: a share, and standard deviations.
_AT_REST, _FAR = 0.05, 4.0
#: What the linear system may leave out: it moves the mean, or is far smaller than what noise does.
_SMALL = (
    "Coriolis forces, which are of second order about rest",
    "the potentiometers' errors over the angle",
    *(each.not_held for each in (*COMPUTER, *SENSING) if each.name in ("dac", "encoder")),
)
#: Outputs whose means are carried: depth, force of the motors along the normal, the operator's force (x, y).
_OUTPUTS = ("penetration", "motor_normal", "operator_force")
#: Those that are drawn of a run's last fifth; the others are of all contacts, and need to be of one.
_LATE = frozenset({"force_ripple"})
_NOT_AT_REST = "the run does not end at rest in contact: other seeds show how far noise moves it"
_NOT_FOLLOWED = "it is no output of the linear contact: other seeds show how far noise moves it"


def noise_of(
    measures: Measures, plan: Plan, circuit: LinearCircuit | None, contacts: tuple[int, ...],
    child: Child | None,
) -> dict[str, dict[str, Any]]:  # fmt: skip
    """Return what noise does to each measure of a run: 'noise', half of its 95 % interval, in its unit.

    Parameters
    ----------
    plan
        Of a model that is linear between events; its circuit is extracted where `circuit` is None.
    contacts
        Samples at which contact is made or lost.

    Returns
    -------
    dict
        By measure; 'noise' is None where it cannot be had, and 'no_noise' says why. Empty for a scene
        without noise.
    """
    if not noisy(plan.scene):
        return {}
    tangents = _tangents(measures, plan)
    followed = {*tangents, *DRAWN} & measures.keys()
    halves: dict[str, float] = {}
    why = {name: _NOT_AT_REST if name in followed else _NOT_FOLLOWED for name in measures}
    if tangents:
        try:
            at_rest, covariance = _at_rest(measures, plan, circuit, contacts, child)
        except InputError as error:
            why |= dict.fromkeys(followed, error.in_brief)
        else:
            for name, row in tangents.items():
                halves[name] = _NORMAL * math.sqrt(max(float(row @ covariance @ row), 0.0))
            side = abs(float(measures["steady_tangential_force"]["value"]))
            if side < _FAR / _NORMAL * halves["steady_tangential_force"]:
                halves.pop("tangential_ratio", None)
                why["tangential_ratio"] = "its size has a corner where the tangential force changes its sign"
            made, reasons = _drawn(plan, at_rest, contacts, child)
            halves |= made
            why |= reasons
    return {
        name: {"noise": halves[name]} if name in halves else {"noise": None, "no_noise": why[name]}
        for name in measures
    }


def _drawn(
    plan: Plan, at_rest: HeldContact, contacts: tuple[int, ...], child: Child | None
) -> tuple[dict[str, float], dict[str, str]]:
    """Return 'noise' of the measures of `DRAWN`, and why others of them have none."""
    scene = plan.scene
    effects = scene.effects.model_copy(update={"pot_noise": PotNoise.NONE})
    why = "the motors' currents come near their rating"
    here = cache(partial(moments_about, at_rest))

    def ahead() -> None:
        with suppress(CosimError):  # it is raised again where it matters
            here()

    try:
        with collected(forward=False):
            quiet = resolve(scene.model_copy(update={"effects": effects}), trust=plan.trust, board=plan.board)
            path, others = path_of(quiet, child, ahead)
        if not len(others) % 2:
            fail("without noise the computer sees no contact at the run's end")
        begin_s = others[-1] * scene.computer.period_s
        only_late = _only_late(path, others, contacts, at_rest, here(), begin_s)
        if only_late:
            require_one_gain(path, at_rest, here(), scene.duration_s * (1.0 - STEADY))
        made = drawn_halves(path, at_rest, begin_s)
    except CosimError as error:
        return {}, dict.fromkeys(DRAWN, error.in_brief)
    kept = _LATE if only_late else made.keys()
    return {name: made[name] for name in made if name in kept}, dict.fromkeys(DRAWN, only_late or why)


def _only_late(
    path: Mapping[str, Array], others: tuple[int, ...], contacts: tuple[int, ...], at_rest: HeldContact,
    here: NoiseCovariance, begin_s: float,
) -> str:  # fmt: skip
    """Return why only the run's last fifth may be drawn; nothing where all of the contact may."""
    if len(contacts) > 1:
        return "contact is lost and made again, which a linear contact does not know"
    if others != contacts:
        return "without noise contact is made at another sample"
    try:
        require_one_gain(path, at_rest, here, begin_s)
    except InputError as error:
        return error.in_brief
    return ""


def _tangents(measures: Measures, plan: Plan) -> dict[str, Array]:
    """Return the slopes of measures by the means of `_OUTPUTS`, [4] each; of those that are such means."""
    if "steady_penetration" not in measures:
        return {}
    assert plan.scene.wall is not None
    nx, ny = plan.scene.wall.normal
    sink, push = np.eye(4)[:2]
    normal, tangent = -np.array([0.0, 0.0, nx, ny]), -np.array([0.0, 0.0, ny, -nx])
    at = {name: float(row["value"]) for name, row in measures.items()}
    out = {"steady_penetration": sink, "steady_normal_force": normal, "steady_tangential_force": tangent}
    out["rendered_stiffness"] = (push - at["rendered_stiffness"] * sink) / at["steady_penetration"]
    if "tangential_ratio" in measures:
        ratio = at["steady_tangential_force"] / at["steady_normal_force"]
        out["tangential_ratio"] = (tangent - ratio * normal) / at["steady_normal_force"]
    return {name: row for name, row in out.items() if name in measures}


def _at_rest(
    measures: Measures, plan: Plan, circuit: LinearCircuit | None, contacts: tuple[int, ...],
    child: Child | None,
) -> tuple[HeldContact, Array]:  # fmt: skip
    """Return the contact at rest, and the covariance [4, 4] of the means of `_OUTPUTS` over the run's end."""
    scene = plan.scene
    if scene.effects.component_noise:
        fail("the components' noise is not carried to measures", key="effects.component_noise")
    if not len(contacts) % 2:
        fail("the computer sees no contact at the run's end")
    if circuit is None:
        if plan.model == "spice":
            fail("only `spice` carries this scene, and no linear circuit its noise", key="solver.model")
        circuit, constants = circuit_of(plan, reduced=True, child=child)
    else:
        constants = plan.stated(child).constants()
    contact = HeldContact.at_wall(scene, constants, circuit)
    at_rest = contact.at(resting_pose(contact))
    depth = law_point(scene, constants, at_rest.linkage, at_rest.q).penetration_m
    span = STEADY * scene.duration_s
    since = scene.duration_s - span - contacts[-1] * scene.computer.period_s
    made = noise_of_means(at_rest, _OUTPUTS, max(since, 0.0), span)
    if left := [note for note in made.notes if note not in _SMALL]:
        fail("a linear contact leaves out " + "; ".join(left))
    mean = float(measures["steady_penetration"]["value"])
    if not abs(mean - depth) <= _AT_REST * depth + _FAR * math.sqrt(made.covariance[0, 0]):
        deep = f"{1e3 * mean:.3g} mm deep, {1e3 * depth:.3g} mm at rest"
        fail(f"the run does not rest in its last fifth: {deep}")
    return at_rest, made.covariance
