"""Where the time points go: points a sample and errors, one setting changed at a time. No target.

Two scenes: a slide of 5 ms samples whose exact solution is a matrix exponential, and the slope (25 ms).
"""

from __future__ import annotations

import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import expm

from benchmarks.rig import CURRENTS, Outcome, error, instants, lockstep, retold, smooth, tight
from cosim.loop import setup
from cosim.ngspice.child import Child
from cosim.plan import Plan, resolve
from cosim.scene import load_scene

_MASS, _DAMPING, _ANALOG, _DISCRETE, _PERIOD = 0.1, 0.5, 200.0, 30.0, 5e-3
_START, _MIDDLE, _END = 0.02, 0.01, 1.0
#: The first working lockstep (trapezoidal rule, acceleration held over the predicted step, ngspice's own
#: charge tolerance and restart) on the slide: longest step, reltol -> points a second, error at 1 s [m].
FIRST_VERSION = (
    (1e-4, 1e-6, 14_820, 1.5e-7),
    (1e-3, 1e-6, 5_615, 2.7e-6),
    (1e-3, 1e-3, 1_888, 7.9e-6),
)
_BOARD = """\
* one joint: force from a difference amplifier
.param v_rad=1
.param v_fs=10
.param k_fs=1
.param c_fs=1
.param v_nm=1
.param kt={analog}
.param gear=1
.param i_rated=1
.param i_limit=10
.param dac_v=10
.param dac_bits=12
.param w_rated=1
.param r_tip=1
{csparams}
.subckt board1 pot1 vel1 u1 ksp11 ksd11 cmd1 imot1 vcc vee
R1 pot1 n 10k
R2 n imot1 10k
R3 u1 p 10k
R4 p 0 10k
Gx 0 x p n 10u
Rx x 0 20G
Cx x 0 {{10u/(6.283185307*3meg)}}
Eo imot1 0 x 0 1
.ends board1
"""
_SCENE = f"""\
title = "slide"
duration_s = {_END}
[device]
board = "board1.cir"
linkage = "slider"
[device.slider]
radius_m = 1.0
mass_kg = {_MASS}
viscous_n_m_s = {_DAMPING}
direction = [1.0, 0.0]
[device.start]
q_rad = [{_START}]
[computer]
period_s = {_PERIOD}
method = "continuous"
analog_stiffness_n_per_m = 1.0
law = "law.py:Law"
[wall]
point_m = [0.0, 0.0]
normal = [1.0, 0.0]
[operator]
type = "none"
[effects]
opamp = "gbw"
viscous = true
"""
_LAW = f"""\
from cosim.loop.userlaw import Command


class Law:
    def control(self, sample):
        return Command(u_rad={_MIDDLE} - {_DISCRETE / _ANALOG} * (sample.q_rad - {_MIDDLE}))
"""


@dataclass(frozen=True)
class Setting:
    """One row of the table: what differs from the shipped settings."""

    name: str
    tolerances: dict[str, Any]
    first_step_share: float = setup.FIRST_STEP_SHARE


SETTINGS = (
    Setting(f"as shipped (first step behind a jump {setup.FIRST_STEP_SHARE:g} of the longest)", {}),
    Setting("charge tolerance 1e-14 C (ngspice's own) instead of 1e-9", {"charge_c": 1e-14}),
    Setting(
        "first step behind a jump 1/100 of the longest (within a ramp never above a third of it)", {}, 1e-2
    ),
    Setting("first step behind a jump 1/10 of the longest", {}, 1e-1),
    Setting("trapezoidal rule instead of Gear's", {"method": "trap"}),
    Setting("longest step 1 ms instead of 2 ms", {"max_step_s": 1e-3}),
    Setting("longest step 4 ms", {"max_step_s": 4e-3}),
    Setting("longest step 100 us", {"max_step_s": 1e-4}),
    Setting("rtol 1e-3 instead of 1e-4", {"rtol": 1e-3}),
    Setting("rtol 1e-5", {"rtol": 1e-5}),
    Setting("coupling tolerance 1e-6 rad instead of 1e-7", {"coupling_rad": 1e-6}),
    Setting("coupling tolerance 1e-9 rad", {"coupling_rad": 1e-9}),
)


def slide_plan(folder: Path) -> Plan:
    """Write the slide's board, law and scene and return its plan."""
    names = [line.split()[1].partition("=")[0] for line in _BOARD.splitlines() if line.startswith(".param")]
    csparams = "\n".join(f".csparam {name}={{{name}}}" for name in names)
    (folder / "board1.cir").write_text(_BOARD.format(analog=_ANALOG, csparams=csparams), encoding="utf-8")
    (folder / "law.py").write_text(_LAW, encoding="utf-8")
    (folder / "slide.toml").write_text(_SCENE, encoding="utf-8")
    return resolve(load_scene(folder / "slide.toml"))


def exact_slide() -> NDArray[np.float64]:
    """Return the positions [m] of the slide at its samples 1, 2, ..., with an ideal amplifier."""
    rates = np.array([[0, 1, 0], [-_ANALOG / _MASS, -_DAMPING / _MASS, _ANALOG / _MASS], [0, 0, 0]])
    move = expm(rates * _PERIOD)
    state, places = np.array([_START, 0.0]), []
    for _ in range(round(_END / _PERIOD)):
        target = _MIDDLE - _DISCRETE / _ANALOG * (state[0] - _MIDDLE)
        state = (move @ np.array([*state, target]))[:2]
        places.append(state[0])
    return np.array(places)


def rows(payload: dict[str, Any], report: Any) -> list[tuple[str, float, float]]:
    """Run a plan with every setting: (name, points a sample, error); called in a simulation's process."""
    plan: Plan = payload["plan"]
    exact = payload["exact"]
    times = instants(plan)
    reference = None if exact is not None else lockstep(tight(plan), keep=True)
    out = []
    for setting in SETTINGS:
        setup.FIRST_STEP_SHARE = setting.first_step_share
        run = lockstep(retold(plan, **setting.tolerances), keep=True)
        setup.FIRST_STEP_SHARE = SETTINGS[0].first_step_share
        if reference is None:
            wrong = float(np.abs(np.interp(times, run.signals["time"], run.signals["q1"]) - exact).max())
        else:
            wrong = error(run.signals, reference.signals, CURRENTS, times)
        out.append((setting.name, run.stats["points"] / len(times), wrong))
    return out


def coupling_order() -> list[tuple[str, float, float]]:
    """Compare predictors on the slope, by the Python twin of the lockstep: (name, points a sample, error)."""
    plan = smooth()
    times = instants(plan)
    out = []
    with Child() as compiled, Child() as plain:
        truth = Outcome(**compiled.call("benchmarks.sides:lockstep_run", {"plan": tight(plan)}))
        for order in (2, 1):
            payload = {"plan": plan, "constants": truth.constants, "order": order}
            run = Outcome(**plain.call("benchmarks.pyspice:run", payload))
            wrong = error(run.signals, truth.signals, CURRENTS, times)
            what = (
                "slope extrapolated, parabola corrects" if order == 2 else "acceleration held, line corrects"
            )
            out.append((f"predictor: {what}", run.stats["points"] / len(times), wrong))
    return out


def anatomy() -> str:
    """Return both tables as text."""
    with tempfile.TemporaryDirectory(prefix="cosim-bench-") as name, Child() as child:
        slide = slide_plan(Path(name))
        first = child.call("benchmarks.anatomy:rows", {"plan": slide, "exact": exact_slide()})
        second = child.call("benchmarks.anatomy:rows", {"plan": smooth(), "exact": None})
    samples = round(_END / _PERIOD)
    lines = [
        "anatomy: slide, 5 ms a sample; largest error at the samples [m] of 2e-2 "
        "(4e-7 of it is the amplifier's own delay, which the exact solution leaves out)"
    ]
    lines += [
        f"  {points / samples:6.1f} points a sample, error {wrong:.2g}   first version, longest step "
        f"{1e6 * longest:g} us, reltol {rtol:g} (error at the end)"
        for longest, rtol, points, wrong in FIRST_VERSION
    ]
    lines += [_row(*row) for row in first]
    lines += [
        "anatomy: slope, 25 ms a sample, no rounding; largest error of the currents at the samples, relative"
    ]
    lines += [_row(*row) for row in (*second, *coupling_order())]
    return "\n".join(lines)


def _row(name: str, points: float, wrong: float) -> str:
    return f"  {points:6.1f} points a sample, error {wrong:.2g}   {name}"
