"""Our time loop against general stiff solvers on one linear system, at equal accuracy.

The system is the drop: board with every pole that was extracted, slider and mass; the converters hold
their voltages over a period and jump at the samples, so that each period is z' = A z + b. The peers get A, b
and the Jacobian ready made and restart at each sample; our loop also computes the samples. The truth is
SciPy's matrix exponential of each period.
"""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import odeint, solve_ivp
from scipy.linalg import expm

from benchmarks.figure import Figure, figure, interleaved
from benchmarks.models import Prepared, model, packed, scene, signals
from benchmarks.rig import lockstep, retold
from cosim.circuits.linear_circuit import LinearCircuit
from cosim.loop.events import begin
from cosim.loop.linear.run_linear import Propagation, prepare, rest
from cosim.ngspice.child import Child
from mech.kernels import dynamics

Array = NDArray[np.float64]
Report = Callable[[dict[str, Any]], None]
Solver = Callable[["System", float], Array]
#: Length of the run [s]: fifty sampling periods, most of them in contact.
DURATION_S = 0.5
ACCURACY = 1e-8
#: Tolerances of the peers and of ours [rad], the loosest first.
PEER_TOLERANCES = tuple(share * 10.0**-k for k in range(5, 12) for share in (1.0, 0.3))
OUR_TOLERANCES = tuple(share * 10.0**-k for k in range(6, 14) for share in (1.0, 0.3))


@dataclass
class System:
    """A linear system that changes at the samples: z' = A z + b over each period, y = C z + d.

    Attributes
    ----------
    a, b : [periods] matrices and vectors; equal matrices are one object
    c, d : [periods] outputs: angle, speed and motor current
    z0 : start; scale : largest size of each state, for absolute tolerances
    """

    period_s: float
    a: list[Array]
    b: list[Array]
    c: list[Array]
    d: list[Array]
    z0: Array
    scale: Array

    def outputs(self, z: Array) -> Array:
        """Return angle, speed and current at the end of each period, from the states there."""
        return np.array([c @ x + d for c, d, x in zip(self.c, self.d, z, strict=True)])

    def exact(self) -> Array:
        """States at the end of each period."""
        size = len(self.z0)
        maps: dict[tuple[int, bytes], Array] = {}
        out, z = np.zeros((len(self.a), size)), self.z0
        for k, (a, b) in enumerate(zip(self.a, self.b, strict=True)):
            key = (id(a), b.tobytes())
            if key not in maps:
                block = np.zeros((size + 1, size + 1))
                block[:size, :size], block[:size, size] = a, b
                maps[key] = expm(block * self.period_s)
            z = maps[key][:size, :size] @ z + maps[key][:size, size]
            out[k] = z
        return out


def mechanics(run: Propagation) -> tuple[float, float, float, float]:
    """Return the acceleration of the slider as a0 + aq q + av v + at tau; it is affine."""
    s = run.memory.state[0]
    slopes = np.zeros(s["a"].shape)

    def at(q: float, v: float, tau: float) -> float:
        zeros = np.zeros((3, len(slopes)))
        zeros[:, 0] = q, v, tau
        dynamics(s["p"], s["op"], 0.0, zeros[0], zeros[1], zeros[2], slopes, s["w"])
        return float(slopes[0])

    a0 = at(0.0, 0.0, 0.0)
    return a0, at(1.0, 0.0, 0.0) - a0, at(0.0, 1.0, 0.0) - a0, at(0.0, 0.0, 1.0) - a0


def system(run: Propagation, table: dict[str, Array]) -> System:
    """Write a one-joint run out as matrices, its converters' voltages taken from the rows in `table`."""
    circuit, fresh = run.circuit, run.memory.state[0]
    period, end = float(fresh["c"]["period"]), float(fresh["t_end"])
    starts = np.arange(round(end / period)) * period
    behind = np.searchsorted(table["time"], starts + 1e-6 * period)
    volts = {name: values[behind] for name, values in table.items() if name in run.memory.drive.channels}
    silent = np.zeros(len(starts))
    u, cmd = volts.get("u1", silent), volts.get("cmd1", silent)
    gains = np.column_stack([volts.get(name, silent) for name in ("ksp11", "ksd11")])
    parts = {tuple(g): _matrices(circuit, run, circuit.gain * g) for g in gains}
    a, b, c, d = [], [], [], []
    for g, command, equilibrium in zip(gains, cmd, u, strict=True):
        state, drive, out, through = parts[tuple(g)]
        inputs = np.array([1.0, equilibrium, command])
        a.append(state)
        b.append(drive @ inputs)
        c.append(out)
        d.append(through @ inputs)
    begin(fresh)
    z0 = np.concatenate([rest(circuit, fresh), fresh["q"][:1], fresh["v"][:1]])
    made = System(period, a, b, c, d, z0, np.ones(len(z0)))
    made.scale = np.abs(np.vstack([z0, made.exact()])).max(axis=0)
    return made


def _matrices(circuit: LinearCircuit, run: Propagation, gain: Array) -> tuple[Array, Array, Array, Array]:
    """Return A, B, C, D of the whole with inputs 1, u and cmd, and outputs q, v and the motor current."""
    s = run.memory.state[0]
    gear, torque = float(s["gear"]), float(s["torque_per_amp"][0])
    a0, aq, av, at = mechanics(run)
    before, after, m = len(circuit.a_pre), len(circuit.a_post), len(gain)
    size = before + after + 2
    q, v = before + after, before + after + 1
    # columns: states, then 1, u, cmd
    x = np.zeros((m, size + 3))
    x[:, :before], x[:, q], x[:, v] = circuit.c_pre, circuit.d_pre[:, 0], circuit.e_pre[:, 0]
    x[:, size + 1] = circuit.d_pre[:, 1]
    into = np.zeros((m + 2, size + 3))
    into[:m] = gain[:, None] * x
    into[m, size + 2], into[m + 1, v] = 1.0, gear
    current = circuit.d_post @ into
    current[:, before : before + after] += circuit.c_post
    current[0, size] += circuit.offset[0]
    rate = np.zeros((size, size + 3))
    rate[:before, :before], rate[:before, q] = circuit.a_pre, circuit.b_pre[:, 0]
    rate[:before, size + 1] = circuit.b_pre[:, 1]
    rate[before : before + after] = circuit.b_post @ into
    rate[before : before + after, before : before + after] += circuit.a_post
    rate[q, v] = 1.0
    rate[v] = at * torque * current[0]
    rate[v, q] += aq
    rate[v, v] += av
    rate[v, size] += a0
    out = np.zeros((3, size + 3))
    out[0, q], out[1, v], out[2] = 1.0, 1.0, current[0]
    return rate[:, :size].copy(), rate[:, size:], out[:, :size], out[:, size:]


def _by_period(system: System, step: Callable[[Array, Array, Array], Array]) -> Array:
    out, z = np.zeros((len(system.a), len(system.z0))), system.z0
    for k, (a, b) in enumerate(zip(system.a, system.b, strict=True)):
        z = out[k] = step(a, b, z)
    return out


def radau(system: System, rtol: float) -> Array:
    """Return the states by SciPy's Radau, implicit Runge-Kutta of order 5."""
    span, atol = (0.0, system.period_s), rtol * system.scale
    return _by_period(
        system,
        lambda a, b, z: solve_ivp(
            lambda t, y: a @ y + b, span, z, "Radau", t_eval=span[1:], jac=a, rtol=rtol, atol=atol
        ).y[:, -1],
    )


def lsoda(system: System, rtol: float) -> Array:
    """Return the states by LSODA, whose steps SciPy's `odeint` takes in compiled code."""
    span, atol = [0.0, system.period_s], rtol * system.scale
    return _by_period(
        system,
        lambda a, b, z: odeint(
            lambda y, t: a @ y + b, z, span, Dfun=lambda y, t: a, rtol=rtol, atol=atol, mxstep=100_000
        )[-1],
    )


def sundials() -> dict[str, Solver]:
    """Return CVODE and IDA (BDF, dense Jacobian) by name, where scikit-sundae is installed."""
    try:
        from sksundae.cvode import CVODE  # type: ignore[import-not-found,unused-ignore]
        from sksundae.ida import IDA  # type: ignore[import-not-found,unused-ignore]
    except ImportError:
        return {}

    def cvode(system: System, rtol: float) -> Array:
        span, atol = np.array([0.0, system.period_s]), rtol * system.scale

        def step(a: Array, b: Array, z: Array) -> Array:
            def rate(t: float, y: Array, out: Array) -> None:
                np.dot(a, y, out)
                out += b

            def jacobian(t: float, y: Array, rates: Array, out: Array) -> None:
                out[:] = a

            solver = CVODE(
                rate, method="BDF", rtol=rtol, atol=atol, linsolver="dense", jacfn=jacobian,
                max_num_steps=100_000,
            )  # fmt: skip
            return np.asarray(solver.solve(span, z).y[-1], np.float64)

        return _by_period(system, step)

    def ida(system: System, rtol: float) -> Array:
        span, atol = np.array([0.0, system.period_s]), rtol * system.scale

        def step(a: Array, b: Array, z: Array) -> Array:
            def residual(t: float, y: Array, rate: Array, out: Array) -> None:
                np.subtract(rate, a @ y + b, out)

            def jacobian(t: float, y: Array, rate: Array, rest: Array, c: float, out: Array) -> None:
                out[:] = -a
                out[np.diag_indices_from(out)] += c

            solver = IDA(
                residual, rtol=rtol, atol=atol, linsolver="dense", jacfn=jacobian, max_num_steps=100_000
            )
            return np.asarray(solver.solve(span, z, a @ z + b).y[-1], np.float64)

        return _by_period(system, step)

    return {"CVODE": cvode, "IDA": ida}


def _error(computed: Array, truth: Array) -> float:
    return float((np.abs(computed - truth).max(axis=0) / np.abs(truth).max(axis=0)).max())


def _seconds(call: Callable[[], Any]) -> float:
    begun = time.perf_counter()
    call()
    return time.perf_counter() - begun


def compare(payload: dict[str, Any], report: Report) -> dict[str, Any]:
    """Find tolerances of equal accuracy and time all solvers in turn."""
    plan = scene("drop", "effects.dac=false", "effects.dac_settling=false", f"duration_s={DURATION_S!r}")
    constants = lockstep(retold(plan)).constants
    assert constants is not None
    circuit = model(plan, "linear", 0.0)
    table = signals(packed(plan, constants, circuit, OUR_TOLERANCES[-1]))
    ready = prepare(plan.scene, constants, circuit, record=False)
    system_of_scene = system(ready, table)
    truth = system_of_scene.outputs(system_of_scene.exact())
    instants = system_of_scene.period_s * np.arange(1, len(system_of_scene.a) + 1)

    def ours(tol: float) -> float:
        got = signals(packed(plan, constants, circuit, tol))
        return _error(
            np.column_stack([np.interp(instants, got["time"], got[name]) for name in ("q1", "v1", "imot1")]),
            truth,
        )

    own = {tol: ours(tol) for tol in OUR_TOLERANCES}
    fit = [tol for tol in OUR_TOLERANCES if own[tol] <= ACCURACY]
    if not fit:
        raise RuntimeError(f"our errors are {own}")
    installed = sundials()
    peers: dict[str, Solver] = {"LSODA": lsoda, "Radau": radau, **installed}
    chosen: dict[str, tuple[float, float]] = {}
    for name, solver in peers.items():
        for rtol in PEER_TOLERANCES:
            off = _error(system_of_scene.outputs(solver(system_of_scene, rtol)), truth)
            report({"time_s": rtol})
            if off <= ACCURACY:
                chosen[name] = rtol, off
                break
    if not chosen:
        raise RuntimeError(f"no solver is within {ACCURACY:g}")

    def timed(name: str) -> Callable[[], float]:
        return lambda: _seconds(lambda: peers[name](system_of_scene, chosen[name][0]))

    own_run = Prepared(plan, constants, circuit, fit[0])
    walls = interleaved(
        payload["repetitions"],
        own_run.seconds,
        *(timed(name) for name in chosen),
    )
    times = dict(zip(chosen, walls[1:], strict=True))
    best = min(times, key=lambda name: statistics.median(times[name]))
    rates = np.abs(np.linalg.eigvals(system_of_scene.a[-1]))
    return {
        "walls": (walls[0], times[best]),
        "errors": (own[fit[0]], chosen[best][1]),
        "best": best,
        "our_tolerance_rad": fit[0],
        "our_errors": {f"{tol:.0e}": off for tol, off in own.items()},
        "profile": own_run.profile(),
        "states": len(system_of_scene.z0),
        "fastest_pole_rad_per_s": float(rates.max()),
        "periods": len(system_of_scene.a),
        "solvers": [
            {
                "solver": name,
                "ms": 1e3 * statistics.median(times[name]) if name in times else "-",
                "rtol": chosen[name][0] if name in chosen else "none is accurate enough",
                "error": chosen[name][1] if name in chosen else "-",
            }
            for name in peers
        ],
        "absent": "none" if installed else "SUNDIALS: scikit-sundae is not installed",
    }


def solvers(repetitions: int) -> list[Figure]:
    """Compare with the fastest of the stiff solvers."""
    with Child() as child:
        got = child.call("benchmarks.stiff:compare", {"repetitions": repetitions})
    ours, peer = got.pop("walls")
    own, theirs = got.pop("errors")
    got["ratio_from_nothing"] = 1e-3 * got["profile"]["from_nothing_ms"] / statistics.median(peer)
    got["ratio_of_fastest"] = min(ours) / min(peer)
    details = got | {"ours_ms": 1e3 * statistics.median(ours), "peer_ms": 1e3 * statistics.median(peer)}
    return [
        figure(
            "linear_vs_stiff_solvers",
            [a / b for a, b in zip(ours, peer, strict=True)],
            error_ours=own,
            error_peer=theirs,
            error_unit="of the largest angle, speed or current; both against matrix exponentials",
            details=details,
        )
    ]
