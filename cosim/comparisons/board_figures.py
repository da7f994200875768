"""Every figure of a board and of its run, with a readable name, for comparisons side by side."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from cosim.checking.check import Check
from cosim.checking.loops import Loop
from cosim.circuits.linear_circuit import LinearCircuit
from cosim.comparisons.dissipation import Dissipation
from cosim.results import Run
from cosim.units import quantity

#: Sections in the order in which they are shown.
SECTIONS = (
    "measures",
    "gains",
    "paths",
    "poles",
    "bounds",
    "loops",
    "headroom",
    "noise",
    "dissipation",
    "out of contact",
)
_CONSTANTS = {
    "v_rad": "equilibrium command",
    "k_fs": "spring at full-scale gain",
    "c_fs": "damper at full-scale gain",
    "v_nm": "torque command",
    "w_rated": "multiplier output at rated torque",
}
_PATHS = {
    "u": "spring, from the equilibrium command",
    "pot": "spring, from the potentiometer",
    "rate": "damper",
    "cmd": "torque command",
}


@dataclass(frozen=True)
class Figure:
    """One number: where it belongs, what it is, of which place on the board, in which unit.

    `part` is the part at that place: with another part there it is still the same figure.
    """

    section: str
    quantity: str
    place: str
    unit: str
    value: float | None
    part: str = ""

    @property
    def key(self) -> tuple[str, str, str]:
        """What makes it the same figure on another board."""
        return self.section, self.quantity, self.place


def of_measures(measures: Mapping[str, Mapping[str, Any]]) -> Iterator[Figure]:
    """Yield measures; how well a run's energy balance closes belongs to the solver, not to the board."""
    for name, row in measures.items():
        if name == "ledger_closure":
            continue
        yield Figure("measures", name.replace("_", " "), "", str(row["unit"]), float(row["value"]))


def of_dissipation(rows: list[Dissipation]) -> Iterator[Figure]:
    """Yield the heat of motors and drivers."""
    for row in rows:
        place = f"motor {row.joint}"
        yield Figure("dissipation", "heat of the winding, mean", place, "W", row.motor_mean_w)
        yield Figure("dissipation", "heat of the winding, peak", place, "W", row.motor_peak_w)
        yield Figure("dissipation", "heat of the driver, mean", place, "W", row.driver_mean_w)
        yield Figure("dissipation", "heat of the driver, peak", place, "W", row.driver_peak_w)


def of_circuit(circuit: LinearCircuit) -> Iterator[Figure]:
    """Yield the poles and bounds of a board's small-signal model, unreduced."""
    poles = circuit.poles
    yield Figure("poles", "poles of the signal paths", "", "", float(len(poles)))
    if len(poles):
        hz = np.abs(poles) / (2 * np.pi)
        yield Figure("poles", "slowest pole", "", "Hz", float(hz.min()))
        yield Figure("poles", "fastest pole", "", "Hz", float(hz.max()))
        yield Figure(
            "poles", "least damping ratio of a pole", "", "", float((-poles.real / np.abs(poles)).min())
        )
    neglect = circuit.certificate.get("footnote_1", {})
    for path, share in neglect.get("error", {}).items():
        shown = f"error of DC gains up to {quantity(neglect['band_hz'], 'Hz', 4)} over the path's largest"
        yield Figure("bounds", shown, str(path).replace("_", "-"), "", share)
    worst = float(circuit.certificate["control_nonlinearity"])
    yield Figure("bounds", "nonlinearity of a gain, of full scale", "", "%", 100.0 * worst)


def of_reduced(circuit: LinearCircuit) -> Iterator[Figure]:
    """Yield the poles that a run's reduced model keeps, and the bound on its error."""
    yield Figure("bounds", "states that the linear model keeps", "", "", float(circuit.order))
    if "error" in circuit.certificate:
        band = circuit.certificate["band_hz"]
        error = 100.0 * float(circuit.certificate["error"])
        yield Figure(
            "bounds", f"error of that model up to {quantity(band, 'Hz', 4)}, at most", "", "%", error
        )


def of_check(check: Check) -> Iterator[Figure]:
    """Yield what `cosim check` measures on a board."""
    measured = check.measured
    for c in measured.constants:
        place = f"motor {c.where[0]} from joint {c.where[1]}" if len(c.where) == 2 else f"joint {c.where}"
        yield Figure("gains", _CONSTANTS.get(c.name, c.name), place, c.unit, c.measured)
    for p in measured.paths:
        place = f"joint {p.joint}"
        yield Figure("paths", f"{_PATHS.get(p.kind, p.kind)}: delay", place, "s", p.delay_s)
        yield Figure("paths", f"{_PATHS.get(p.kind, p.kind)}: bandwidth", place, "Hz", p.bandwidth_hz)
    for b in measured.brakes:
        place = f"joint {b.joint}"
        yield Figure("paths", "viscosity from back-EMF", place, "N m s/rad", b.viscosity_n_m_s)
        if b.eta is not None:
            yield Figure("paths", "viscosity that the spring's delay eats", place, "%", 100 * b.eta)
        if b.stiffness_n_per_m is not None:
            yield Figure("paths", "stiffness whose delay eats all of it", place, "N/m", b.stiffness_n_per_m)
    for loop in measured.loops:
        yield from _of_loop(loop)
    yield from _of_headroom(check)
    for n in measured.noise:
        gains = n.gains.replace("k_fs", "full scale").replace("c_fs", "full scale")
        yield Figure("noise", f"noise of the circuit, {gains}", f"motor {n.joint}", "N", n.force_n)
    for pot in measured.pot_noise:
        place = f"joint {pot.joint}"
        yield Figure(
            "noise", "noise of the potentiometer through the spring at full scale", place, "N", pot.spring_n
        )
        yield Figure(
            "noise", "noise of the potentiometer through the damper at full scale", place, "N", pot.damper_n
        )
    for r in measured.rest:
        place = f"motor {r.joint}"
        yield Figure("out of contact", "force", place, "N", r.force_n)
        yield Figure("out of contact", "spring left", place, "N/m", r.leak_n_per_m)
        yield Figure("out of contact", "damper left", place, "N s/m", r.leak_n_s_per_m)


def _of_loop(loop: Loop) -> Iterator[Figure]:
    place = part_name(loop.path) + (", current loop" if loop.kind == "motor" else "")
    yield Figure("loops", "crossover", place, "Hz", loop.crossover_hz, loop.part)
    yield Figure("loops", "phase margin", place, "deg", loop.phase_margin_deg, loop.part)
    yield Figure("loops", "gain margin", place, "dB", loop.gain_margin_db, loop.part)


def _of_headroom(check: Check) -> Iterator[Figure]:
    headroom = check.measured.headroom
    for s in headroom.swings:
        shown = "left of the output limit at rated torque"
        yield Figure("headroom", shown, part_name(s.path), "%", s.headroom_percent, s.part)
    for speed in headroom.speeds:
        quantity = "speed at which the damper at full scale clips"
        yield Figure("headroom", quantity, f"joint {speed.joint}", "rad/s", speed.speed_rad_per_s)
    for motor, limit in enumerate(headroom.limits_a, 1):
        yield Figure("headroom", "most current, all driven to the end", f"motor {motor}", "A", limit)
    for case in headroom.cases:
        if case.current_a is not None:
            quantity = "current where rated torque is asked for"
            yield Figure(
                "headroom", quantity, case.name.replace("k_fs", "full-scale gain"), "A", case.current_a
            )


def part_name(path: str) -> str:
    """Return the name of an instance as the netlists spell it, without the board's own."""
    return path.removeprefix("xboard.")


def first_to_clip(check: Check, run: Run) -> list[tuple[str, str]]:
    """Return what clips first, in words: at rated torque, and in the run where it has seen the outputs."""
    notes = []
    known = [s for s in check.measured.headroom.swings if s.headroom_percent is not None]
    if known:
        s = min(known, key=lambda each: each.headroom_percent or 0.0)
        notes.append(
            (
                "clips first at rated torque",
                f"{part_name(s.path)} ({s.part}), {s.headroom_percent:.3g} % left",
            )
        )
    seen = run.plan.get("amplifiers") or []
    if seen:
        first = seen[0]
        left = 100.0 * float(first["headroom"])
        notes.append(
            ("clips first in this scene", f"{part_name(first['path'])} ({first['part']}), {left:.3g} % left")
        )
    return notes
