"""What a designer should look at: measured figures against what such a board must do."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from enum import StrEnum

from cosim.caution import Caution
from cosim.checking.coupling_step import Coupling
from cosim.checking.measured import Measured
from cosim.checking.measured_constants import Constant
from cosim.circuits.instability.stability_verdict import Verdict
from cosim.plausibility import DEVIATION, constant_missed
from cosim.units import quantity

DEVIATION_PERCENT = 0.1
"""The computer's numbers and the board must agree to 1e-3."""
HEADROOM_PERCENT = 10.0
"""Rated torque must leave so much of every output's limit."""
MULTIPLIER_V = 5.0
"""A multiplier's error is a share of its full scale: at rated torque it must use half of it."""
REST_N = 0.05
"""Force at the tip out of contact that a finger does not notice."""
MARGIN_DEG = 45.0
"""Phase margin below which a loop rings: 23 % overshoot."""
LIMIT_PERCENT = 5.0
"""A current limit is a protection, known to a few percent."""


class Severity(StrEnum):
    """How bad a finding is."""

    PROBLEM = "problem"
    WARNING = "warning"


@dataclass(frozen=True)
class Finding:
    """One sentence about the board."""

    severity: Severity
    section: str
    message: str


def findings(measured: Measured, coupling: Coupling | None) -> list[Finding]:
    """Compare what was measured with what is wanted, in the order of the sections."""
    return [
        *_constants(measured),
        *_rest(measured),
        *_headroom(measured),
        *_loops(measured),
        *_delay(measured),
        *_noise(measured),
        *_coupling(coupling),
    ]


def missed(measured: Measured) -> list[Caution]:
    """Return the design constants that the board misses so far that they or its netlist must be wrong."""
    worst: dict[str, tuple[float, Caution]] = {}
    for c in measured.constants:
        size = abs(c.deviation_percent) if c.deviation_percent is not None else float("inf")
        if c.measured is not None and size > 100.0 * DEVIATION and size > worst.get(c.name, (0.0,))[0]:
            worst[c.name] = size, constant_missed(c.name, c.stated, c.measured, c.where)
    return [caution for _, caution in worst.values()]


def of_stability(judged: Verdict) -> Iterable[Finding]:
    """Report the verdict on the circuit's stability, the same that a run waits for."""
    if judged.unjudged:
        yield _warning("stability", f"not judged: {judged.unjudged}")
    for each in judged.instabilities:
        if each.declared:
            continue
        yield _problem("stability", str(each)) if each.confirmed else _warning("stability", str(each))
    for stuck in judged.latched:
        yield _problem("stability", str(stuck))


def _problem(section: str, message: str) -> Finding:
    return Finding(Severity.PROBLEM, section, message)


def _warning(section: str, message: str) -> Finding:
    return Finding(Severity.WARNING, section, message)


def _constants(measured: Measured) -> Iterable[Finding]:
    for name in dict.fromkeys(c.name for c in measured.constants):
        rows = [c for c in measured.constants if c.name == name]
        for c in rows:
            if c.measured is None or c.ideal is None:
                yield _problem("constants", f"{name} ({c.where}): nothing comes through to the motor")
        own = [c for c in rows if _off(c.ideal_deviation_percent)]
        if own:
            worst = max(own, key=lambda c: abs(c.ideal_deviation_percent or 0.0))
            yield _problem(
                "constants",
                f"{name} is off by {worst.ideal_deviation_percent:+.3g} % at {_places(own, rows)} with ideal "
                f"parts: the computer believes {worst.stated:.5g} {worst.unit}, the board makes "
                f"{worst.ideal:.5g}",
            )
        parts = [c for c in rows if c not in own and _off(c.deviation_percent)]
        if parts:
            worst = max(parts, key=lambda c: abs(c.deviation_percent or 0.0))
            yield _warning(
                "constants",
                f"{name} is off by {worst.deviation_percent:+.3g} % at {_places(parts, rows)}; with ideal "
                f"parts by {worst.ideal_deviation_percent:+.2g} %: errors of the parts at their level",
            )
        uneven = [c for c in rows if _off(c.spread_percent)]
        if uneven:
            yield _warning(
                "constants",
                f"{name} at {_places(uneven, rows)} still changes with frequency where it is read",
            )
    if measured.stated.i_limit <= measured.stated.i_rated:
        yield _problem("constants", "i_limit does not exceed i_rated")


def _off(percent: float | None) -> bool:
    return percent is not None and not abs(percent) <= DEVIATION_PERCENT


def _places(rows: list[Constant], every: list[Constant]) -> str:
    if len(rows) == len(every):
        return "every place"
    return ", ".join(c.where for c in rows[:4]) + (f" and {len(rows) - 4} more" if len(rows) > 4 else "")


def _rest(measured: Measured) -> Iterable[Finding]:
    for rest in measured.rest:
        if not abs(rest.force_n) <= REST_N:
            yield _problem(
                "rest",
                f"joint {rest.joint} pushes with {quantity(rest.force_n, 'N', 2)} out of contact "
                f"(allowed {REST_N} N)",
            )


def _headroom(measured: Measured) -> Iterable[Finding]:
    for swing in measured.headroom.swings:
        left, limit = swing.headroom_percent, swing.limit_v
        if left is not None and limit is not None and not left >= HEADROOM_PERCENT:
            yield _problem(
                "headroom",
                f"{swing.path} ({swing.part}) reaches {quantity(swing.peak_v, 'V')} of "
                f"{quantity(limit, 'V')} at "
                f"{swing.case}",
            )
    unknown = [s for s in measured.headroom.swings if s.limit_v is None]
    if unknown:
        parts = ", ".join(sorted({s.part for s in unknown}))
        yield _warning("headroom", f"{parts}: states no output limit, so its headroom is not known")
    for c in measured.constants:
        if c.name == "w_rated" and c.measured is not None and not c.measured >= MULTIPLIER_V:
            yield _problem(
                "headroom",
                f"the multiplier {c.where} makes {quantity(c.measured, 'V')} at rated torque "
                f"(wanted {quantity(MULTIPLIER_V, 'V', 4)})",
            )
    for case in measured.headroom.cases:
        if case.deflection_rad is None:
            yield _warning("headroom", f"{case.name} needs more than the full-scale gain")
    stated = measured.stated
    for joint, limit in enumerate(measured.headroom.limits_a, 1):
        if limit is not None and not limit >= stated.i_rated:
            yield _problem(
                "headroom", f"motor {joint} never gets its rated current: {quantity(limit, 'A')} at most"
            )
        elif limit is not None and not limit >= stated.i_limit * (1 - LIMIT_PERCENT / 100):
            yield _warning(
                "headroom",
                f"motor {joint} gets {quantity(limit, 'A')} at most, i_limit says "
                f"{quantity(stated.i_limit, 'A')}",
            )


def _loops(measured: Measured) -> Iterable[Finding]:
    for loop in measured.loops:
        if loop.stable is False:
            yield _problem("loops", f"{loop.path} is unstable: its loop gain encircles -1")
        elif loop.phase_margin_deg is not None and not loop.phase_margin_deg >= MARGIN_DEG:
            yield _problem(
                "loops",
                f"{loop.path} has a phase margin of {loop.phase_margin_deg:.3g} deg (wanted {MARGIN_DEG:g})",
            )


def _delay(measured: Measured) -> Iterable[Finding]:
    for brake in measured.brakes:
        if brake.eta is not None and brake.eta > 1.0:
            yield _warning(
                "paths",
                f"joint {brake.joint}: at k_fs the spring's delay eats {brake.eta:.3g} times the back-EMF's "
                "viscosity; friction or the hand must supply the rest",
            )


def _noise(measured: Measured) -> Iterable[Finding]:
    for note in dict.fromkeys((*measured.notes, *measured.components.notes)):
        yield _warning("noise", note)
    if not all(noise.complete for noise in measured.noise):
        yield _warning(
            "noise",
            "ngspice's .noise does not pass through some of these parts (POLY sources become XSPICE devices, "
            "which take no part in it): the circuit's noise is underestimated",
        )


def _coupling(coupling: Coupling | None) -> Iterable[Finding]:
    if coupling is not None and coupling.step_s < coupling.max_step_s:
        yield _warning(
            "coupling",
            f"the back-EMF on so light a linkage shortens solver.max_step_s from {coupling.max_step_s:.3g} s "
            f"to {coupling.step_s:.3g} s",
        )
