"""Footnote 1: stiffness and damping that the circuit renders, against the commanded ones, over frequency.

At the tip, led along the wall's normal by x(t), the force is Z(jw) x; K(w) = Re Z, B(w) = Im Z / w. An
ideal circuit has K = k and B = c at all frequencies. What a hand notices is taken from psychophysics.
"""

from __future__ import annotations

from functools import partial
from typing import Annotated, Any

import numpy as np

from cosim.analysis.extracted import circuit_of
from cosim.analysis.tip import Tip, Wanted, row, tip_of
from cosim.ngspice.child import Child, on_demand
from cosim.plan import resolve
from cosim.scene.parameters import Field, Parameters, Unit, Variation
from cosim.scene.quantities import Damping, Frequency, Stiffness
from cosim.storage.checkpoint import Points
from cosim.studies import table_columns as col
from cosim.studies.grid import geometric, percent
from cosim.studies.study import Study, StudyFile, StudyResult, Table, Verdict
from cosim.types import Array

__all__ = ["STUDY", "RenderingParameters", "passes", "shown"]

Share = Annotated[float, Field(gt=0, lt=10)]


class RenderingParameters(Parameters):
    """``[parameters]``: what is commanded, and what a hand notices of it (least and usual share)."""

    cases: tuple[Variation, ...] = Field(default=(Variation(name="as built"),), min_length=1)
    stiffness_n_per_m: Stiffness = 100.0
    damping_n_s_per_m: Damping = 2.0
    low_hz: Frequency = 0.1
    high_hz: Frequency = 1e3
    points: int = Field(default=161, ge=11, le=2001)
    motion_hz: Frequency = 10.0
    stiffness_noticed: tuple[Share, Share] = (0.08, 0.23)
    stiffness_source: str = "Jones and Hunter 1990"
    damping_noticed: tuple[Share, Share] = (0.14, 0.34)
    damping_source: str = "Jones and Hunter 1993"
    force_noticed: tuple[Share, Share] = (0.07, 0.10)
    force_source: str = "Pang, Tan and Durlach 1991"
    largest_error: Annotated[float, Field(gt=0, lt=1), Unit("share")] = 0.05


def shown(tip: Tip, wanted: Wanted, hz: Array) -> tuple[Array, Array]:
    """Return K(w) [F] N/m and B(w) [F] N s/m of what is commanded."""
    z = tip.impedance(wanted, hz)
    return np.asarray(z.real, np.float64), np.asarray(z.imag / (2.0 * np.pi * hz), np.float64)


def passes(hz: Array, error: Array, limit: float) -> float | None:
    """Return where an error first reaches a limit, between points by its logarithm [Hz]; None if nowhere."""
    beyond = np.flatnonzero(~(error < limit))
    if len(beyond) == 0:
        return None
    k = int(beyond[0])
    if k == 0:
        return float(hz[0])
    a, b = np.log(np.maximum(error[k - 1 : k + 1], 1e-300))
    share = (np.log(limit) - a) / (b - a)
    return float(hz[k - 1] * (hz[k] / hz[k - 1]) ** share)


def analyse(spec: StudyFile, points: Points) -> StudyResult:
    """Compute the spectra of every case, and where they leave what a hand notices."""
    given: RenderingParameters = spec.parameters
    hz = geometric(given.low_hz, given.high_hz, given.points)
    spectra: dict[str, list[float]] = {col.FREQUENCY_F: hz.tolist()}
    ends: dict[str, list[Any]] = {}
    certified: dict[str, list[Any]] = {}
    numbers: dict[str, dict[str, float]] = {}
    points.expect(len(given.cases))
    with on_demand() as child:
        every = [points.get(case.name, partial(_case, spec, case, hz, child)) for case in given.cases]
    for case, answer in zip(given.cases, every, strict=True):
        row(certified, {"case": case.name, **answer["certificate"]})
        for name, ratio in answer["ratios"].items():
            spectra[f"{case.name}: {name}"] = ratio
            error = np.abs(np.array(ratio) - 1.0)
            inside = error[hz <= given.motion_hz * (1.0 + 1e-9)]
            worst = float(inside.max())
            numbers.setdefault(case.name, {})[name] = worst
            stiff = name.startswith("K")
            least, usual = given.stiffness_noticed if stiff else given.damping_noticed
            row(ends, {
                "case": case.name, "shown": name,
                f"worst error up to {given.motion_hz:g} Hz [%]": 100.0 * worst,
                f"{100 * given.largest_error:g} % from [Hz]": passes(hz, error, given.largest_error),
                "noticed at best from [Hz]": passes(hz, error, least),
                "noticed as a rule from [Hz]": passes(hz, error, usual),
            })  # fmt: skip
    first = given.cases[0].name
    verdicts = [
        Verdict(
            "N1", f"{word} is the commanded one in the band of human motion, {given.motion_hz:g} Hz",
            f"error below {100 * given.largest_error:g} %",
            f"at most {100 * numbers[first][name]:.3g} % ({first})",
            bool(numbers[first][name] < given.largest_error),
        )
        for word, name in (
            ("stiffness of the spring alone", col.STIFFNESS_SHARE),
            ("damping of the damper alone", col.DAMPING_SHARE),
            ("stiffness of spring and damper together", col.STIFFNESS_SHARE_OF_BOTH),
            ("damping of spring and damper together", col.DAMPING_SHARE_OF_BOTH),
        )
    ]  # fmt: skip
    noticed = (given.stiffness_noticed, given.damping_noticed, given.force_noticed)
    sources = (
        f"{given.stiffness_source}: stiffness {_span(given.stiffness_noticed)}; {given.damping_source}: "
        f"viscosity {_span(given.damping_noticed)}; {given.force_source}: force {_span(given.force_noticed)}."
    )
    asked = f"k = {given.stiffness_n_per_m:g} N/m, c = {given.damping_n_s_per_m:g} N s/m at the tip."
    return spec.result(
        Table("spectra", "Rendered over commanded", spectra, asked),
        Table("reach", "Up to where the circuit renders what is commanded", ends,
              f"{asked} Noticed differences: {sources}"),
        Table("noticed", "What a hand notices", {
            "quantity": ["stiffness", "damping", "force"],
            col.AT_BEST: [percent(shares[0]) for shares in noticed],
            col.AS_A_RULE: [percent(shares[1]) for shares in noticed],
            "source": [given.stiffness_source, given.damping_source, given.force_source],
        }),
        Table("certificate", "Certified: the circuit against its gains at low frequency", certified,
              f"Largest error of any path up to {given.motion_hz:g} Hz, of the path's maximum there."),
        verdicts=verdicts,
        notes=(f"Just noticeable differences: {sources}",),
    )  # fmt: skip


def _span(shares: tuple[float, float]) -> str:
    return f"{100 * shares[0]:g} to {100 * shares[1]:g} %"


def _case(spec: StudyFile, case: Variation, hz: Array, child: Child) -> dict[str, Any]:
    given: RenderingParameters = spec.parameters
    scene = spec.scene("solver.model=linear", *case.set)
    tip = tip_of(scene, child)
    k, c = given.stiffness_n_per_m, given.damping_n_s_per_m
    ratios: dict[str, list[float]] = {}
    for name, wanted in (
        ("spring", Wanted(k)), ("damper", Wanted(0.0, c)), ("both", Wanted(k, c)),
    ):  # fmt: skip
        stiff, damping = shown(tip, wanted, hz)
        if wanted.stiffness:
            ratios[f"K/k of the {name}".replace("the both", "both")] = (stiff / k).tolist()
        if wanted.damping:
            ratios[f"B/c of the {name}".replace("the both", "both")] = (damping / c).tolist()
    banded = spec.scene("solver.model=linear", *case.set, f"solver.band_hz={given.motion_hz!r}")
    certificate = circuit_of(resolve(banded), reduced=True, child=child)[0].certificate["footnote_1"]
    percent = {
        f"{name.replace('_', '-')} [%]": 100.0 * value for name, value in certificate.get("error", {}).items()
    }
    return {"ratios": ratios, "certificate": percent}


STUDY = Study("rendering", "footnote 1: rendered against commanded", RenderingParameters, analyse)
