"""A check as text: one section a question, columns aligned, equal rows shown once."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from cosim.checking.check import Check
from cosim.checking.components import BAND_HZ as MECHANICAL_HZ
from cosim.checking.headroom import SOFT_N_PER_M
from cosim.checking.noise_budget import BAND_HZ, Noise, PotNoise
from cosim.checking.probed_board import HIGHEST_HZ
from cosim.checking.requirements import Severity
from cosim.checking.signal_paths import NAMES, Brake
from cosim.circuits.extraction.swing import SwingFrom
from cosim.units import quantity

Row = tuple[str, Sequence[str]]
_LISTED = 4
_NO_DELAY_S = 1e-12
#: What rounding leaves of a leak or an offset of zero, in any unit.
_NOTHING = 1e-15
#: Devices below this share of the whole noise are counted, not listed.
_LOUD = 0.05


def describe(check: Check) -> str:
    """Return the whole check in words."""
    sections = [
        _ports,
        _stability,
        _constants,
        _rest,
        _headroom,
        _loops,
        _paths,
        _noise,
        _components,
        _coupling,
    ]
    lines = [line for section in sections for line in [*section(check), ""]]
    lines += [f"{finding.severity}: {finding.message}" for finding in check.findings]
    problems, warnings = check.count(Severity.PROBLEM), check.count(Severity.WARNING)
    lines.append(f"{_count(problems, 'problem')}, {_count(warnings, 'warning')}")
    return "\n".join(lines)


def _count(number: int, word: str) -> str:
    return f"{number} {word}{'' if number == 1 else 's'}"


def _ports(check: Check) -> list[str]:
    board = check.subject.board
    parts = [(part.name, [part.role or "", "" if part.level is None else part.level]) for part in board.parts]
    return [
        f"{board.board}: {_count(board.joints, 'joint')}, {check.subject.driver} drive ({board.path})",
        f"  pins: {' '.join(board.pins)}",
        *_table(("part", "role", "level"), parts, left=(0, 1, 2)),
        *(f"  note: {note}" for note in board.notes),
    ]


def _stability(check: Check) -> list[str]:
    judged = check.stability
    if judged.unjudged:
        return ["stability: unknown"]
    declared = [f"  as declared, {each}" for each in judged.instabilities if each.declared]
    if judged.stable:
        return ["stability: stable, with all gains at zero, at full scale and as commanded", *declared]
    return ["stability: NOT STABLE", *(f"  {each}" for each in (*judged.instabilities, *judged.latched))]


def _constants(check: Check) -> list[str]:
    head = ("constant", "at", "stated", "measured", "deviation", "with ideal parts")
    lines: list[Sequence[str]] = [head]
    for name in dict.fromkeys(c.name for c in check.measured.constants):
        rows = [c for c in check.measured.constants if c.name == name]
        merged = _merged(
            (c.where, [_si(c.stated, c.unit, 6), _si(c.measured, c.unit, 6), _percent(c.deviation_percent),
                       _percent(c.ideal_deviation_percent)])
            for c in rows
        )  # fmt: skip
        lines += [(name, "all" if len(merged) == 1 else where, *cells) for where, cells in merged]
    return [
        "Design constants (what the computer believes against what ngspice measures)",
        *_aligned(lines, 2),
    ]


def _rest(check: Check) -> list[str]:
    rows = [
        (
            f"motor {r.joint}",
            [
                _si(r.current_a, "A"),
                _si(r.force_n, "N"),
                _si(r.leak_n_per_m, "N/m"),
                _si(r.leak_n_s_per_m, "N s/m"),
            ],
        )
        for r in check.measured.rest
    ]
    r_tip = _si(check.measured.stated.r_tip, "m", 4)
    head = ("", "current", "force", "spring left", "damper left")
    return [
        f"Out of contact (all gains zero; forces at r_tip = {r_tip})",
        *_table(head, _merged(rows)),
    ]


def _headroom(check: Check) -> list[str]:
    headroom, stated = check.measured.headroom, check.measured.stated
    lines = [
        f"Headroom at rated torque ({_si(stated.i_rated, 'A')}, "
        f"{_si(stated.i_rated * stated.kt * stated.gear, 'N m')})"
    ]
    for case in headroom.cases:
        if case.deflection_rad is None or case.current_a is None:
            lines.append(f"  {case.name}: needs more than the full-scale gain")
        else:
            lines.append(
                f"  {case.name}: {_si(case.deflection_rad, 'rad', 4)} make "
                f"{_si(case.current_a, 'A', 4)}, "
                f"{100 * case.current_a / stated.i_rated:.4g} % of rated"
            )
    rows = [
        (
            _short(s.path),
            [
                s.part,
                _si(s.peak_v, "V"),
                _si(s.limit_v, "V"),
                _figure(s.headroom_percent, ".3g", " %"),
                s.case,
            ],
        )
        for s in headroom.swings
    ]
    head = ("amplifier", "part", "peak", "limit", "left", "at")
    lines += _table(head, _merged(rows), left=(0, 1, 5))
    for source, words in (
        (SwingFrom.MEASURED, "limit measured of the part alone, between the supplies"),
        (SwingFrom.SUPPLIES, "its model has no limit within the supplies, which are taken for it"),
        ("", "not watched: its limit is neither stated nor to be measured"),
    ):
        parts = sorted({s.part for s in headroom.swings if s.limit_from == source})
        if parts:
            lines.append(f"  {', '.join(parts)}: {words}")
    volts = [c.measured for c in check.measured.constants if c.name == "w_rated" and c.measured is not None]
    if volts:
        lines.append(f"  multiplier output at rated torque and k_fs: {_si(min(volts), 'V', 4)} or more")
    for speed in headroom.speeds:
        lines.append(
            f"  joint {speed.joint} with the damper at c_fs: {_short(speed.path)} reaches its limit at "
            f"{_si(speed.speed_rad_per_s, 'rad/s')}"
        )
    limits = ", ".join(_si(limit, "A", 4) for limit in headroom.limits_a)
    lines.append(f"  motor current with command and spring at the end of their range: {limits}")
    lines[-1] += f" (i_limit {_si(stated.i_limit, 'A')})"
    if _below_full(check, "driver"):
        lines[-1] += "; the driver clips at level full only"
    return lines


def _loops(check: Check) -> list[str]:
    rows = [
        (
            _short(loop.path) + (" (current loop)" if loop.kind == "motor" else ""),
            [
                loop.part,
                f"{loop.dc_gain:.3g}",
                _si(loop.crossover_hz, "Hz"),
                _figure(loop.phase_margin_deg, ".3g", " deg"),
                _figure(loop.gain_margin_db, ".3g", " dB"),
                {True: "yes", False: "NO", None: "-"}[loop.stable],
            ],
        )
        for loop in check.measured.loops
    ]
    head = ("loop", "part", "gain at 0.1 Hz", "crossover", "phase margin", "gain margin", "stable")
    lines = ["Loops (return ratio at each amplifier's output, and at a motor inside a loop)"]
    if any(loop.stable is None for loop in check.measured.loops):
        lines.append("  ideal parts have no bandwidth: margins mean something at levels gbw and full")
    return lines + _table(head, _merged(rows))


def _paths(check: Check) -> list[str]:
    measured = check.measured
    lines = [
        "Paths (each through its own gain at full scale, leaks taken off; delay is the sum of time constants)"
    ]
    rows: list[Sequence[str]] = [("path", "joint", "delay", "-3 dB")]
    for kind, name in NAMES.items():
        same = _grouped(
            (str(p.joint), [_si(p.delay_s, "s"), _bandwidth(p.bandwidth_hz)])
            for p in measured.paths
            if p.kind == kind
        )
        rows += [(name, ", ".join(joints), *cells) for joints, cells in same]
    lines += _aligned(rows, 2)
    chains = _grouped(
        (str(j), [f"{s.block} {_si(s.delay_s, 's')}" for s in measured.steps if s.joint == j])
        for j in dict.fromkeys(step.joint for step in measured.steps if abs(step.delay_s) > _NO_DELAY_S)
    )
    lines += [f"  spring's delay, joint {', '.join(joints)}: {' + '.join(cells)}" for joints, cells in chains]
    for joints, cells in _grouped((str(b.joint), [_brake(b)]) for b in measured.brakes):
        lines.append(f"  joint {', '.join(joints)}: {cells[0]}")
    return lines


def _brake(brake: Brake) -> str:
    if brake.eta is None:
        return "no back-EMF brakes it, so nothing on the board pays for the spring's delay"
    text = (
        f"the back-EMF brakes with {_si(brake.viscosity_n_m_s, 'N m s/rad')}; "
        f"the spring's delay eats {brake.eta:.3g} of it at k_fs"
    )
    if brake.stiffness_n_per_m is not None:
        text += f", all of it at {_si(brake.stiffness_n_per_m, 'N/m', 4)} at the tip"
    return text


def _noise(check: Check) -> list[str]:
    measured = check.measured
    rows = [
        (f"motor {n.joint}", [n.gains, _si(n.torque_n_m, "N m"), _si(n.force_n, "N"), _top(n)])
        for n in measured.noise
    ]
    lines = [f"Noise of the circuit, rms from {_si(BAND_HZ[0], 'Hz')} to {_si(BAND_HZ[1], 'Hz')}"]
    lines += _table(("", "gains", "torque", "force", "most of it"), rows, left=(0, 1, 4))
    if _below_full(check, "opamp", "vca", "driver"):
        lines.insert(
            1, "  parts carry their data-sheet noise at level full; below it, this is the resistors' alone"
        )
    for joints, cells in _grouped((str(p.joint), [_pot(p)]) for p in measured.pot_noise):
        lines.append(f"  joint {', '.join(joints)}: {cells[0]}")
    return lines


def _components(check: Check) -> list[str]:
    components = check.measured.components
    lines = [
        "Noise by component (parts at their data sheet's density at any level), rms from "
        f"{_si(MECHANICAL_HZ[0], 'Hz')} to {_si(MECHANICAL_HZ[1], 'Hz')}",
        f"  all of it: {_si(components.rest_n, 'N')} with all gains zero, "
        f"{_si(components.spring_n, 'N')} with each joint's spring at k_fs, "
        f"and {_si(components.above_n, 'N')} above, to {_si(components.top_hz, 'Hz')}",
    ]
    loud = [d for d in components.devices if d.spring_n > _LOUD * components.spring_n]
    rows = [
        (
            _short(d.device),
            [_si(d.rest_a, "A"), _si(d.rest_n, "N"), _si(d.spring_a, "A"), _si(d.spring_n, "N")],
        )
        for d in loud
    ]
    head = ("device", "gains zero", "at the tip", "springs at k_fs", "at the tip")
    lines += _table(head, _merged(rows))
    quiet = len(components.devices) - len(loud)
    if quiet:
        lines.append(f"  and {_count(quiet, 'device')} below {100 * _LOUD:g} % of the sum each")
    return lines + [f"  note: {note}" for note in components.notes]


def _below_full(check: Check, *roles: str) -> bool:
    """Whether one of the shelf's parts with such a role is at a level below full."""
    levels = {part.level for part in check.subject.board.parts if part.role in roles}
    return bool(levels & {"ideal", "gbw"})


def _top(noise: Noise) -> str:
    return ", ".join(f"{c.name} {c.share_percent:.2g} %" for c in noise.top[:_LISTED])


def _pot(pot: PotNoise) -> str:
    spring, soft, damper = (_si(force, "N") for force in (pot.spring_n, pot.soft_n, pot.damper_n))
    return (
        f"{_si(pot.noise_rad, 'rad')} of potentiometer noise, white to {_si(pot.bandwidth_hz, 'Hz')}: "
        f"{spring} through the spring at k_fs, {soft} at {_si(SOFT_N_PER_M, 'N/m')}, {damper} through the "
        "damper at c_fs"
    )


def _coupling(check: Check) -> list[str]:
    coupling = check.coupling
    if check.subject.scene is None:
        return ["Coupling: give a scene to see the step that its linkage allows"]
    if coupling is None:
        return ["Coupling: no back-EMF, no bound on the step"]
    return [
        f"Coupling: back-EMF and linkage at {_si(coupling.rate_per_s, '/s')} allow steps of "
        f"0.5 m_eff/b_eff = {_si(coupling.step_s, 's')}; solver.max_step_s is {_si(coupling.max_step_s, 's')}"
    ]


def _bandwidth(hz: float | None) -> str:
    return f"> {_si(HIGHEST_HZ, 'Hz')}" if hz is None else _si(hz, "Hz")


def _short(path: str) -> str:
    return path.removeprefix("xboard.")


def _figure(value: float | None, form: str, unit: str = "") -> str:
    return "-" if value is None else f"{value:{form}}{unit}"


def _percent(value: float | None) -> str:
    return "-" if value is None else f"{value:+.2g} %" if abs(value) >= 5e-4 else "0 %"


def _si(value: float | None, unit: str, digits: int = 3) -> str:
    """Return a value as every command writes it; what is below the rounding of ngspice is zero."""
    if value is None:
        return "-"
    return quantity(0.0 if abs(value) < _NOTHING else value, unit, digits)


def _grouped(rows: Iterable[Row]) -> list[tuple[list[str], list[str]]]:
    """Put the labels of equal rows together, in the order of their first."""
    groups: dict[tuple[str, ...], list[str]] = {}
    for label, cells in rows:
        groups.setdefault(tuple(cells), []).append(label)
    return [(labels, list(cells)) for cells, labels in groups.items()]


def _merged(rows: Iterable[Row]) -> list[Row]:
    return [(_list(labels), cells) for labels, cells in _grouped(rows)]


def _list(labels: list[str]) -> str:
    more = len(labels) - _LISTED
    return ", ".join(labels[:_LISTED]) + (f" and {more} more" if more > 0 else "")


def _table(head: Sequence[str], rows: Iterable[Row], left: Sequence[int] = (0, 1)) -> list[str]:
    return _aligned([tuple(head), *((label, *cells) for label, cells in rows)], left)


def _aligned(rows: Sequence[Sequence[str]], left: Sequence[int] | int = (0, 1)) -> list[str]:
    """Return the rows with aligned columns; those in `left` (or the first so many) start flush."""
    flush = range(left) if isinstance(left, int) else left
    widths = [max(len(row[k]) for row in rows) for k in range(len(rows[0]))]
    return [
        "  "
        + "  ".join(
            cell.ljust(width) if k in flush else cell.rjust(width)
            for k, (cell, width) in enumerate(zip(row, widths, strict=True))
        ).rstrip()
        for row in rows
    ]
