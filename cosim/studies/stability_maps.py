"""Stability maps: discrete stiffness over the sampling period and over the virtual damping; Z-width.

On the same axes: the exact border of the held contact, the largest passive stiffness (Colgate and Schenkel,
with what the circuit makes of the damping), and the rules of `closed_form_limits.py` that know the device by
its viscosity, mass, friction and encoder alone; on top the points at which a dropped mass was simulated.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np

from cosim.analysis import closed_form_limits
from cosim.analysis.extracted import circuit_of
from cosim.analysis.held_contact import HeldContact
from cosim.analysis.impedance import displayed, impedance
from cosim.analysis.stiffness_limits import limits
from cosim.errors import fail
from cosim.plan import resolve
from cosim.scene import Scene
from cosim.scene.mechanism import encoder_step, mechanism, operator
from cosim.scene.parameters import Field, Parameters, Unit, Variation
from cosim.scene.quantities import Damping, Frequency, Period, Stiffness
from cosim.storage.checkpoint import Points
from cosim.studies import table_columns as col
from cosim.studies.drop_test import Falls, Job, Rest
from cosim.studies.grid import geometric, milli
from cosim.studies.study import Study, StudyFile, StudyResult, Table, Verdict

__all__ = ["STUDY", "Column", "Tip", "column", "tip"]


class Width(Variation):
    """One curve of the Z-width: what of the analog path displays the wall besides the computer."""

    spring: bool = False
    damper: bool = False


class MapParameters(Parameters):
    """``[parameters]`` of the maps; `stiffness_shares` are of the exact border, for the simulated points."""

    panels: tuple[Variation, ...] = Field(min_length=1, max_length=6)
    widths: tuple[Width, ...] = ()
    periods_s: tuple[Period, ...] = Field(min_length=2)
    stiffness_shares: tuple[Annotated[float, Field(gt=0, le=100)], ...] = ()
    dampings_n_s_per_m: tuple[Damping, ...] = Field(min_length=2)
    stiffness_n_per_m: tuple[Stiffness, ...] = ()
    phases: int = Field(default=8, ge=1, le=1024)
    window_s: Annotated[float, Field(gt=0, le=1e4), Unit("s")] = 30.0
    rest_speed_m_per_s: Annotated[float, Field(gt=0, le=1), Unit("m/s")] = 1e-3
    rest_time_s: Annotated[float, Field(gt=0, le=100), Unit("s")] = 1.0
    rest_share: Annotated[float, Field(gt=0, le=1)] = 0.95
    cycle_m: Annotated[float, Field(gt=0, le=1), Unit("m")] = 0.01
    margin: Annotated[float, Field(gt=0, le=1)] = 0.8
    lowest_hz: Frequency = 0.1
    highest_hz: Frequency = 1000.0


@dataclass(frozen=True)
class Tip:
    """The device as the rules see it, along the wall's normal at the tip.

    Attributes
    ----------
    mass_kg : of all that moves, the operator's mass included
    coulomb_n : friction; 0 where the effect is off
    resolution_m : step of the encoder; 0 where the effect is off
    """

    mass_kg: float
    coulomb_n: float
    resolution_m: float


def tip(scene: Scene, gear: float) -> Tip:
    """Return the tip of a slider; that of a chain depends on pose and direction, unknown to the rules."""
    slider = scene.device.slider
    if slider is None:
        fail("these maps are drawn for one joint, a slider", file=scene.file_name, key="device.linkage")
    linkage = mechanism(scene, gear)
    mass = float(linkage.mass_matrix(np.zeros(1), operator(scene))[0, 0]) / slider.radius_m**2
    friction = slider.coulomb_n_m / slider.radius_m if scene.effects.coulomb else 0.0
    return Tip(mass, friction, encoder_step(scene, gear) * slider.radius_m)


@dataclass(frozen=True)
class Column:
    """Points of a plane above one another: a scene, and the stiffnesses that are simulated.

    Attributes
    ----------
    job : scene and circuit, and what counts as rest
    stiffness : [N/m], or shares of the exact border where `of_border`
    cycle_m : amplitude of the large cycle at which the stiffness is stated
    """

    job: Job
    stiffness: tuple[float, ...]
    of_border: bool
    cycle_m: float


def column(asked: Column) -> dict[str, Any]:
    """Return limits [N/m] and simulated points of a column, JSON-ready; limits that do not exist are None."""
    scene, constants = asked.job.scene, asked.job.constants
    edges = limits(asked.job.contact())
    device, c = tip(scene, constants.gear), scene.computer
    late = (c.delay_periods + c.delay_fraction) * c.period_s if scene.effects.delay else 0.0
    b, damping = edges.viscosity_n_s_per_m, c.discrete_damping_n_s_per_m
    exact = edges.border.value
    shares = asked.stiffness if 0.0 < exact < math.inf else ()  # no border, no share of it
    tried = [share * exact for share in shares] if asked.of_border else list(asked.stiffness)
    falls = Falls(asked.job)
    return {
        "exact_n_per_m": exact if math.isfinite(exact) else None,
        "passive_n_per_m": edges.passive_n_per_m,
        "gil_hulin_n_per_m": edges.gil_hulin_n_per_m,
        "abbott_okamura_n_per_m": closed_form_limits.abbott_okamura(
            b, c.period_s, device.coulomb_n, device.resolution_m
        ),
        "beta_n_per_m": closed_form_limits.beta_stiffness(b, c.period_s, late),
        "sigma_n_per_m": 2.0 * device.coulomb_n / device.resolution_m if device.resolution_m else None,
        "cycle_n_per_m": closed_form_limits.stiffness_of_cycle(
            asked.cycle_m, device.mass_kg, b + damping, c.period_s, device.coulomb_n, late
        ) if device.coulomb_n else None,
        "viscosity_n_s_per_m": b,
        "mass_kg": device.mass_kg,
        "stiffness_n_per_m": tried,
        "share": [falls.share(k) for k in tried],
        "drops": falls.runs,
    }  # fmt: skip


#: Heading of a limit -> key of it.
LIMITS = {
    col.EXACT_BORDER: "exact_n_per_m",
    col.PASSIVE: "passive_n_per_m",
    col.GIL_HULIN: "gil_hulin_n_per_m",
    col.ABBOTT_OKAMURA: "abbott_okamura_n_per_m",
    col.DIOLAITI_BETA_1_2: "beta_n_per_m",
    col.DIOLAITI_SIGMA_1_2: "sigma_n_per_m",
    col.DIOLAITI_LARGE_CYCLE: "cycle_n_per_m",
}


def analyse(spec: StudyFile, points: Points) -> StudyResult:
    """Compute both planes for every panel, and the Z-width."""
    given: MapParameters = spec.parameters
    asked: dict[str, Column] = {}
    where: list[tuple[str, str, float]] = []
    rest = Rest(
        given.window_s, given.rest_speed_m_per_s, given.rest_time_s, given.rest_share, given.phases, 0.5, 1.05
    )
    for panel in given.panels:
        changes = (*panel.set, f"duration_s={given.window_s!r}")
        plan = resolve(spec.scene(*changes))
        if plan.model == "spice":
            fail(
                "thousands of drops need the circuit model ideal or linear",
                file=str(spec.file), key=f"parameters.panels.{panel.name}", value="spice",
            )  # fmt: skip
        circuit, constants = circuit_of(plan, reduced=True)
        for period in given.periods_s:
            scene = spec.scene(*changes, f"computer.period_s={period!r}")
            key = f"{panel.name} at {1e3 * period:.4g} ms"
            job = Job(scene, constants, circuit, rest)
            asked[key] = Column(job, given.stiffness_shares, True, given.cycle_m)
            where.append(("K-T", panel.name, milli(period)))
        for damping in given.dampings_n_s_per_m:
            scene = spec.scene(*changes, f"computer.discrete_damping_n_s_per_m={damping!r}")
            key = f"{panel.name} at {damping:.4g} N s/m"
            job = Job(scene, constants, circuit, rest)
            asked[key] = Column(job, given.stiffness_n_per_m, False, given.cycle_m)
            where.append(("K-B", panel.name, damping))
    columns = dict(zip(where, points.map(column, asked), strict=True))
    period = 1e3 * spec.scene().computer.period_s
    tables = [
        *_plane("K-T", col.PERIOD, "kt", "Stiffness over the sampling period", columns, given),
        *_plane(
            "K-B", "virtual damping [N s/m]", "kb", f"Stiffness over damping at {period:g} ms", columns, given
        ),
    ]
    widths, walls = _widths(spec)
    return spec.result(*tables, widths, walls, verdicts=verdicts(columns, given))


Columns = Mapping[tuple[str, str, float], Mapping[str, Any]]


def _plane(
    plane: str, across: str, name: str, title: str, columns: Columns, given: MapParameters
) -> tuple[Table, Table]:
    """Return the limits of a plane, and its simulated points."""
    mine = {(panel, x): row for (which, panel, x), row in columns.items() if which == plane}
    borders: dict[str, list[Any]] = {"panel": [p for p, _ in mine], across: [x for _, x in mine]}
    for heading, key in LIMITS.items():
        borders[heading] = [row[key] for row in mine.values()]
    simulated: dict[str, list[Any]] = {
        "panel": [p for (p, _), row in mine.items() for _ in row["share"]],
        across: [x for (_, x), row in mine.items() for _ in row["share"]],
        col.STIFFNESS: [k for row in mine.values() for k in row["stiffness_n_per_m"]],
        col.SHARE_AT_REST: [share for row in mine.values() for share in row["share"]],
    }
    note = (
        f"A dropped mass, {given.phases} phases of the samples against the impact; rest is below "
        f"{1e3 * given.rest_speed_m_per_s:g} mm/s for {given.rest_time_s:g} s within {given.window_s:g} s."
    )
    rule = (
        "The rules know the device by its mass, viscosity, friction and encoder. Abbott, Okamura and beta "
        "know no virtual damping. Large cycle: the stiffness at which friction lets swings up to "
        f"{1e3 * given.cycle_m:g} mm die out, virtual damping counted as viscosity."
    )
    return Table(f"{name}_limits", title, borders, rule), Table(
        f"{name}_points", f"{title}: simulated", simulated, note
    )


def _widths(spec: StudyFile) -> tuple[Table, Table]:
    """Return |Z| over frequency of free air and of the stiffest walls, and what these walls are."""
    given: MapParameters = spec.parameters
    decades = math.log10(given.highest_hz / given.lowest_hz)
    hz = geometric(given.lowest_hz, given.highest_hz, max(2, math.ceil(100 * decades) + 1))
    curves: dict[str, list[Any]] = {
        name: [] for name in ("wall", col.FREQUENCY, col.FREE_AIR, col.WALL_IMPEDANCE, col.WIDTH)
    }
    walls: dict[str, list[Any]] = {
        name: []
        for name in (
            "wall",
            "circuit",
            col.PERIOD,
            "discrete [N/m]",
            "analog [N/m]",
            "analog [N s/m]",
            col.DISPLAYED,
        )
    }
    for width in given.widths:
        plan = resolve(spec.scene(*width.set))
        contact = HeldContact.of(plan, reduced=True)
        wall = displayed(contact, spring=width.spring, damper=width.damper, margin=given.margin)
        c = wall.scene.computer
        none = wall.with_computer(
            analog_stiffness_n_per_m=0.0, analog_damping_n_s_per_m=0.0, discrete_stiffness_n_per_m=0.0,
            discrete_damping_n_s_per_m=0.0,
        )  # fmt: skip
        free = np.abs(impedance(none, hz))
        stiff = impedance(wall, hz)
        slow = 1e-3
        still = impedance(wall, np.array([slow]))[0] * 2j * math.pi * slow
        rows = zip(hz, free, np.abs(stiff), 20.0 * np.log10(np.abs(stiff) / free), strict=True)
        for each in rows:
            for heading, value in zip(curves, (width.name, *map(float, each)), strict=True):
                curves[heading].append(value)
        row = (
            width.name, contact.circuit.model, milli(c.period_s), c.discrete_stiffness_n_per_m,
            c.analog_stiffness_n_per_m, c.analog_damping_n_s_per_m, float(still.real),
        )  # fmt: skip
        for key, value in zip(walls, row, strict=True):
            walls[key].append(value)
    note = (
        f"Stiffest walls: analog gains at the board's full scale, or at {100 * given.margin:g} % of where "
        f"the circuit oscillates; then the discrete stiffness at as much of its exact border."
    )
    return (
        Table("zwidth", "Z-width", curves, "Force over speed at the tip, moved along the wall's normal."),
        Table("walls", "Stiffest walls of the Z-width", walls, note),
    )


def verdicts(columns: Columns, given: MapParameters) -> list[Verdict]:
    """Judge passivity against the exact border, and the simulated points against both."""
    out = []
    worst = max(
        ((row["passive_n_per_m"] or 0.0) / row["exact_n_per_m"] for row in columns.values()
         if row["exact_n_per_m"]),
        default=math.nan,
    )  # fmt: skip
    out.append(
        Verdict("M1", "what is passive is stable", "passive limit nowhere above the exact one",
                f"at most {worst:.4g} of it", worst <= 1.0 + 1e-9, own=True)
    )  # fmt: skip
    for panel in given.panels:
        rows = [row for (_, name, _), row in columns.items() if name == panel.name]
        pairs = [
            (k / row["exact_n_per_m"], share, k / (row["cycle_n_per_m"] or row["exact_n_per_m"]))
            for row in rows if row["exact_n_per_m"]
            for k, share in zip(row["stiffness_n_per_m"], row["share"], strict=True)
        ]  # fmt: skip
        if not pairs:
            continue
        rough = any(row["sigma_n_per_m"] is not None or row["cycle_n_per_m"] is not None for row in rows)
        above = [share for ratio, share, _ in pairs if ratio > 1.01]
        beyond = [share for ratio, share, cycle in pairs if ratio > 1.01 and cycle > 1.0]
        below = [share for ratio, share, _ in pairs if ratio < 0.8]
        calm = sum(share >= given.rest_share for share in below)
        still = sum(share > 0.0 for share in above)
        text = f"{calm} of {len(below)} points below 0.8 of it rest, {still} of {len(above)} above it"
        if rough:
            text += f", {sum(share > 0.0 for share in beyond)} of {len(beyond)} above Diolaiti's large cycle"
        out.append(
            Verdict(
                "M2", f"the simulated mass rests below the exact border only: {panel.name}",
                "a question: friction holds above it" if rough else "no phase rests above it",
                text,
                None if rough else not still,
                own=True,
            )
        )  # fmt: skip
    return out


STUDY = Study(
    "maps",
    "stability maps: K-T and K-B planes, Z-width",
    MapParameters,
    analyse,
    no_tolerance="its borders are theory's, and its runs are asked whether they come to rest",
)
