"""Footnote 1: errors of what is measured, in mm at the tip, and noise of the force, by source."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np

from cosim.analysis.noise_covariance import noise_covariance
from cosim.analysis.tip import Tip, Wanted, row, tip_of
from cosim.analysis.tip_noise import pot_density, pot_form
from cosim.circuits.design_constants import Stated
from cosim.circuits.extraction.alter import nominal_value
from cosim.circuits.extraction.noise_contributions import ComponentNoise
from cosim.errors import InputError
from cosim.ngspice.child import Child, call, on_demand
from cosim.plan import resolve
from cosim.scene import Method, PotNoise
from cosim.scene.parameters import Field, Parameters, Unit, Variation
from cosim.storage.checkpoint import Points
from cosim.studies import table_columns as col
from cosim.studies.case_effects import holds_table
from cosim.studies.study import Study, StudyFile, StudyResult, Table, Verdict

__all__ = ["STUDY", "BudgetParameters", "loaded", "position_errors"]

#: A quantisation error is uniform over the step: rms 1/sqrt(12) of it.
_STEP = 1.0 / math.sqrt(12.0)


class BudgetParameters(Parameters):
    """``[parameters]`` of the budgets; gains are the scene's."""

    paper_mm: Annotated[float, Field(gt=0, le=100), Unit("mm")] = 0.8
    depth_m: Annotated[float, Field(gt=0, le=0.1), Unit("m")] = 7.5e-3
    noise_band_hz: Annotated[float, Field(gt=0, le=1e5), Unit("Hz")] = 1000.0
    load_parameter: str = "r_diff_in"
    devices: int = Field(default=8, ge=1, le=100)


@dataclass(frozen=True)
class Error:
    """One source: its size at a joint [rad], how it is meant (rms, largest, ...), all joints' at the tip [m].

    At the tip it is along the wall's normal: sqrt(sum w^2) for errors that are independent and random,
    sum |w| for the largest that each may have, and the signed sum where the same error is in every joint.
    """

    source: str
    meant: str
    rad: float
    tip_m: float


def loaded(track_ohm: float, load_ohm: float, travel_rad: float) -> float:
    """Return the largest error of a potentiometer between +-V whose wiper drives a load to ground [rad].

    At the share x of the track it shows (2 x - 1)/(1 + x (1 - x) R/R_L) of V instead of 2 x - 1.
    """
    x = np.linspace(0.0, 1.0, 2001)
    straight = 2.0 * x - 1.0
    bent = straight / (1.0 + x * (1.0 - x) * track_ohm / load_ohm)
    return float(np.abs(bent - straight).max()) * travel_rad / 2.0


def position_errors(tip: Tip, stated: Stated, load_ohm: float | None) -> list[Error]:
    """Return the error that each source puts into a joint's angle."""
    pot, computer, w = tip.scene.device.potentiometer, tip.scene.computer, tip.torques

    def random(source: str, meant: str, rad: float) -> Error:
        return Error(source, meant, rad, rad * float(np.linalg.norm(w)))

    def largest(source: str, rad: float) -> Error:
        return Error(source, "largest", rad, rad * float(np.abs(w).sum()))

    zero, gain = abs(pot.zero_rad), abs(pot.gain_error)
    errors = [
        random("noise, white", "rms", pot.noise_rad),
        largest("noise, peak to peak", 0.5 * pot.noise_rad),
        random("noise, static", "rms of devices", pot.noise_rad),
        random("noise, position", "rms over the angle", pot.noise_rad),
        largest("linearity", pot.linearity_rad),
        Error("calibration, zero", "the same at every joint", zero, zero * abs(float(w.sum()))),
        Error(
            "calibration, gain", "the same at every joint, at the wall's pose",
            gain * float(np.abs(tip.q).max()), gain * abs(float(w @ tip.q)),
        ),
    ]  # fmt: skip
    track, wiper = (stated.numbers.get(name) for name in ("pot_r", "pot_rw"))
    travel = stated.numbers.get("pot_travel")
    bias = stated.of("opamp", "ib")
    if track is not None and wiper is not None and bias:
        volts = (wiper + track / 4.0) * max(map(abs, bias))
        errors.append(largest("wiper loading, bias current", volts / stated.v_rad))
    if track is not None and travel is not None and load_ohm is not None:
        errors.append(largest("wiper loading, were there no follower", loaded(track, load_ohm, travel)))
    encoder = computer.encoder
    count = 2.0 * math.pi / (encoder.pulses_per_rev * encoder.decoding * stated.gear)
    bits, reach = computer.dac.bits or stated.dac_bits, computer.dac.range_v or stated.dac_v
    errors.append(random("encoder, a count", "rms", _STEP * count))
    errors.append(random("DAC of u, a code", "rms", _STEP * 2.0 * reach / 2.0**bits / stated.v_rad))
    return errors


def _forces(
    spec: StudyFile, tip: Tip, stated: Stated, noise: ComponentNoise, child: Child
) -> list[tuple[str, str, float]]:
    """Return (group, source, rms force along the normal [N]), the tip held still."""
    given: BudgetParameters = spec.parameters
    computer = tip.scene.computer
    analog = computer.method is not Method.DISCRETE
    k = computer.analog_stiffness_n_per_m if analog else 0.0
    c = computer.analog_damping_n_s_per_m if analog else 0.0
    discrete = computer.discrete_stiffness_n_per_m if computer.method is not Method.CONTINUOUS else 0.0
    w, motion = float(np.linalg.norm(tip.torques)), float(np.linalg.norm(tip.motion))
    rows = []
    for kind in (PotNoise.WHITE, PotNoise.PEAK_TO_PEAK):
        density = pot_density(tip.scene, kind)
        assert density is not None
        words = kind.value.replace("_", " ")
        rows.append(("potentiometer", f"{words}, tip held", float(pot_form(tip, density).rms(k, c))))
        try:
            scene = spec.scene("solver.model=linear", f"effects.pot_noise={kind.value}")
            closed = noise_covariance(tip.of_scene(scene)).rms("motor_normal")
            rows.append(("potentiometer", f"{words}, hand in contact", closed))
        except InputError:
            pass  # no stable rest there: the budget is that of the tip held still
    encoder = computer.encoder
    count = 2.0 * math.pi / (encoder.pulses_per_rev * encoder.decoding * stated.gear)
    bits, reach = computer.dac.bits or stated.dac_bits, computer.dac.range_v or stated.dac_v
    code = 2.0 * reach / 2.0**bits
    gain = code * stated.k_fs / stated.v_fs
    rows += [
        ("quantisation", "encoder, discrete stiffness", _STEP * discrete * w * count),
        ("quantisation", "DAC of u, analog stiffness", _STEP * k * w * code / stated.v_rad),
        ("quantisation", "DAC of cmd", _STEP * motion * code / stated.v_nm),
        ("quantisation", f"DAC of gains at {1e3 * given.depth_m:g} mm",
         _STEP * gain * motion**2 * given.depth_m if k else 0.0),
    ]  # fmt: skip
    control = tip.control(Wanted(k, c))
    # one device's noise in several motors is coherent: its forces add along the normal
    inside = noise.hz <= given.noise_band_hz
    force = tip.constants.torque_per_amp * np.einsum("fdi,i->fd", noise.currents(control), tip.pushed)
    squares = np.trapezoid(np.abs(force[inside]) ** 2, noise.hz[inside], axis=0)
    power = dict(zip(noise.devices, squares.tolist(), strict=True))
    # rounded, so that equal joints keep the order of their names
    order = sorted(power, key=lambda name: (-float(f"{power[name]:.6g}"), name))
    for name in order[: given.devices]:
        rows.append(("components", name, math.sqrt(power[name])))
    rest = sum(power[name] for name in order[given.devices :])
    rows.append(("components", "all others", math.sqrt(rest)))
    rows.append(("components", "all together", math.sqrt(sum(power.values()))))
    return rows


def _computed(spec: StudyFile) -> dict[str, Any]:
    given: BudgetParameters = spec.parameters
    with on_demand() as child:
        scene = spec.scene("solver.model=linear")
        tip = tip_of(scene, child)
        plan = resolve(scene)
        stated = plan.stated(child)
        errors = position_errors(tip, stated, nominal_value(plan.board, given.load_parameter))
        noise = call("cosim.circuits.extraction.noise_contributions:component_noise", {"board": plan.board},
                     time_limit_s=scene.solver.time_limit_s, deck=str(plan.board.path),
                     child=child)  # fmt: skip
        forces = _forces(spec, tip, stated, noise, child)
    return {
        "errors": [[e.source, e.meant, e.rad, e.tip_m] for e in errors],
        "forces": [list(f) for f in forces], "r_tip": stated.r_tip,
    }  # fmt: skip


def analyse(spec: StudyFile, points: Points) -> StudyResult:
    """Put both budgets together."""
    given: BudgetParameters = spec.parameters
    numbers = points.get("budget", lambda: _computed(spec))
    errors: dict[str, list[Any]] = {}
    for source, meant, rad, tip_m in numbers["errors"]:
        row(errors, {
            "source": source, "meant as": meant, "at the joint [mrad]": 1e3 * rad,
            f"one joint at {1e3 * numbers['r_tip']:.4g} mm [mm]": 1e3 * rad * numbers["r_tip"],
            "all joints, along the normal [mm]": 1e3 * tip_m,
        })  # fmt: skip
    forces: dict[str, list[Any]] = {}
    for group, source, newtons in numbers["forces"]:
        row(forces, {"group": group, "source": source, col.FORCE_RMS: newtons})
    noise_mm = 1e3 * numbers["errors"][0][2] * numbers["r_tip"]
    groups = {
        group: max(f for its, source, f in numbers["forces"] if its == group)
        for group in dict.fromkeys(f[0] for f in numbers["forces"])
    }
    largest = max(groups, key=lambda name: groups[name])
    text = ", ".join(f"{name} {value:.2g} N" for name, value in groups.items())
    return spec.result(
        Table("errors", "Errors of the measured angles, at the tip", errors,
              "At the wall's pose. Random errors of the joints add as squares, the largest ones as they are, "
              "and what is the same at every joint with its sign."),
        Table("forces", "Force noise by source, at the scene's gains", forces,
              f"Along the normal; the components' up to {given.noise_band_hz:g} Hz."),
        holds_table(
            spec, (Variation(name="the circuit that carries them"),),
            "The sources in the tables are added one by one, whether the scene holds them or not: the "
            "errors of potentiometer and computer by their data, components at their data sheets' density.",
        ),
        verdicts=(
            Verdict("N1", "the potentiometer's 0.006 rad are the paper's accuracy at the fingertip",
                    f"{given.paper_mm:g} mm", f"{noise_mm:.3g} mm at {1e3 * numbers['r_tip']:.4g} mm",
                    bool(abs(noise_mm - given.paper_mm) < 0.05)),
            Verdict("N1", "which source makes most force noise", "a question",
                    f"{largest}: largest of each group: {text}", None),
        ),
    )  # fmt: skip


STUDY = Study("budget", "footnote 1: error and noise budgets", BudgetParameters, analyse)
