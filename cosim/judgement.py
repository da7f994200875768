"""The verdict on the stability of a scene's or a board's circuit, before anything runs."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from cosim import effects
from cosim.circuits.port import DesignConstants
from cosim.circuits.stability_verdict import Question, Verdict, keep, known
from cosim.loop.setup import mechanism, start
from cosim.ngspice.child import Child, call
from cosim.ngspice.deck import Deck, load_deck
from cosim.plan import Plan, swaps
from cosim.scene import Level, Method, PartFile, Scene

__all__ = ["FINITE", "commanded", "question", "verdict"]

#: Levels at which a board is judged: every amplifier has its bandwidth, the winding its inductance.
FINITE: Mapping[str, str] = {
    "opamp": "gbw", "vca": "gbw", "driver_level": "gbw", "motor": "full", "potentiometer": "ideal",
}  # fmt: skip
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


def verdict(asked: Question, path: Path, child: Child | None = None, time_limit_s: float = 300.0) -> Verdict:
    """Return the verdict: from the cache, or reached in ngspice's child process."""
    found = known(asked)
    if found is None:
        found = call(
            "cosim.circuits.instability:judge",
            {"question": asked},
            time_limit_s=time_limit_s,
            deck=str(path),
            child=child,
        )
        keep(asked, found)
    return found
