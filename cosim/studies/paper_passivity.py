"""Passivity of a sampled wall as the paper states it, (16), (20) and (21), by search and by runs.

* (16): the viscosity that a wall needs, by a certified search over frequency, against k_p T/2 + |k_d|.
* (21): the same with the circuit's damper in force. The largest passive stiffness is searched on the damping
  that the netlist makes, back-EMF and bearings included, and compared with 2 (b + k_sd - |k_d|)/T.
* (20): a passive hand lets go of the spring inside the wall. What the display has taken up must stay above
  -k x(0)^2/2, what the spring held at the start; a mass dropped on the wall shows what switching the spring
  on at samples adds, which (20) leaves out.
"""

from __future__ import annotations

from typing import Annotated, Any

import numpy as np
from scipy.optimize import brentq

from cosim.analysis.device_passivity import delivered, device_of
from cosim.analysis.held_contact import HeldContact
from cosim.analysis.passivity import least_damping, needed_damping, share_used, wall
from cosim.errors import fail
from cosim.measures import wall_frame
from cosim.ngspice.child import start_early
from cosim.plan import resolve
from cosim.runner import run
from cosim.scene import Scene
from cosim.scene.parameters import Field, Parameters, Unit
from cosim.storage.checkpoint import Points
from cosim.storage.staging import scratch_folder
from cosim.studies import table_columns as col
from cosim.studies.grid import even, steps
from cosim.studies.study import Study, StudyFile, StudyResult, Table, Verdict

__all__ = ["STUDY", "closed_form", "largest_passive"]

#: Bound of the acceptance table for a search against a closed form.
_EXACT = 1e-9
#: Rounding error of a sum over aliases near w = 0, where its terms cancel.
_SUMMED = 1e-7
#: Points of the curves over frequency, from 0 to pi/T.
_CURVE = 201
#: Two frequencies [rad/s] between which an ideal circuit's damping must not change.
_BAND = (1.0, 1e4)


class Wall(Parameters):
    """A discrete wall: N/m, N s/m, s."""

    stiffness_n_per_m: Annotated[float, Field(ge=0), Unit("N/m")]
    damping_n_s_per_m: Annotated[float, Unit("N s/m")] = 0.0
    period_s: Annotated[float, Field(gt=0, le=1), Unit("s")]


class PassiveParameters(Parameters):
    """``[parameters]`` of the checks on one joint."""

    walls: tuple[Wall, ...] = Field(min_length=1)
    dampers_n_s_per_m: tuple[Annotated[float, Field(ge=0)], ...] = Field(min_length=1)
    depths_m: tuple[Annotated[float, Field(gt=0, le=0.1)], ...] = Field(min_length=1)
    hand_n_per_m: Annotated[float, Field(gt=0), Unit("N/m")] = 135.0
    every_s: Annotated[float, Field(gt=0, le=1), Unit("s")] = 1e-3
    seconds: Annotated[float, Field(gt=0, le=100), Unit("s")] = 1.0


def closed_form(given: Wall) -> float:
    """Return k_p T/2 + |k_d| of (16) [N s/m]."""
    return given.stiffness_n_per_m * given.period_s / 2.0 + abs(given.damping_n_s_per_m)


def largest_passive(damping: float, wall_damping: float, period_s: float) -> float:
    """Return the stiffness [N/m] whose needed viscosity, searched over frequency, is `damping` [N s/m]."""

    def left(stiffness: float) -> float:
        return needed_damping(wall(stiffness, wall_damping, period_s)).value - damping

    return float(brentq(left, 0.0, 4.0 * damping / period_s, xtol=1e-12, rtol=1e-14))


def analyse(spec: StudyFile, points: Points) -> StudyResult:
    """Check A5 to A7 on the scene's slider."""
    given: PassiveParameters = spec.parameters
    scene = spec.scene()
    if not scene.is_slider or scene.wall is None:
        fail("(16) to (21) are about one joint on a wall", file=str(spec.scene_file), key="device.linkage")
    needed, curves = _needed(given)
    dampers = _dampers(spec)
    energies, over_time = _energies(spec, points)
    return spec.result(
        needed, curves, dampers, energies, over_time, verdicts=_verdicts(needed, dampers, energies)
    )


def _needed(given: PassiveParameters) -> tuple[Table, Table]:
    """Search the viscosity that every wall needs; and its curve over frequency."""
    of_nyquist = even(0.0, 1.0, _CURVE)[1:]
    names, theta = [], np.pi * of_nyquist
    needed, share, height, which = [], [], [], []
    for one in given.walls:
        name = f"{one.stiffness_n_per_m:g} N/m, {one.damping_n_s_per_m:g} N s/m, {1e3 * one.period_s:g} ms"
        law = wall(one.stiffness_n_per_m, one.damping_n_s_per_m, one.period_s)
        names.append(name)
        needed.append(needed_damping(law))
        z = np.exp(1j * theta)
        curve = one.period_s / 2.0 / (1.0 - np.cos(theta)) * ((1.0 - 1.0 / z) * law.response(z)).real
        which += [name] * len(theta)
        share += of_nyquist.tolist()
        height += (curve / closed_form(one)).tolist()
    closed = [closed_form(one) for one in given.walls]
    table = Table(
        "needed", "Viscosity that a wall needs, (16)",
        {
            "wall": names, "k_p T/2 + |k_d| [N s/m]": closed,
            "by search [N s/m]": [one.value for one in needed],
            "proven bound [N s/m]": [one.upper for one in needed],
            "difference": [one.value / form - 1.0 for one, form in zip(needed, closed, strict=True)],
        },
    )  # fmt: skip
    return table, Table(
        "curves", "Needed viscosity over frequency",
        {"wall": which, col.FREQUENCY_OVER_PI_T: share, col.NEEDED_OVER_CLOSED_FORM: height},
    )  # fmt: skip


def _dampers(spec: StudyFile) -> Table:
    """Search the largest passive stiffness with the circuit's damper, on the netlist's own damping."""
    given: PassiveParameters = spec.parameters
    rows: dict[str, list[Any]] = {
        name: [] for name in (
            "commanded k_sd [N s/m]", "b + k_sd of the netlist [N s/m]", "k_sd of it [N s/m]",
            "k_d of the computer [N s/m]", "2 (b + k_sd - |k_d|)/T [N/m]", "by search [N/m]", "difference",
            "by the sum over aliases [N/m]",
        )
    }  # fmt: skip
    bare: float | None = None
    for damper in (0.0, *given.dampers_n_s_per_m):
        method = "combined" if damper else "discrete"
        scene = spec.scene(
            f"computer.method={method}", "computer.analog_stiffness_n_per_m=0",
            f"computer.analog_damping_n_s_per_m={damper!r}",
        )  # fmt: skip
        device = device_of(HeldContact.of(resolve(scene)))
        least, most = (1.0 / device.mobility(np.array([omega]))[0] for omega in _BAND)
        if abs(most / least - 1.0) > _EXACT:
            fail("(21) is about damping that does not change with frequency: ask for the ideal circuit",
                 file=str(spec.file), key="set", value=f"{least:.4g} to {most:.4g} N s/m")  # fmt: skip
        total = float(least)
        bare = total if bare is None else bare
        period = scene.computer.period_s
        aliases = 1.0 / share_used(wall(1.0, 0.0, period), device).value
        for wall_damping in (0.0, 0.25 * total):
            closed = 2.0 * (total - wall_damping) / period
            searched = largest_passive(total, wall_damping, period)
            row = (damper, total, total - bare, wall_damping, closed, searched, searched / closed - 1.0,
                   aliases if wall_damping == 0.0 else None)  # fmt: skip
            for column, value in zip(rows.values(), row, strict=True):
                column.append(value)
        assert least_damping(device)[0] > 0.0
    return Table("dampers", "Largest passive stiffness with the circuit's damper, (21)", rows)


def _energies(spec: StudyFile, points: Points) -> tuple[Table, Table]:
    """Run a hand that lets go inside the wall, from every depth, and a drop onto it."""
    given: PassiveParameters = spec.parameters
    # the spring alone: back-EMF would only take energy up
    common = (
        "computer.method=continuous", "computer.discrete_stiffness_n_per_m=0", "effects.motor=ideal",
        f"duration_s={given.seconds!r}",
    )  # fmt: skip
    by_case = {}
    for depth in given.depths_m:
        hand = (
            f"operator={{type='hand',mass_kg=0.05,damping_n_s_per_m=0.0,stiffness_n_per_m={given.hand_n_per_m!r}"
            f",waypoints_s_m=[[0.0,0.0,{-depth!r}]]}}"
        )
        # it has let go once the run begins: its mass and damping never act
        off = ("effects.operator_dynamics=false", "effects.gravity=false")
        scene = spec.scene(*common, hand, *off, f"device.slider.origin_m=[0.0,{-depth!r}]")
        name = f"let go {1e3 * depth:g} mm deep"
        by_case[name] = points.get(name, lambda scene=scene: _taken(scene, given.every_s))  # type: ignore[misc]
    dropped = spec.scene(*common)
    by_case["dropped"] = points.get("dropped", lambda: _taken(dropped, given.every_s))
    stiffness = dropped.computer.analog_stiffness_n_per_m
    held = [1e3 * 0.5 * stiffness * row["start_m"] ** 2 for row in by_case.values()]
    energies = Table(
        "energies", "Energy taken up by the display, (20)",
        {
            "run": list(by_case),
            col.SPRING_ENERGY: [-value for value in held],
            "least taken up [mJ]": [1e3 * row["least_j"] for row in by_case.values()],
            "doubt of the ledger [mJ]": [1e3 * row["doubt_j"] for row in by_case.values()],
            "k (v T)^2/2 of its first contact [mJ]": [1e3 * row["late_j"] for row in by_case.values()],
        },
        "The display: computer, circuit and motors, without back-EMF. Dropped from rest: the first sample "
        "inside the wall switches the spring on, up to a period late.",
    )  # fmt: skip
    over_time = Table(
        "taken", "Energy taken up over time",
        {
            "run": [name for name, row in by_case.items() for _ in row["time_s"]],
            col.TIME: [t for row in by_case.values() for t in row["time_s"]],
            col.TAKEN_UP: [1e3 * value for row in by_case.values() for value in row["taken_j"]],
        },
    )  # fmt: skip
    return energies, over_time


def _taken(scene: Scene, every_s: float) -> dict[str, Any]:
    """Run a scene; return what its display took up over time, JSON-ready."""
    with (
        scratch_folder("energy") as folder,
        start_early("cosim.loop.early_imports") as child,
    ):
        result = run(resolve(scene), folder / "run", formats=(), child=child)
        signals, t = result.signals, np.asarray(result.signals["time"])
        power = np.asarray(signals["p_mot"])
        taken = -np.concatenate([[0.0], np.cumsum(0.5 * np.diff(t) * (power[1:] + power[:-1]))])
        given = delivered(signals, result.events, result.ledger)
        frame = wall_frame(scene, signals)
        depth = np.asarray(frame["penetration"])
        apart = np.append(True, np.diff(t) > 0.0)  # a jump has two rows at one time
        speed = np.interp(t, t[apart], np.gradient(depth[apart], t[apart]))
        period = scene.computer.period_s
        first = [event["time_s"] for event in result.events if event["kind"] == "contact"][:1]
        late = sum((float(np.interp(at, t, speed)) * period) ** 2 for at in first if at > 0.0)
        # after the first contact the energy taken up by switching off late hides what switching on late gave
        left = [event["time_s"] for event in result.events if event["kind"] == "release"][:1]
        least = float(taken[t <= left[0]].min() if left else taken.min())
        at = steps(scene.duration_s, every_s)
        return {
            "start_m": max(float(depth[0]), 0.0), "least_j": least, "doubt_j": given.doubt_j,
            "late_j": 0.5 * scene.computer.analog_stiffness_n_per_m * late,
            "time_s": at.tolist(), "taken_j": np.interp(at, t, taken).tolist(),
        }  # fmt: skip


def _verdicts(needed: Table, dampers: Table, energies: Table) -> list[Verdict]:
    off = max(abs(value) for value in needed.columns["difference"])
    away = max(abs(value) for value in dampers.columns["difference"])
    columns = dampers.columns
    closed, aliases = columns["2 (b + k_sd - |k_d|)/T [N/m]"], columns["by the sum over aliases [N/m]"]
    summed = max(abs(a / c - 1.0) for a, c in zip(aliases, closed, strict=True) if a is not None)
    last = max(i for i, value in enumerate(aliases) if value is not None)
    rows = list(zip(*energies.columns.values(), strict=True))
    held = [row for row in rows if row[1] < 0.0]
    text = ", ".join(f"{least:.3g} of {bound:.3g} mJ" for _, bound, least, _, _ in held)
    free = [row for row in rows if row[1] == 0.0]
    return [
        Verdict("A5", "viscosity that a sampled wall needs",
                "stiffness times half a period, plus the size of the virtual damping",
                f"by search {off:.1g} off, for {len(needed.columns['wall'])} walls", off <= _EXACT),
        Verdict("A6", "a passive hand lets go of the spring inside the wall: energy the display takes up",
                "never gives back more than the spring held", f"least {text}",
                all(least >= bound - doubt for _, bound, least, doubt, _ in held)),
        *(
            Verdict("A6", "(20) takes the spring as always on; a wall's is switched on at samples",
                    "a question",
                    f"{name} on it: {least:.3g} mJ in the first contact, where (20) says 0; at most "
                    f"the spring of a period's fall, {-late:.3g} mJ",
                    None)
            for name, _, least, _, late in free
        ),
        Verdict("A7", "largest passive stiffness with the circuit's damper",
                "twice the damping over the period, the virtual damping's size taken off",
                f"by search {away:.1g} off, by the sum over aliases {summed:.1g}; "
                f"{columns['commanded k_sd [N s/m]'][last]:g} N s/m more raise "
                f"{closed[0]:.4g} to {closed[last]:.4g} N/m", away <= _EXACT and summed <= _SUMMED),
    ]  # fmt: skip


STUDY = Study("passive", "passivity of a sampled wall, (16) to (21)", PassiveParameters, analyse)
