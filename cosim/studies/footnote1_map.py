"""Footnote 1, the verdict: where the circuit's own dynamics may be neglected.

It holds where the rendered stiffness is right in the band of human motion, delay takes little of the device's
damping, and the circuit adds little force noise. The board is extracted again for every op-amp, every driver
bandwidth and every corner of the differentiator; stiffness and damping are gains of the same circuit.
"""

from __future__ import annotations

import math
from dataclasses import replace
from functools import partial
from typing import Annotated, Any

import numpy as np

from cosim.analysis.tip import Tip, Wanted, row, tip_of
from cosim.analysis.tip_noise import NoiseForm, component_form, pot_density, pot_form
from cosim.circuits.extraction.alter import altered, nominal_value
from cosim.circuits.linear_circuit import LinearCircuit
from cosim.errors import CosimError, fail
from cosim.ngspice.child import Child, call, start_early
from cosim.ngspice.deck import Deck
from cosim.plan import resolve
from cosim.scene import PotNoise
from cosim.scene.parameters import Field, Parameters, Unit, Variation
from cosim.scene.quantities import Damping, Frequency, Stiffness
from cosim.storage.checkpoint import Points
from cosim.studies import table_columns as col
from cosim.studies.case_effects import holds_table
from cosim.studies.grid import geometric
from cosim.studies.study import Study, StudyFile, StudyResult, Table, Verdict
from cosim.types import Array

__all__ = ["STUDY", "FootnoteParameters", "shares", "verdicts"]


#: Kinds of potentiometer noise; `position` and `static` are silent at rest and leave the components' noise.
_KINDS = (PotNoise.POSITION, PotNoise.PEAK_TO_PEAK, PotNoise.WHITE)
#: Frequencies of the band of motion at which stiffness is looked at.
_LOOKS = 13


#: What the criteria hold beside the scene's effects, for the page.
_ADDS = (
    "The force noise holds besides, whatever the scene says, each kind of potentiometer noise by itself "
    "and the noise of all components at their data sheets' density. The tip is held: no mass moves."
)


class FootnoteParameters(Parameters):
    """``[parameters]`` of the verdict: thresholds, the paper's point, and what is mapped."""

    largest_error: Annotated[float, Field(gt=0, lt=1), Unit("share")] = 0.05
    largest_eta: Annotated[float, Field(gt=0, lt=1), Unit("share")] = 0.05
    largest_noise_n: Annotated[float, Field(gt=0, lt=100), Unit("N")] = 0.05
    motion_hz: Frequency = 10.0
    noise_band_hz: Frequency = 1000.0
    opamps: tuple[Variation, ...] = Field(default=(Variation(name="as built"),), min_length=1)
    corner_parameter: str = "r_der_in"
    corner_capacitor: str = "c_der_in"
    corners_hz: tuple[Frequency, ...] = (10.0, 100.0, 1000.0)
    driver_parameter: str = "opa548_gbw"
    drivers_hz: tuple[Frequency, ...] = (1e3, 1e6)
    stiffness_n_per_m: Stiffness = 100.0
    dampings_n_s_per_m: tuple[Damping, ...] = (0.0,)
    viscosities_n_s_per_m: tuple[Damping, ...] = (0.1, 1.66)
    stiffness_range: tuple[Stiffness, Stiffness] = (10.0, 1e4)
    damping_range: tuple[Damping, Damping] = (1e-3, 10.0)
    points: int = Field(default=41, ge=3, le=201)


def shares(
    given: FootnoteParameters, answer: dict[str, Any], k: Array, c: Array, kind: PotNoise
) -> tuple[Array, Array, Array]:
    """Return error of stiffness, eta and force noise, each over its threshold; below 1 all is well.

    Parameters
    ----------
    answer
        As `_looked_at` returns it.
    k, c
        Stiffness [N/m] and damping [N s/m], of one shape.
    """
    spring, damper = np.array(answer["spring"]), np.array(answer["damper"])  # Re Z of 1 N/m and 1 N s/m
    stiff = spring + (c / k)[..., None] * damper
    error = np.abs(stiff - 1.0).max(axis=-1)
    eta = k * answer["tau_s"] / answer["b"]
    square = NoiseForm(np.array(answer["components"])).rms(k, c) ** 2
    if kind.value in answer["pots"]:
        square = square + NoiseForm(np.array(answer["pots"][kind.value])).rms(k, c) ** 2
    return (
        error / given.largest_error, eta / given.largest_eta, np.sqrt(square) / given.largest_noise_n,
    )  # fmt: skip


def _looked_at(
    given: FootnoteParameters, tip: Tip, components: NoiseForm, kinds: tuple[PotNoise, ...]
) -> dict[str, Any]:
    """Return what the criteria need of one circuit, JSON-ready."""
    hz = np.geomspace(0.01 * given.motion_hz, given.motion_hz, _LOOKS)
    low = np.array([1e-3 * given.motion_hz])
    still = tip.impedance(Wanted(1.0), low)[0]
    pots: dict[str, Any] = {}
    known: tuple[float, Array] | None = None  # kinds differ in size alone
    for kind in kinds:
        density = pot_density(tip.scene, kind)
        if density is not None:
            size = float(density[1][0])
            if known is None:
                known = size, pot_form(tip, density).gram
            pots[kind.value] = (known[1] * (size / known[0])).tolist()
    return {
        "spring": tip.impedance(Wanted(1.0), hz).real.tolist(),
        "damper": tip.impedance(Wanted(0.0, 1.0), hz).real.tolist(),
        "tau_s": -math.atan(still.imag / still.real) / (2.0 * math.pi * float(low[0])),
        "b": tip.viscosity(),
        "pots": pots,
        "components": components.gram.tolist(),
    }


def _noise(tip: Tip, board: Deck, band_hz: float, child: Child) -> NoiseForm:
    form = call(
        "cosim.circuits.extraction.noise_contributions:component_noise",
        {"board": board},
        time_limit_s=tip.scene.solver.time_limit_s,
        deck=str(board.path),
        child=child,
    )
    return component_form(tip, form, band_hz)


def _opamp(spec: StudyFile, case: Variation, child: Child) -> dict[str, Any]:
    """Extract the board with one op-amp for all drivers and corners; components' noise for all corners."""
    given: FootnoteParameters = spec.parameters
    scene = spec.scene("solver.model=linear", *case.set)
    tip = tip_of(scene, child)
    board = resolve(scene).board
    altered(board, {given.driver_parameter: "1"})  # raises where there is no such name
    capacitor, own = (nominal_value(board, n) for n in (given.corner_capacitor, given.corner_parameter))
    if capacitor is None or own is None:
        fail("resistor and capacitor of the corner must be .params of the board", file=str(spec.file),
             key="parameters.corner_parameter", value=given.corner_parameter)  # fmt: skip
    resistors = [1.0 / (2.0 * math.pi * corner * capacitor) for corner in given.corners_hz]
    noises = [
        _noise(tip, altered(board, {given.corner_parameter: repr(r)}), given.noise_band_hz, child)
        for r in resistors
    ]
    sets = [
        {given.corner_parameter: r, given.driver_parameter: driver}
        for driver in given.drivers_hz for r in resistors
    ]  # fmt: skip
    circuits: list[LinearCircuit | CosimError] = call(
        "cosim.circuits.extraction.reextract:circuits",
        {"board": board, "band_hz": 0.0, "tolerance": 0.0, "sets": sets},
        time_limit_s=tip.scene.solver.time_limit_s, deck=str(board.path), child=child,
    )  # fmt: skip
    looked: list[dict[str, Any] | None] = []
    for number, circuit in enumerate(circuits):
        if isinstance(circuit, CosimError):
            looked.append(None)  # such as an unstable loop: its dynamics cannot be neglected
            continue
        there = replace(tip, circuit=circuit)
        looked.append(_looked_at(given, there, noises[number % len(resistors)], _KINDS))
    return {
        "own": _looked_at(given, tip, _noise(tip, board, given.noise_band_hz, child), _KINDS),
        "corner_hz": 1.0 / (2.0 * math.pi * own * capacitor),
        "driver_hz": nominal_value(board, given.driver_parameter),
        "grid": looked,
    }  # fmt: skip


def analyse(spec: StudyFile, points: Points) -> StudyResult:
    """Map the three criteria over gains and over parts, and judge the paper's point."""
    given: FootnoteParameters = spec.parameters
    points.expect(len(given.opamps))
    with start_early("cosim.circuits.extraction.reextract") as child:
        every = [points.get(case.name, partial(_opamp, spec, case, child)) for case in given.opamps]
    gains: dict[str, list[Any]] = {}
    parts: dict[str, list[Any]] = {}
    at: dict[str, list[Any]] = {}
    ks = geometric(*given.stiffness_range, given.points)
    cs = geometric(*given.damping_range, given.points)
    kk, cc = np.meshgrid(ks, cs, indexing="ij")
    for case, answer in zip(given.opamps, every, strict=True):
        each = {kind: shares(given, answer["own"], kk, cc, kind) for kind in _KINDS}
        error, eta, _ = each[PotNoise.POSITION]
        for i, k in enumerate(ks):
            for j, c in enumerate(cs):
                row(gains, {
                    "op-amp": case.name, col.STIFFNESS_K: float(k), col.DAMPING_C: float(c),
                    col.ERROR_OVER_LIMIT: float(error[i, j]), col.ETA_OVER_LIMIT: float(eta[i, j]),
                    **{f"noise, {kind.value} / limit": float(each[kind][2][i, j]) for kind in _KINDS},
                })  # fmt: skip
        for damping in given.dampings_n_s_per_m:
            k0, c0 = np.array(given.stiffness_n_per_m), np.array(damping)
            number = 0
            for driver in given.drivers_hz:
                for corner in given.corners_hz:
                    here = answer["grid"][number]
                    number += 1
                    values: dict[str, Any] = {
                        "op-amp": case.name, col.DAMPING_C: damping, col.DRIVER_BANDWIDTH: driver,
                        col.CORNER: corner, col.ERROR_OVER_LIMIT: None, col.ETA_OVER_LIMIT: None,
                        **{f"noise, {kind.value} / limit": None for kind in _KINDS},
                    }  # fmt: skip
                    for kind in _KINDS if here is not None else ():
                        e, t, f = shares(given, here, k0, c0, kind)
                        values |= {
                            col.ERROR_OVER_LIMIT: float(e), col.ETA_OVER_LIMIT: float(t),
                            f"noise, {kind.value} / limit": float(f),
                        }  # fmt: skip
                    row(parts, values)
            judged = {kind: shares(given, answer["own"], k0, c0, kind) for kind in _KINDS}
            e, t, _ = judged[PotNoise.POSITION]
            row(at, {
                "op-amp": case.name, col.DAMPING_C: damping,
                "stiffness error [%]": 100.0 * given.largest_error * float(e),
                "eta [%]": 100.0 * given.largest_eta * float(t),
                **{f"force noise, {kind.value} [N rms]": given.largest_noise_n * float(judged[kind][2])
                   for kind in _KINDS},
                **{f"holds, {kind.value}": bool(max(judged[kind]) < 1.0) for kind in _KINDS},
            })  # fmt: skip
    own = every[0]
    limits = {
        col.VISCOSITY_B: [own["own"]["b"], *given.viscosities_n_s_per_m],
        "k at which eta reaches its limit [N/m]": [
            given.largest_eta * b / own["own"]["tau_s"]
            for b in (own["own"]["b"], *given.viscosities_n_s_per_m)
        ],
    }
    board: dict[str, list[Any]] = {
        col.CORNER: [own["corner_hz"]], col.DRIVER_BANDWIDTH: [own["driver_hz"]],
        col.STIFFNESS: [given.stiffness_n_per_m],
    }  # fmt: skip
    thresholds = (
        f"stiffness error < {100 * given.largest_error:g} % up to {given.motion_hz:g} Hz, eta < "
        f"{100 * given.largest_eta:g} %, force noise < {given.largest_noise_n:g} N rms"
    )
    return spec.result(
        Table("at", f"At {given.stiffness_n_per_m:g} N/m, the board as it is", at,
              "Potentiometer noise by kind: position (and static) is silent at rest, what is left is the "
              f"components' up to {given.noise_band_hz:g} Hz. The tip is held still."),
        Table("viscosities", "How stiff before delay eats too much, by the device's viscosity", limits,
              "The first is this device's."),
        Table("board", "The board as it is", board),
        Table("gains", "Over stiffness and damping", gains),
        Table("parts", "Over op-amp, driver and differentiator", parts),
        holds_table(spec, given.opamps, _ADDS),
        verdicts=verdicts(given, at, thresholds),
    )  # fmt: skip


def verdicts(given: FootnoteParameters, at: dict[str, list[Any]], thresholds: str) -> list[Verdict]:
    """Judge footnote 1 at the paper's point, and whether the op-amp decides it; `at` is the table there."""
    rows = []
    for number, damping in enumerate(given.dampings_n_s_per_m):
        silent, white = (at[f"force noise, {k.value} [N rms]"][number] for k in (_KINDS[0], _KINDS[-1]))
        text = (
            f"{at['op-amp'][number]}: error {at['stiffness error [%]'][number]:.3g} %, eta "
            f"{at['eta [%]'][number]:.3g} %, noise {silent:.2g} N rms with a potentiometer that is silent at "
            f"rest, {white:.2g} N with white noise"
        )
        rows.append(
            Verdict("N1", f"footnote 1 holds at {given.stiffness_n_per_m:g} N/m and {damping:g} N s/m",
                    thresholds, text, bool(at[f"holds, {_KINDS[0].value}"][number]))
        )  # fmt: skip
    count = len(given.dampings_n_s_per_m)
    names = dict.fromkeys(at["op-amp"])
    spread = {
        key: [at[key][number * count + j] for number in range(len(names)) for j in range(count)]
        for key in ("eta [%]", "stiffness error [%]")
    }
    worst = max(
        max(spread[key][j::count]) - min(spread[key][j::count]) for key in spread for j in range(count)
    )
    limits = {"eta [%]": 100.0 * given.largest_eta, "stiffness error [%]": 100.0 * given.largest_error}
    decides = [
        f"{damping:g} N s/m"
        for j, damping in enumerate(given.dampings_n_s_per_m)
        if any(len({value < limits[key] for value in spread[key][j::count]}) > 1 for key in spread)
    ]
    if len(names) < 2:
        answer = "one op-amp cannot tell"
    else:
        answer = f"yes, at {', '.join(decides)}" if decides else "no"
    rows.append(
        Verdict("N1", f"the op-amp decides ({', '.join(names)})",
                "a question: on different sides of a threshold with different op-amps",
                f"{answer}: error and eta move by at most {worst:.2g} percentage points", None)
    )  # fmt: skip
    return rows


STUDY = Study("footnote", "footnote 1: where it holds", FootnoteParameters, analyse)
