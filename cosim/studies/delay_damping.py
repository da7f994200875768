"""Footnote 1, the headline: the share of the device's damping that the circuit's delay takes, block by block.

A spring of stiffness k that acts late by tau adds the damping -k tau. With the device's viscosity b the share
taken is eta = k sum(tau)/b; at eta = 1 nothing is left and the spring alone is active.
"""

from __future__ import annotations

from functools import partial
from typing import Annotated, Any

import numpy as np
from scipy.optimize import brentq

from cosim.analysis.device_passivity import device_of
from cosim.analysis.passivity import least_damping
from cosim.analysis.stability import border, held
from cosim.analysis.tip import Tip, reached, row, tip_of
from cosim.circuits.extraction.block_delays import SpringDelay, slowest, spring_delays
from cosim.ngspice.child import Child, on_demand
from cosim.plan import resolve
from cosim.scene import Method
from cosim.scene.parameters import Field, Parameters, Unit, Variation
from cosim.scene.quantities import Stiffness
from cosim.storage.checkpoint import Points
from cosim.studies import table_columns as col
from cosim.studies.study import Study, StudyFile, StudyResult, Table, Verdict

__all__ = ["STUDY", "EtaParameters", "active_from", "block_delays", "unstable_from"]


#: What the cases of this study hold, for its page.
HOLDS = (
    "Every case holds what its scene states (parts with finite bandwidth, the winding's inductance; no "
    "offset, slew, noise or friction of the joints), changed as its name says."
)


class EtaParameters(Parameters):
    """``[parameters]`` of the headline; the first case is drawn block by block."""

    cases: tuple[Variation, ...] = Field(default=(Variation(name="as built"),), min_length=1)
    stiffness_n_per_m: Stiffness = 100.0
    largest_eta: Annotated[float, Field(gt=0, le=1)] = 0.05
    points: int = Field(default=41, ge=3, le=401)
    margin_rad: Annotated[float, Field(gt=0, lt=1.5), Unit("rad")] = 0.15


def block_delays(paths: list[SpringDelay]) -> dict[str, float]:
    """Return the delay of every kind of block [s], of the path through which it is largest."""
    names = dict.fromkeys(step.block for path in paths for step in path.steps)
    return {name: max(path.of(name) for path in paths) for name in names}


def with_spring(tip: Tip, stiffness: float) -> Tip:
    """Return the tip at an analog wall alone."""
    return tip.with_computer(
        method=Method.CONTINUOUS, analog_stiffness_n_per_m=stiffness,
        analog_damping_n_s_per_m=0.0, discrete_stiffness_n_per_m=0.0, discrete_damping_n_s_per_m=0.0,
    )  # fmt: skip


def active_from(tip: Tip, low: float = 1.0, high: float = 1e9) -> float:
    """Return the analog stiffness at which the device's damping reaches zero at some frequency [N/m].

    Searched over all frequencies on the fitted circuit, independently of delays and blocks.
    """

    def left(k: float) -> float:
        return least_damping(device_of(with_spring(tip, k)), lowest=1.0)[0]

    if left(high) > 0.0:
        return float("inf")
    return float(np.exp(brentq(lambda x: left(float(np.exp(x))), np.log(low), np.log(high), rtol=1e-10)))


def unstable_from(tip: Tip, low: float = 10.0, high: float = 1e8) -> float:
    """Return the analog stiffness at which the scene with its operator loses stability [N/m]."""
    return border(lambda k: held(with_spring(tip, k)), low, high, rtol=1e-9).value


def analyse(spec: StudyFile, points: Points) -> StudyResult:
    """Measure the blocks' delays in every case and hold them against the device's viscosity."""
    given: EtaParameters = spec.parameters
    columns: dict[str, list[Any]] = {}
    limits: dict[str, list[Any]] = {}
    points.expect(len(given.cases))
    every: list[dict[str, Any]] = []
    with on_demand() as child:
        for number, case in enumerate(given.cases):
            every.append(points.get(case.name, partial(_case, spec, case, number == 0, child)))
    first = every[0]
    spread: dict[str, list[float]] = first["workspace"]
    for case, answer in zip(given.cases, every, strict=True):
        for name, late in answer["blocks"].items():
            row(columns, {
                "case": case.name, "block": name, col.DELAY: 1e6 * late,
                f"eta at {given.stiffness_n_per_m:g} N/m [%]":
                    100.0 * given.stiffness_n_per_m * late / answer["b"],
                col.LIMIT_BY_TAU: answer["b"] / late if late > 1e-15 else None,
            })  # fmt: skip
        total, b = answer["total"], answer["b"]
        row(limits, {
            "case": case.name, col.SUM_OF_DELAYS: 1e6 * total, col.VISCOSITY_AT_THE_WALL: b,
            f"eta at {given.stiffness_n_per_m:g} N/m [%]": 100.0 * given.stiffness_n_per_m * total / b,
            col.LIMIT_BY_SUM: b / total if total > 0.0 else None,
            "where the spring turns active [N/m]": answer["active"],
            "where it loses stability with its operator [N/m]": answer["unstable"],
        })  # fmt: skip
    b_all = np.array(spread[col.VISCOSITY_B])
    band: dict[str, Any] = {
        col.SHARE_OF_VISCOSITY: ["least", "5 %", "median", "95 %", "most"],
        col.VISCOSITY_B: np.quantile(b_all, [0.0, 0.05, 0.5, 0.95, 1.0]).tolist(),
    }
    limit = [value / first["total"] if first["total"] > 0.0 else None for value in band[col.VISCOSITY_B]]
    eta = given.stiffness_n_per_m * first["total"] / first["b"]
    slowest = max(first["blocks"], key=lambda name: first["blocks"][name])
    fast = first["total"] - first["blocks"][slowest]
    share = 100.0 * np.mean(eta * first["b"] / b_all > given.largest_eta)
    text = (
        f"{100 * eta:.3g} % at {given.stiffness_n_per_m:g} N/m ({slowest}: "
        f"{100 * first['blocks'][slowest] / first['total']:.3g} % of the delay; all other blocks eat "
        f"{100 * given.stiffness_n_per_m * fast / first['b']:.2g} %); practical limit "
        f"{first['b'] / first['total']:.4g} N/m. Over poses the limit begins at {limit[0]:.4g} N/m; "
        f"eta is above {100 * given.largest_eta:g} % in {share:.2g} % of them"
    )
    off = abs(first["active"] * first["total"] / first["b"] - 1.0) if first["active"] else float("inf")
    return spec.result(
        Table("blocks", "Delay block by block", columns,
              "From the netlist by ngspice at low frequency; the slowest path of every block."),
        Table("limits", "Variation by case", limits, HOLDS),
        Table("viscosity", "The device's viscosity along the normal over its poses",
              {**band, "practical limit [N/m]": limit}),
        Table("workspace", "The device's viscosity over the workspace", spread),
        verdicts=(
            Verdict("N1a", "delay eats a small share of the device's damping",
                    f"eta, stiffness times delay over viscosity, below {100 * given.largest_eta:g} %", text,
                    bool(eta < given.largest_eta)),
            Verdict("N1a", "the practical limit, viscosity over delay: there the analog spring turns active",
                    "the same from the fitted circuit over all frequencies, within 1 %",
                    f"{first['active']:.5g} N/m, off by {100 * off:.2g} %", bool(off < 0.01), own=True),
        ),
    )  # fmt: skip


def _case(spec: StudyFile, case: Variation, with_poses: bool, child: Child) -> dict[str, Any]:
    given: EtaParameters = spec.parameters
    scene = spec.scene("solver.model=linear", *case.set)
    paths = spring_delays(resolve(scene).board, child, time_limit_s=scene.solver.time_limit_s)
    tip = tip_of(scene, child)
    b = tip.viscosity()
    active, unstable = active_from(tip), unstable_from(tip)
    spread: dict[str, list[float]] = {col.X: [], col.Y: [], col.VISCOSITY_B: []}
    for there in reached(tip, given.points, given.margin_rad) if with_poses else ():
        place = _place(there)
        for column, value in zip(spread.values(), (*place, there.viscosity()), strict=True):
            column.append(float(value))
    return {
        "blocks": block_delays(paths), "total": slowest(paths).total_s, "b": b,
        "active": active if np.isfinite(active) else None,
        "unstable": unstable if np.isfinite(unstable) else None, "workspace": spread,
    }  # fmt: skip


def _place(tip: Tip) -> tuple[float, float]:
    from cosim.scene.mechanism import mechanism

    x, y = mechanism(tip.scene, tip.constants.gear).forward(tip.q)
    return float(x), float(y)


STUDY = Study("eta", "footnote 1: damping that the circuit's delay eats", EtaParameters, analyse)
