"""The corner of the differentiator: noise against passive stiffness, one curve for each kind of noise.

A higher corner lets more potentiometer noise through the damper, and keeps it damping up to higher
frequencies, so that a stiffer sampled wall is passive.
"""

from __future__ import annotations

import math
from dataclasses import replace
from functools import partial
from typing import Annotated, Any

import numpy as np

from cosim.analysis.device_passivity import device_of, law_of
from cosim.analysis.linearise import linearise
from cosim.analysis.noise_covariance import covariance
from cosim.analysis.noise_period import noise_grid
from cosim.analysis.passivity import least_damping, share_used
from cosim.analysis.period_map import lift
from cosim.analysis.stability import border, held
from cosim.analysis.tip import Tip, row, tip_of
from cosim.analysis.tip_noise import position_density, pot_density, pot_form
from cosim.circuits.extraction.alter import nominal_value
from cosim.circuits.linear_circuit import LinearCircuit
from cosim.errors import CosimError, InputError, fail
from cosim.ngspice.child import Child, call, start_early
from cosim.plan import resolve
from cosim.scene import Method, PotNoise
from cosim.scene.parameters import Field, Parameters, Unit, Variation
from cosim.scene.quantities import Damping, Frequency, Stiffness
from cosim.storage.checkpoint import Points
from cosim.studies import table_columns as col
from cosim.studies.case_effects import holds_table
from cosim.studies.study import Study, StudyFile, StudyResult, Table, Verdict

__all__ = ["STUDY", "CornerParameters", "passive"]


_LOOKS = 48


class CornerParameters(Parameters):
    """``[parameters]``: gains of the circuit, the sampling period is the scene's."""

    corner_parameter: str = "r_der_in"
    corner_capacitor: str = "c_der_in"
    corners_hz: tuple[Frequency, ...] = Field(default=(10.0, 100.0, 1000.0), min_length=2)
    stiffness_n_per_m: Stiffness = 0.0
    damping_n_s_per_m: Damping = 2.0
    speed_m_per_s: Annotated[float, Field(gt=0, le=10), Unit("m/s")] = 0.1
    discrete_n_per_m: Annotated[float, Field(gt=0, le=1e6), Unit("N/m")] = 50.0
    largest_noise_n: Annotated[float, Field(gt=0, lt=100), Unit("N")] = 0.05


def _held(tip: Tip, given: CornerParameters, stiffness: float) -> Tip:
    return tip.with_computer(
        method=Method.COMBINED, analog_stiffness_n_per_m=given.stiffness_n_per_m,
        analog_damping_n_s_per_m=given.damping_n_s_per_m, discrete_stiffness_n_per_m=stiffness,
        discrete_damping_n_s_per_m=0.0,
    )  # fmt: skip


def passive(tip: Tip, given: CornerParameters) -> float | None:
    """Return the largest passive discrete stiffness beside the analog gains [N/m].

    None where the analog part alone is active: its damping is negative at some frequency.
    """
    contact = _held(tip, given, 1.0)
    device = device_of(contact)
    if not least_damping(device, lowest=1.0)[0] > 0.0:
        return None
    used = share_used(law_of(contact.scene), device, points=_LOOKS).value
    return 1.0 / used if used > 0.0 and math.isfinite(used) else 0.0


def _looked_at(tip: Tip, given: CornerParameters) -> dict[str, Any]:
    k, c = given.stiffness_n_per_m, given.damping_n_s_per_m
    lever = float(np.linalg.norm(tip.motion)) / math.sqrt(tip.circuit.joints)  # rad/m, of a joint
    densities = {
        PotNoise.WHITE.value: pot_density(tip.scene, PotNoise.WHITE),
        PotNoise.PEAK_TO_PEAK.value: pot_density(tip.scene, PotNoise.PEAK_TO_PEAK),
        PotNoise.POSITION.value: position_density(tip.scene, given.speed_m_per_s * lever),
    }
    noise = {name: float(pot_form(tip, d).rms(k, c)) for name, d in densities.items() if d is not None}
    # an offset passes through the spring alone, constantly
    noise[PotNoise.STATIC.value] = k * tip.scene.device.potentiometer.noise_rad * float(
        np.linalg.norm(tip.torques)
    )  # fmt: skip
    limit = border(lambda value: held(_held(tip, given, value)), 0.5, 1e5, rtol=1e-9).value
    return {
        "noise": noise, "passive": passive(tip, given), "border": limit if math.isfinite(limit) else None,
        "closed": _closed(tip, given),
    }  # fmt: skip


def _closed(tip: Tip, given: CornerParameters) -> float | None:
    """Return the rms force on the normal of the held contact under white noise; None where it is unstable."""
    contact = _held(tip, given, given.discrete_n_per_m)
    scene = contact.scene
    effects = scene.effects.model_copy(update={"pot_noise": PotNoise.WHITE})
    scene = scene.model_copy(update={"effects": effects})
    system = linearise(contact.of_scene(scene), preload=False)
    try:
        return covariance(lift(system, noise=True), noise_grid(scene)).rms("motor_normal")
    except InputError:
        return None


def _extracted(spec: StudyFile, child: Child) -> tuple[float, list[dict[str, Any] | None]]:
    given: CornerParameters = spec.parameters
    tip = tip_of(spec.scene("solver.model=linear"), child)
    board = resolve(tip.scene).board
    capacitor, own = (nominal_value(board, n) for n in (given.corner_capacitor, given.corner_parameter))
    if capacitor is None or own is None:
        fail("resistor and capacitor of the corner must be .params of the board", file=str(spec.file),
             key="parameters.corner_parameter", value=given.corner_parameter)  # fmt: skip
    circuits: list[LinearCircuit | CosimError] = call(
        "cosim.circuits.extraction.reextract:circuits",
        {
            "board": board, "band_hz": 0.0, "tolerance": 0.0,
            "sets": [{given.corner_parameter: 1.0 / (2.0 * math.pi * f * capacitor)}
                     for f in given.corners_hz],
        },
        time_limit_s=tip.scene.solver.time_limit_s, deck=str(board.path), child=child,
    )  # fmt: skip
    looked = [
        None if isinstance(circuit, CosimError)
        else _looked_at(replace(tip, circuit=circuit), given)
        for circuit in circuits
    ]  # fmt: skip
    return 1.0 / (2.0 * math.pi * own * capacitor), looked


def analyse(spec: StudyFile, points: Points) -> StudyResult:
    """Compute noise, passive stiffness and exact border for every corner."""
    given: CornerParameters = spec.parameters
    points.expect(1)
    with start_early("cosim.circuits.extraction.reextract") as child:
        own, every = points.get("corners", partial(_extracted, spec, child))
    columns: dict[str, list[Any]] = {}
    kinds = [k.value for k in (PotNoise.WHITE, PotNoise.PEAK_TO_PEAK, PotNoise.POSITION, PotNoise.STATIC)]
    for corner, answer in zip(given.corners_hz, every, strict=True):
        row(columns, {
            col.CORNER: corner,
            **{f"{kind} [N rms]": answer and answer["noise"][kind] for kind in kinds},
            col.HELD_NOISE: answer and answer["closed"],
            col.PASSIVE_STIFFNESS: answer and answer["passive"],
            col.EXACT_BORDER: answer and answer["border"],
        })  # fmt: skip
    texts = []
    for kind in kinds[:3]:
        quiet = [
            (corner, stiff) for corner, noise, stiff in zip(
                columns[col.CORNER], columns[f"{kind} [N rms]"], columns[col.PASSIVE_STIFFNESS],
                strict=True,
            ) if noise is not None and stiff is not None and noise < given.largest_noise_n
        ]  # fmt: skip
        best = max(quiet, key=lambda pair: pair[1], default=None)
        texts.append(
            f"{kind}: none" if best is None else f"{kind}: {best[1]:.4g} N/m at a corner of {best[0]:g} Hz"
        )
    pairs = zip(columns[col.CORNER], columns[col.PASSIVE_STIFFNESS], strict=True)
    active = [corner for corner, stiff in pairs if stiff is None]
    if active:
        texts.append(f"corners from {min(active):g} Hz on make the analog damper itself active")
    period = spec.scene().computer.period_s
    return spec.result(
        Table("corner", "Noise and passive stiffness over the corner of the differentiator", columns,
              f"k = {given.stiffness_n_per_m:g} N/m, c = {given.damping_n_s_per_m:g} N s/m, "
              f"T = {1e3 * period:g} ms. Force noise with the tip held still; of position noise at "
              f"{given.speed_m_per_s:g} m/s; 'contact held': {given.discrete_n_per_m:g} N/m by the computer, "
              "exact covariance."),
        Table("board", "The board as it is", {col.CORNER: [own]}),
        holds_table(
            spec, (Variation(name="every corner"),),
            "The force noise holds each kind of potentiometer noise by itself, and none of the components.",
        ),
        verdicts=(
            Verdict("N1", "most passive stiffness whose damper stays quiet", "a question: force noise below "
                    f"{given.largest_noise_n:g} N rms", "; ".join(texts), None),
        ),
    )  # fmt: skip


STUDY = Study("corner", "footnote 1: noise against passive stiffness", CornerParameters, analyse)
