"""The verdict on the stability of a scene's or a board's circuit, before anything runs."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from cosim import effects
from cosim.caution import Caution
from cosim.circuits.decks import SUPPLY_V
from cosim.circuits.design_constants import DesignConstants
from cosim.circuits.extraction import motor_response
from cosim.circuits.instability.stability_verdict import Question, Verdict, keep, known
from cosim.coupled import growing, hidden
from cosim.loop.setup import mechanism, operator, start
from cosim.ngspice.child import TIME_LIMIT_S, Child, call
from cosim.ngspice.deck import Deck, load_deck
from cosim.plan import Plan, swaps
from cosim.scene import Level, Method, PartFile, PythonOperator, Scene

__all__ = ["FINITE", "commanded", "coupled", "latched", "question", "verdict"]

#: Levels at which a board is judged: every amplifier has its bandwidth, the winding its inductance.
FINITE: Mapping[str, str] = {
    "opamp": "gbw", "vca": "gbw", "driver_level": "gbw", "motor": "full", "potentiometer": "ideal",
}  # fmt: skip
#: A device that moves slower [rad/s] is at rest: its differentiators are then at their operating point.
_REST_RAD_PER_S = 0.05
#: An output stands at its limit from this share of it, of the supply where its part states none; and is
#: latched there if the same pins do not ask for so much of it, this share of it less.
_AT_LIMIT, _AT_SUPPLY, _ASKED = 0.97, 0.6, 0.8
#: Decks made for verdicts in this process, by the plan's own: to flatten one takes longer than to look it up.
_decks: dict[tuple[str, ...], Deck] = {}
_MOST_DECKS = 32


def question(plan: Plan) -> Question:
    """Return what is to be judged before a plan may run.

    The board with amplifiers of finite bandwidth, whatever levels the scene asks for; with its differentiator
    as built; and beside it the deck of the run where that knows more of its parts.
    """
    scene = plan.scene
    device = scene.device
    vendors = {name: part for name, part in device.parts.items() if isinstance(part, PartFile)}
    levels = (scene.effects.opamp, scene.effects.vca, scene.effects.driver_level)
    boards = [_finite(plan, vendors=True)]
    if Level.FULL in levels:
        boards.append(plan.board)
    plain = _finite(plan, vendors=False) if vendors else None
    return Question(tuple(boards), plain, commanded(scene, plan.stated()))


def _finite(plan: Plan, *, vendors: bool) -> Deck:
    scene = plan.scene
    name = (plan.board.digest, str(plan.board.path), str(vendors), scene.effects.driver.value)
    if name not in _decks:
        if len(_decks) >= _MOST_DECKS:
            _decks.clear()
        parts = {k: v for k, v in swaps(scene).items() if vendors or isinstance(v, str)}
        _decks[name] = load_deck(
            scene.device.board,
            levels={**FINITE, "driver": scene.effects.driver.value},
            parts=parts,
            overrides=scene.device.values,
            temperature_c=effects.temperature_c(scene),
            trust=plan.trust,
        )
    return _decks[name]


def commanded(scene: Scene, constants: DesignConstants) -> dict[str, float]:
    """Return the voltages [V] at the gain pins in contact, about the pose of the start."""
    c = scene.computer
    if c.method is Method.DISCRETE or c.law is not None:
        return {}
    n = scene.joints
    square = np.zeros((n, n))
    if scene.wall is not None:
        linkage = mechanism(scene, constants.gear)
        w = linkage.jacobian(start(scene, linkage)[0]).T @ np.array(scene.wall.normal)
        square = np.outer(w, w)
    spring, damper = c.analog_stiffness_n_per_m * square, c.analog_damping_n_s_per_m * square
    if c.method is Method.JOINT_PD:
        spring, damper = spring * np.eye(n), damper * np.eye(n)
        if c.joint_stiffness_n_m_per_rad:
            spring = np.diag(c.joint_stiffness_n_m_per_rad)
    found = {}
    for kind, gain, scale in (("ksp", spring, constants.k_fs), ("ksd", damper, constants.c_fs)):
        for i in range(n):
            for j in range(n):
                volts = float(gain[i, j]) * constants.v_fs / scale
                found[f"{kind}{i + 1}{j + 1}"] = float(np.clip(volts, -constants.v_fs, constants.v_fs))
    return found


def verdict(
    asked: Question, path: Path, child: Child | None = None, time_limit_s: float = TIME_LIMIT_S
) -> Verdict:
    """Return the verdict: from the cache, or reached in ngspice's child process."""
    found = known(asked)
    if found is None:
        found = call(
            "cosim.circuits.instability.search:judge",
            {"question": asked},
            time_limit_s=time_limit_s,
            deck=str(path),
            child=child,
        )
        keep(asked, found)
    return found


def coupled(plan: Plan, child: Child | None = None) -> list[Caution]:
    """Say where board and linkage together grow within a step of the run, at no gain and as commanded."""
    scene, board = plan.scene, _finite(plan, vendors=True)
    constants = plan.stated()
    response = motor_response.known(board)
    if response is None:
        response = call(
            "cosim.circuits.extraction.motor_response:measure", {"board": board},
            time_limit_s=scene.solver.time_limit_s, deck=str(plan.board.path), child=child,
        )  # fmt: skip
        motor_response.keep(board, response)
    linkage = mechanism(scene, constants.gear)
    # a user's operator is loaded where it runs; without its mass the device is lighter, and faster to grow
    person = None if isinstance(scene.operator, PythonOperator) else operator(scene)
    mass = linkage.mass_matrix(start(scene, linkage)[0], person)
    viscosity = np.diag(linkage.pack()[0]["viscous"][: scene.joints])
    found: dict[Caution, None] = {}
    for volts in ({}, commanded(scene, constants)):
        poles = growing(response, volts, mass, viscosity, constants.torque_per_amp, constants.gear)
        found |= dict.fromkeys(hidden(poles, scene.solver.max_step_s))
    return list(found)


def latched(
    plan: Plan, end: Mapping[str, Any], limits: Mapping[str, float], child: Child | None = None
) -> list[Caution]:
    """Look at the end of a run on ngspice for outputs that hang at their limit without being driven there.

    An overdriven amplifier is at its limit because its inputs ask for more. A latched one is there although
    the same board with linear amplifiers, at the same pins, asks for less.

    Parameters
    ----------
    plan
        Of the run.
    end
        'nodes' and 'pins' [V] at the last point, and 'speed_rad_per_s' of the fastest joint.
    limits
        Node -> limit of the output [V], where a part states one.
    child
        The run's process.
    """
    stuck = {}
    for a in plan.board.amplifiers:
        limit = limits.get(a.out_node)
        volts = end["nodes"].get(a.out_node, 0.0)
        declared = any(f"{a.path}.".startswith(f"{block}.") for block in plan.board.declared)
        if not declared and abs(volts) >= (_AT_LIMIT * limit if limit else _AT_SUPPLY * SUPPLY_V):
            stuck[a.out_node] = (a.path, volts)
    if not stuck or end["speed_rad_per_s"] > _REST_RAD_PER_S:
        return []
    asked: list[float] = call(
        "cosim.circuits.instability.search:at_rest",
        {"board": _finite(plan, vendors=False), "pins": end["pins"], "nodes": list(stuck)},
        time_limit_s=plan.scene.solver.time_limit_s,
        deck=str(plan.board.path),
        child=child,
    )
    return [
        Caution(
            "output-latched",
            f"at the end of the run the output of {path} hangs at {volts:+.3g} V, where its inputs ask for "
            f"{wanted:+.3g} V",
            "look for positive feedback around it that begins once it clips",
        )
        for (path, volts), wanted in zip(stuck.values(), asked, strict=True)
        if wanted * np.sign(volts) < _ASKED * abs(volts)
    ]
