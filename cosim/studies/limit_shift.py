"""Footnote 1: by how much each of the circuit's imperfections moves the largest stiffness of a sampled wall.

Exact borders, with the full circuit and without one part of it at a time. Noise moves no border of a linear
system; in the experiment it keeps the mass from ever counting as at rest.
"""

from __future__ import annotations

import math
from functools import partial
from typing import Annotated, Any

import numpy as np

from cosim.analysis.linearise import Output, linearise
from cosim.analysis.noise_covariance import covariance
from cosim.analysis.noise_period import noise_grid
from cosim.analysis.period_map import lift
from cosim.analysis.stability import border, held
from cosim.analysis.tip import Tip, row, tip_of
from cosim.errors import fail
from cosim.ngspice.child import Child, on_demand
from cosim.scene import Method, PotNoise
from cosim.scene.parameters import Field, Parameters, Unit, Variation
from cosim.scene.quantities import Damping, Period, Stiffness
from cosim.storage.checkpoint import Points
from cosim.studies import table_columns as col
from cosim.studies.case_effects import holds_table
from cosim.studies.grid import milli
from cosim.studies.study import Study, StudyFile, StudyResult, Table, Verdict

__all__ = ["STUDY", "Gains", "ShiftParameters", "largest", "speed_rms"]


#: Scanned around the passive limit 2 b/T of an ideal circuit.
_SPAN = (0.02, 50.0)
#: Share of the border at which noise is looked at.
_LOOKS = (0.1, 0.5, 0.9)


class Gains(Parameters):
    """``[[parameters.gains]]``: what the circuit displays beside the computer."""

    name: str = Field(min_length=1)
    stiffness_n_per_m: Stiffness = 0.0
    damping_n_s_per_m: Damping = 0.0


class ShiftParameters(Parameters):
    """``[parameters]``: the first case is the board with everything, the others leave something out."""

    cases: tuple[Variation, ...] = Field(min_length=2)
    gains: tuple[Gains, ...] = Field(min_length=1)
    periods_s: tuple[Period, ...] = Field(default=(0.003, 0.01, 0.025, 0.1), min_length=1)
    rest_speed_m_per_s: Annotated[float, Field(gt=0, le=1), Unit("m/s")] = 1e-3
    sigmas: float = Field(default=3.0, gt=0, le=10)


def _with(tip: Tip, gains: Gains, period: float, stiffness: float) -> Tip:
    analog = gains.stiffness_n_per_m > 0.0 or gains.damping_n_s_per_m > 0.0
    return tip.with_computer(
        method=Method.COMBINED if analog else Method.DISCRETE, period_s=period,
        analog_stiffness_n_per_m=gains.stiffness_n_per_m, analog_damping_n_s_per_m=gains.damping_n_s_per_m,
        discrete_stiffness_n_per_m=stiffness, discrete_damping_n_s_per_m=0.0,
    )  # fmt: skip


def largest(tip: Tip, gains: Gains, period: float) -> float:
    """Return the exact largest discrete stiffness [N/m], contact held."""
    rough = 2.0 * (tip.viscosity() + gains.damping_n_s_per_m) / period
    return border(
        lambda k: held(_with(tip, gains, period, k)),
        _SPAN[0] * rough, _SPAN[1] * rough, rtol=1e-9,
    ).value  # fmt: skip


def speed_rms(tip: Tip, gains: Gains, period: float, stiffness: float, kind: PotNoise) -> float:
    """Return the tip's rms speed in a held contact under its potentiometer's noise [m/s]."""
    scene = _with(tip, gains, period, stiffness).scene
    scene = scene.model_copy(update={"effects": scene.effects.model_copy(update={"pot_noise": kind})})
    contact = tip.of_scene(scene)
    system = linearise(contact, preload=False)
    n = system.joints
    rows = np.zeros((2, len(system.a)))
    rows[:, n : 2 * n] = contact.linkage.jacobian(contact.q)
    nothing = np.zeros((2, system.b.shape[1])), np.zeros((2, n))
    system.outputs["tip_speed"] = Output(rows, *nothing, "m/s")
    return covariance(lift(system, noise=True), noise_grid(scene), kind.value).rms("tip_speed")


def _case(spec: StudyFile, case: Variation, noisy: bool, child: Child) -> dict[str, Any]:
    given: ShiftParameters = spec.parameters
    tip = tip_of(spec.scene("solver.model=linear", *case.set), child)
    if not tip.scene.is_slider:
        fail("the experiment is that of one joint", file=str(spec.scene_file), key="device.linkage")
    limits, speeds = [], []
    for gains in given.gains:
        for period in given.periods_s:
            k = largest(tip, gains, period)
            limits.append(k if math.isfinite(k) else None)
            analog = gains.stiffness_n_per_m > 0.0 or gains.damping_n_s_per_m > 0.0
            heard = noisy and analog and math.isfinite(k)  # the computer has encoders
            for kind in (PotNoise.WHITE, PotNoise.PEAK_TO_PEAK) if heard else ():
                for share in _LOOKS:
                    v = speed_rms(tip, gains, period, share * k, kind)
                    speeds.append([gains.name, period, kind.value, share, share * k, v])
    return {"limits": limits, "speeds": speeds}


def analyse(spec: StudyFile, points: Points) -> StudyResult:
    """Find the borders of every case, and what noise does at rest."""
    given: ShiftParameters = spec.parameters
    points.expect(len(given.cases))
    with on_demand() as child:
        every = [
            points.get(case.name, partial(_case, spec, case, number == 0, child))
            for number, case in enumerate(given.cases)
        ]
    columns: dict[str, list[Any]] = {}
    rest: dict[str, list[Any]] = {}
    worst: dict[str, float] = {}
    number = 0
    for gains in given.gains:
        for period in given.periods_s:
            k = [answer["limits"][number] for answer in every]
            number += 1
            moved = {
                f"{case.name} [%]": 100.0 * (value / k[0] - 1.0) if value and k[0] else None
                for case, value in zip(given.cases[1:], k[1:], strict=True)
            }
            for name, value in moved.items():
                worst[name] = max(worst.get(name, 0.0), abs(value or 0.0), key=abs)
            row(columns, {
                "gains": gains.name, col.SAMPLING_PERIOD: milli(period),
                f"k_max, {given.cases[0].name} [N/m]": k[0],
                **moved,
            })  # fmt: skip
    for name, period, kind, share, k0, speed in every[0]["speeds"]:
        row(rest, {
            "gains": name, col.SAMPLING_PERIOD: milli(period), "noise": kind, "share of k_max": share,
            col.STIFFNESS_K: k0,
            "speed, rms [mm/s]": 1e3 * speed,
            f"counts as rest ({given.sigmas:g} sigma)": bool(given.sigmas * speed < given.rest_speed_m_per_s),
        })  # fmt: skip
    text = "; ".join(f"{name.removesuffix(' [%]')} {value:.2g} %" for name, value in worst.items())
    speeds = {
        kind: [1e3 * v for _, _, its, share, _, v in every[0]["speeds"] if its == kind and share == _LOOKS[1]]
        for kind in (PotNoise.WHITE.value, PotNoise.PEAK_TO_PEAK.value)
    }
    shown = [f"{k} {min(v):.2g} to {max(v):.2g} mm/s rms" for k, v in speeds.items() if v]
    noise = (
        f"no border moves, but at half of it noise keeps the mass at {'; '.join(shown)}: rest is "
        f"|v| < {1e3 * given.rest_speed_m_per_s:g} mm/s"
        if shown else "no analog gains, no noise"
    )  # fmt: skip
    return spec.result(
        Table("limits", "Largest discrete stiffness, and by how much it moves without a part of the circuit",
              columns, "Exact borders, contact held."),
        Table("rest", "At rest in contact under the potentiometer's noise", rest),
        holds_table(
            spec, given.cases,
            "Every case is looked at with the analog gains and periods of the tables; the borders hold no "
            "noise, the speeds at rest one kind of potentiometer noise each.",
        ),
        verdicts=(
            Verdict("N1", "shift of the largest stiffness without each part of the circuit", "a question",
                    f"at most: {text}", None),
            Verdict("N1", "shift of the largest stiffness by the potentiometer's noise", "a question",
                    noise, None),
        ),
    )  # fmt: skip


STUDY = Study("shift", "footnote 1: shift of the largest stiffness", ShiftParameters, analyse)
