"""The verdict on the stability of a scene's or a board's circuit, before anything runs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from cosim import effects
from cosim.caution import Caution, collected
from cosim.circuits.decks import AT_LIMIT, AT_SUPPLY, REST_RAD_PER_S, SUPPLY_V
from cosim.circuits.extraction import motor_response
from cosim.circuits.extraction.motor_response import MotorResponse
from cosim.circuits.instability.stability_verdict import Question, Verdict, keep, known
from cosim.coupled_poles import growing, hidden
from cosim.errors import CosimError
from cosim.ngspice.child import TIME_LIMIT_S, Child, call
from cosim.ngspice.deck import Deck, load_deck
from cosim.plan import Plan, swaps
from cosim.pose_matrices import at_poses, at_start
from cosim.scene import Level, PartFile
from cosim.types import Array
from cosim.units import quantity, signed

__all__ = ["FINITE", "answer_of", "bent", "coupled", "latched", "left", "question", "reached", "verdict"]


#: Levels at which a board is judged: every amplifier has its bandwidth, the winding its inductance.
FINITE: Mapping[str, str] = {
    "opamp": "gbw", "vca": "gbw", "driver_level": "gbw", "motor": "full", "potentiometer": "ideal",
}  # fmt: skip
#: An output is latched if it is at its limit while a linear board at the same pins would be this share below;
#: it has left its operating point if it is this share of the supply away: a settled device is much nearer.
_ASKED, _OFF_POINT = 0.8, 0.2
#: Poses this near to one another [rad] have the same inertia and gains, within a tenth.
_SAME_RAD = 0.1
#: Decks for verdicts by the plan's own deck: flattening one takes longer than looking it up.
_decks: dict[tuple[str, ...], Deck] = {}
_MOST_DECKS = 32


def question(plan: Plan) -> Question:
    """Return what is judged before a plan may run.

    The board with amplifiers of finite bandwidth whatever levels the scene asks for, and its differentiator
    as built; also the deck of the run where that models its parts in more detail.
    """
    scene = plan.scene
    device = scene.device
    vendors = {name: part for name, part in device.parts.items() if isinstance(part, PartFile)}
    levels = (scene.effects.opamp, scene.effects.vca, scene.effects.driver_level)
    boards = [_finite(plan, vendors=True)]
    if Level.FULL in levels:
        boards.append(plan.board)
    plain = _finite(plan, vendors=False) if vendors else None
    return Question(tuple(boards), plain, _gain_volts(plan))


def _finite(plan: Plan, *, vendors: bool) -> Deck:
    scene = plan.scene
    name = (plan.board.digest, str(plan.board.path), str(vendors), scene.effects.driver.value)
    if name not in _decks:
        if len(_decks) >= _MOST_DECKS:
            _decks.clear()
        parts = {k: v for k, v in swaps(scene).items() if vendors or isinstance(v, str)}
        with collected(forward=False):  # the plan's own deck has told what is odd; here its effects are off
            _decks[name] = load_deck(
                scene.device.board,
                levels={**FINITE, "driver": scene.effects.driver.value},
                parts=parts,
                overrides=scene.device.values,
                temperature_c=effects.temperature_c(scene),
                trust=plan.trust,
            )
    return _decks[name]


def _gain_volts(plan: Plan) -> dict[str, float]:
    """Return the voltages [V] at the gain pins in contact, about the start."""
    constants = plan.stated()
    return at_start(plan.scene, constants.gear).gain_volts(plan.scene, constants)


def verdict(
    asked: Question, path: Path, child: Child | None = None, time_limit_s: float = TIME_LIMIT_S
) -> Verdict:
    """Return the verdict: from the cache, or reached in ngspice's child process."""
    answer = known(asked)
    if answer is None:
        answer = call(
            "cosim.circuits.instability.search:judge",
            {"question": asked},
            time_limit_s=time_limit_s,
            deck=str(path),
            child=child,
        )
        keep(asked, answer)
    return answer


def coupled(plan: Plan, child: Child | None = None, poses: Sequence[Array] = ()) -> list[Caution]:
    """Say where board and linkage together grow within a step of the run, at no gain and as commanded.

    About the start, or about `poses` ([n] rad each) that a run has reached; the first bad one is reported.
    """
    scene, response = plan.scene, answer_of(plan, child)
    constants = plan.stated()
    reached = at_poses(scene, constants.gear, poses, child) if poses else [at_start(scene, constants.gear)]
    cautions: dict[Caution, None] = {}
    for pose in reached:
        where = f" at the angles {', '.join(f'{q:.3g}' for q in pose.q)} rad" if poses else ""
        for volts in ({}, pose.gain_volts(scene, constants)):
            poles = growing(
                response,
                volts,
                pose.mass,
                pose.viscosity,
                constants.torques_per_amp(scene.joints),
                constants.gear,
            )
            cautions |= dict.fromkeys(hidden(poles, scene.solver.max_step_s, where))
        if cautions:
            break
    return list(cautions)


def answer_of(plan: Plan, child: Child | None = None) -> MotorResponse:
    """Return what the motors of a plan's board answer at `FINITE` levels: kept, or measured in the child."""
    board = _finite(plan, vendors=True)
    response = motor_response.known(board)
    if response is None:
        response = call(
            "cosim.circuits.extraction.motor_response:measure", {"board": board},
            time_limit_s=plan.scene.solver.time_limit_s, deck=str(plan.board.path), child=child,
        )  # fmt: skip
        motor_response.keep(board, response)
    return response


def bent(plan: Plan, child: Child | None = None) -> float:
    """Return how far that board leaves its slope at rest, as `large_signal_error`; 0 where unknown."""
    try:
        error: float = call(
            "cosim.circuits.extraction.large_signal:measure", {"board": _finite(plan, vendors=True)},
            time_limit_s=plan.scene.solver.time_limit_s, deck=str(plan.board.path), child=child,
        )  # fmt: skip
    except CosimError:  # it only takes a warning back
        return 0.0
    return error


def reached(plan: Plan, q: Array) -> list[Array]:
    """Return the poses [n] of a run's angles `q` [points, n] that differ most: its extremes and its end.

    Without those that are nearly the start's (`_SAME_RAD`), which was judged before the run.
    """
    rows = [*np.argmin(q, axis=0), *np.argmax(q, axis=0), len(q) - 1]
    poses: list[Array] = [at_start(plan.scene, plan.stated().gear).q]
    for row in rows:
        if min(float(np.abs(q[row] - pose).max()) for pose in poses) > _SAME_RAD:
            poses.append(q[row])
    return poses[1:]


def latched(
    plan: Plan, end: Mapping[str, Any], limits: Mapping[str, float], child: Child | None = None
) -> list[Caution]:
    """Look at a run on ngspice for outputs that hung at their limit without being driven there.

    An overdriven amplifier is at its limit because its inputs ask for more. A latched one is there although
    the same board with linear amplifiers, at the same pins, asks for less.

    Parameters
    ----------
    plan
        Of the run.
    end
        'nodes' and 'pins' [V] at the last point, 'speed_rad_per_s' of the fastest joint, and 'hung': what the
        watch within the run has noted.
    limits
        Node -> limit of the output [V], where a part states one.
    child
        The run's process.
    """
    paths = _undeclared(plan)
    cautions = []
    for each in end.get("hung", ()):
        stuck = {each["node"]: each["volts"]} if each["node"] in paths else {}
        when = f"from {quantity(each['since_s'], 's', 4)} on"
        cautions += _unasked(plan, stuck, each["pins"], when, paths, child)
    known = {node for node, _ in cautions}
    stuck = {}
    if end["speed_rad_per_s"] <= REST_RAD_PER_S:
        for node in paths.keys() - known:
            limit, volts = limits.get(node), end["nodes"].get(node, 0.0)
            if abs(volts) >= (AT_LIMIT * limit if limit else AT_SUPPLY * SUPPLY_V):
                stuck[node] = volts
    cautions += _unasked(plan, stuck, end["pins"], "at the end of the run", paths, child)
    return [caution for _, caution in cautions]


def left(plan: Plan, end: Mapping[str, Any]) -> list[Caution]:
    """Say which outputs of a device at rest are far from the operating point of their own circuit.

    The equations have more than one solution, or the circuit leaves the one it started from.
    """
    point = end.get("operating_point", {})
    return [
        Caution(
            "operating-point-left",
            f"at the end of the run, with the device at rest, the output of {path} stands at "
            f"{signed(end['nodes'][node], 'V')}, the operating point of the circuit is "
            f"{signed(point[node], 'V')}",
            "look for positive feedback around it; declare it (stability=bistable) where it is meant",
        )
        for node, path in _undeclared(plan).items()
        if node in point and abs(end["nodes"][node] - point[node]) > _OFF_POINT * SUPPLY_V
    ]


def _undeclared(plan: Plan) -> dict[str, str]:
    """Return output node -> path of the amplifiers outside blocks that the netlist declares bistable."""
    return {
        a.out_node: a.path
        for a in plan.board.amplifiers
        if not any(f"{a.path}.".startswith(f"{block}.") for block in plan.board.declared)
    }


def _unasked(
    plan: Plan,
    stuck: Mapping[str, float],
    pins: Mapping[str, float],
    when: str,
    paths: Mapping[str, str],
    child: Child | None,
) -> list[tuple[str, Caution]]:
    """Return those of the outputs (node -> volts) for which linear amplifiers at these pins ask less."""
    if not stuck:
        return []
    asked: list[float] = call(
        "cosim.circuits.instability.search:at_rest",
        {"board": _finite(plan, vendors=False), "pins": dict(pins), "nodes": list(stuck)},
        time_limit_s=plan.scene.solver.time_limit_s,
        deck=str(plan.board.path),
        child=child,
    )
    return [
        (
            node,
            Caution(
                "output-latched",
                f"{when} the output of {paths[node]} hangs at {signed(volts, 'V')}, where its inputs ask for "
                f"{signed(wanted, 'V')}",
                "look for positive feedback around it that begins once it clips",
            ),
        )
        for (node, volts), wanted in zip(stuck.items(), asked, strict=True)
        if wanted * np.sign(volts) < _ASKED * abs(volts)
    ]
