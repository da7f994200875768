"""A hand traces a wall (Figs 15 to 18): methods side by side, and the same with the circuit ideal.

The first run is the reference of the sink; runs named as the circuit-ideal partner of another one answer
footnote 1 in the experiment itself: what the circuit's dynamics changed. The second half of footnote 1 - the
torques make the force that J^-T tau says, quasi-statically - is answered by the error of that force against
the acceleration of the tip.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any

import numpy as np

from cosim.accuracy.tolerance_control import parse_tolerances, run_within
from cosim.errors import fail
from cosim.measures import wall_frame
from cosim.ngspice.child import Child, start_early
from cosim.plan import resolve
from cosim.results import Run
from cosim.runner import run
from cosim.scene.mechanism import mechanism
from cosim.scene.parameters import Field, Parameters, Unit, Variation
from cosim.storage.checkpoint import Points
from cosim.storage.staging import scratch_folder
from cosim.studies import table_columns as col
from cosim.studies.case_effects import in_words
from cosim.studies.grid import steps
from cosim.studies.study import Study, StudyFile, StudyResult, Table, Verdict
from cosim.types import Array

__all__ = ["SINK", "STUDY", "quasi_static", "traced", "verdicts"]


#: Sink at equal force of 133 + 100 N/m over that of 133 N/m, the paper's two stiffnesses, and how far off it
#: may be.
SINK, _SINK_OFF = 0.571, 0.05
#: |F_t/F_n| from which a method counts as one that drags along the wall.
_DRAGS = 0.1
#: Signals kept for the pictures, by what the picture calls them.
_SHOWN = (col.TIME, col.NORMAL_FORCE, col.TANGENTIAL_FORCE, col.DEPTH, col.ALONG_THE_WALL)


class Traced(Variation):
    """One run.

    `ideal_of` is the run whose circuit it makes ideal, `all_of` the one to which it adds effects: neither is
    a method of its own.
    """

    ideal_of: str | None = None
    all_of: str | None = None

    @property
    def beside(self) -> str | None:
        """The run that it stands beside."""
        return self.ideal_of or self.all_of


class TraceParameters(Parameters):
    """``[parameters]`` of the traces."""

    runs: tuple[Traced, ...] = Field(min_length=1)
    every_s: Annotated[float, Field(gt=0, le=1), Unit("s")] = 1e-3


def quasi_static(result: Run, every_s: float) -> dict[str, Array]:
    """Return the error of the quasi-static force along the normal, and what explains it.

    Returns
    -------
    dict
        'error': force of the device on the hand less the motors' J^-T tau [N]; 'acceleration' of the tip
        [m/s^2]; 'inertia': what M q'' + h of the arm take from the motors' force [N]
    """
    scene, signals = result.scene, result.signals
    assert scene.wall is not None
    linkage = mechanism(scene, float(result.plan["constants"]["gear"]))
    normal, n = np.array(scene.wall.normal), scene.joints
    frame = wall_frame(scene, signals)
    t = np.asarray(signals["time"])
    at = steps(scene.duration_s, every_s)
    q, v = (np.column_stack([np.interp(at, t, signals[f"{k}{j}"]) for j in range(1, n + 1)]) for k in "qv")
    jacobians = [linkage.jacobian(pose) for pose in q]
    speed = np.array([normal @ jac @ rate for jac, rate in zip(jacobians, v, strict=True)])
    acceleration = np.gradient(speed, every_s)
    turning = np.gradient(v, every_s, axis=0)
    inertia = np.array(
        [
            normal
            @ np.linalg.lstsq(jac.T, linkage.mass_matrix(pose) @ a + linkage.bias(pose, rate), rcond=None)[0]
            for jac, pose, rate, a in zip(jacobians, q, v, turning, strict=True)
        ]
    )
    error = np.interp(at, t, frame["normal"] - frame["push"])
    # a mean over two intervals is meaningless where the acceleration jumps
    calm = np.abs(np.diff(acceleration, append=acceleration[-1])) < 0.2 * np.abs(acceleration).max()
    inside = calm & (np.interp(at, t, frame["penetration"]) > 0.0)
    return {"error": error[inside], "acceleration": acceleration[inside], "inertia": -inertia[inside]}


def traced(spec: StudyFile, given: Traced, every_s: float, child: Child | None = None) -> dict[str, Any]:
    """Run one trace; return its measures and the signals of the pictures on an even grid, JSON-ready."""
    scene = spec.scene(*given.set)
    if scene.wall is None:
        fail("a trace needs a wall", file=str(spec.scene_file), key="wall")
    with scratch_folder("trace") as folder:
        plan, place = resolve(scene), folder / "run"
        if spec.tolerances:  # of each run; the model stays that of the study
            wanted = parse_tolerances(spec.tolerances)
            result = run_within(plan, place, wanted, free=False, child=child, formats=())
        else:
            result = run(plan, place, formats=(), child=child)
        frame = wall_frame(scene, result.signals)
        t = np.asarray(result.signals["time"])
        at = steps(scene.duration_s, every_s)
        shown = (frame["normal"], frame["tangent"], 1e3 * frame["penetration"], 1e3 * frame["along"])
        held = quasi_static(result, every_s)
        return {
            "measures": {name: row["value"] for name, row in result.measures.items()},
            "model": result.plan["model"],
            "effects": [in_words(row["name"], row["value"]) for row in result.plan["effects"]],
            "seconds": result.stats["wall_s"],
            "signals": {
                _SHOWN[0]: at.tolist(),
                **{k: np.interp(at, t, y).tolist() for k, y in zip(_SHOWN[1:], shown, strict=True)},
            },
            "quasi_static": {
                "error_n": held["error"].tolist(), "acceleration_m_per_s2": held["acceleration"].tolist(),
                "inertia_n": held["inertia"].tolist(),
            },
        }  # fmt: skip


def analyse(spec: StudyFile, points: Points) -> StudyResult:
    """Run every trace; judge the sink (F16/17), the drag (F18) and footnote 1 in the experiment."""
    given: TraceParameters = spec.parameters
    names = [one.name for one in given.runs]
    for one in given.runs:
        for key, other in (("ideal_of", one.ideal_of), ("all_of", one.all_of)):
            if other is not None and other not in names:
                fail("no such run", file=str(spec.file), key=f"parameters.runs.{key}", value=other)
    points.expect(len(names))
    with start_early("cosim.loop.early_imports") as child:
        traces = {
            one.name: points.get(one.name, lambda one=one: traced(spec, one, given.every_s, child))  # type: ignore[misc]
            for one in given.runs
        }
    measures = ("steady_penetration", "steady_normal_force", "tangential_ratio", "force_ripple", "headroom")
    table = Table(
        "runs", "Runs side by side",
        {
            "run": names,
            col.IDEAL_OF: [one.ideal_of for one in given.runs],
            col.ALL_OF: [one.all_of for one in given.runs],
            "circuit": [traces[name]["model"] for name in names],
            col.DEPTH: [1e3 * traces[name]["measures"]["steady_penetration"] for name in names],
            col.NORMAL_FORCE: [traces[name]["measures"]["steady_normal_force"] for name in names],
            "rendered stiffness [N/m]": [
                traces[name]["measures"].get("rendered_stiffness") for name in names
            ],
            "F_t/F_n": [traces[name]["measures"].get(measures[2]) for name in names],
            "ripple of the force [N]": [traces[name]["measures"].get(measures[3]) for name in names],
            col.TIME: [traces[name]["seconds"] for name in names],
            "effects in force": [", ".join(traces[name]["effects"]) for name in names],
        },
        "Depth and forces: means over the last fifth of the run.",
    )  # fmt: skip
    signals = Table(
        "signals", "Force and place over time",
        {"run": [name for name in names for _ in traces[name]["signals"][_SHOWN[0]]]}
        | {key: [v for name in names for v in traces[name]["signals"][key]] for key in _SHOWN},
    )  # fmt: skip
    quasi = Table(
        "quasi_static", "Force of J^-T tau against the force at the hand",
        {
            "run": [name for name in names for _ in traces[name]["quasi_static"]["error_n"]],
            col.ACCELERATION: [
                v for name in names for v in traces[name]["quasi_static"]["acceleration_m_per_s2"]
            ],
            col.ERROR_FORCE: [v for name in names for v in traces[name]["quasi_static"]["error_n"]],
            "inertia of the arm [N]": [
                v for name in names for v in traces[name]["quasi_static"]["inertia_n"]
            ],
        },
    )  # fmt: skip
    return spec.result(table, signals, quasi, verdicts=verdicts(given, traces))


def verdicts(given: TraceParameters, traces: dict[str, Any]) -> list[Verdict]:
    """Judge runs by name, as `traced` returns them; the first is the reference."""
    out = []
    first = given.runs[0].name
    base = traces[first]["measures"]
    for one in given.runs[1:]:
        mine = traces[one.name]["measures"]
        if one.beside is None and mine["tangential_ratio"] < _DRAGS:
            ratio = (mine["steady_penetration"] / mine["steady_normal_force"]) / (
                base["steady_penetration"] / base["steady_normal_force"]
            )
            wanted = base["rendered_stiffness"] / mine["rendered_stiffness"]
            out.append(
                Verdict("F16/17", f"shallower sink: {one.name}", f"{SINK:g} of it at equal force",
                        f"{ratio:.3f}; by the motors' stiffness {wanted:.3f}",
                        abs(ratio / SINK - 1.0) < _SINK_OFF)
            )  # fmt: skip
        if one.beside is None and mine["tangential_ratio"] >= _DRAGS:
            out.append(
                Verdict("F18", f"{one.name} drags along the wall",
                        "force along the wall over its normal far above that of coupled gains",
                        f"{mine['tangential_ratio']:.3g} against {base['tangential_ratio']:.2g}",
                        mine["tangential_ratio"] > 10 * base["tangential_ratio"])
            )  # fmt: skip
        if one.all_of is not None:
            out.append(_everything(one, mine, traces[one.all_of]["measures"]))
        if one.ideal_of is not None:
            full = traces[one.ideal_of]["signals"]
            change = [np.abs(np.subtract(traces[one.name]["signals"][key], full[key])) for key in _SHOWN[1:]]
            peak = float(np.abs(full[_SHOWN[1]]).max())
            text = (
                f"largest change: normal {1e3 * change[0].max():.3g} mN of {peak:.3g} N, "
                f"tangential {1e3 * change[1].max():.3g} mN; depth {1e3 * change[2].max():.3g} um, "
                f"along {1e3 * change[3].max():.3g} um"
            )
            out.append(
                Verdict("N1", f"footnote 1 in the experiment: {one.ideal_of}", "a question", text, None)
            )
    held = traces[first]["quasi_static"]
    error, inertia = np.array(held["error_n"]), np.array(held["inertia_n"])
    mass = -float(error @ held["acceleration_m_per_s2"]) / float(
        np.square(held["acceleration_m_per_s2"]).sum()
    )
    left = float(np.sqrt(np.mean((error - inertia) ** 2) / np.mean(error**2)))
    text = (
        f"up to {np.abs(error).max():.2g} N, about {mass:.2g} kg times the tip's acceleration; inertia "
        f"and Coriolis forces of the arm explain all but {100 * left:.0f} %"
    )
    out.append(
        Verdict(
            "N2",
            "the motors' torques are the force at the hand, quasi-statically",
            "errs by inertia and Coriolis forces of the arm",
            text,
            left < 0.2,
        )
    )
    return out


def _everything(one: Traced, mine: Mapping[str, float], plain: Mapping[str, float]) -> Verdict:
    """Compare a run with the same run under more effects."""

    def change(name: str) -> str:
        return f"{mine[name]:.3g} for {plain[name]:.3g}"

    text = (
        f"rendered {change('rendered_stiffness')} N/m, depth {1e3 * mine['steady_penetration']:.3g} for "
        f"{1e3 * plain['steady_penetration']:.3g} mm at {change('steady_normal_force')} N, along over "
        "normal force "
        f"{change('tangential_ratio')}, ripple {1e3 * mine['force_ripple']:.3g} for "
        f"{1e3 * plain['force_ripple']:.3g} mN"
    )
    return Verdict(
        "N1", f"what the plain run leaves out: {one.name}, beside {one.all_of}", "a question", text, None
    )


STUDY = Study(
    "trace", "a hand traces the wall: methods side by side", TraceParameters, analyse, no_tolerance=""
)
