"""What the circuit does: motor currents, VCA gains, headroom of the amplifiers, recorded nodes."""

from typing import Any

import numpy as np
from matplotlib.axes import Axes

from cosim.units import quantity
from reports.formatting import share
from reports.style import FAINT, INK, JOINTS, LIMIT, Drawn, curve, figure, held, legend, sample_ticks, shade
from reports.view import View

__all__ = ["currents", "gains", "headroom", "nodes"]


def currents(view: View) -> Drawn | None:
    """Motor currents with the rated and the limiting current.

    Needs ``imot1..``; the limits come from ``plan["constants"]``.
    """
    names = [f"imot{joint + 1}" for joint in range(view.joints)]
    if not names or not view.has(*names):
        return None
    drawing, grid = figure(3.2)
    axes = grid[0, 0]
    shade(axes, view.contact_spans)
    peak = 0.0
    for joint, name in enumerate(names):
        current = view.signal(name)
        peak = max(peak, float(np.abs(current).max()))
        curve(axes, view.time, current, color=JOINTS[joint], label=f"motor {joint + 1}", zorder=3)
    top = 1.15 * peak or 1.0
    hidden = []
    for name, label, dash in (("i_rated", "rated", "--"), ("i_limit", "limit", "-")):
        value = view.constant(name)
        if value is None:
            continue
        if value > 4.0 * peak and peak > 0.0:
            hidden.append(f"{label} {quantity(value, 'A')}")
            continue
        top = max(top, 1.08 * value)
        for sign in (1.0, -1.0):
            axes.axhline(
                sign * value, color=LIMIT, linestyle=dash, linewidth=1.0,
                label=f"{label} ±{quantity(value, 'A')}" if sign > 0 else None,
            )  # fmt: skip
    axes.set_ylim(-top, top)
    axes.set_xlim(view.time[0], view.end_s)
    axes.set_ylabel("current [A]")
    axes.set_xlabel("time [s]")
    legend(axes)
    sample_ticks(axes, view.sample_time)
    caption = (
        f"Motor currents; the largest is {quantity(peak, 'A')}. The rated current is thermal, not a limit."
    )
    if hidden:
        caption += f" Far above the axis: {', '.join(hidden)}."
    return Drawn(drawing, caption)


def gains(view: View, most: int = 6) -> Drawn | None:
    """Gains of the VCAs as the computer holds them, in SI units and volts; needs samples ``ksp**, ksd**``."""
    pairs = [f"{i + 1}{j + 1}" for i in range(view.joints) for j in range(view.joints)]
    kinds = [
        (kind, word, unit)
        for kind, word, unit in (
            ("ksp", "spring gains", "N m/rad"),
            ("ksd", "damper gains", "N m s/rad"),
        )
        if any(view.sampled(kind + pair).any() for pair in pairs)
    ]
    if not kinds or not view.sample_time.size:
        return None
    drawing, grid = figure(0.6 + 2.5 * len(kinds), len(kinds), 1, sharex=True)
    caption = "Gains of the VCAs, held from sample to sample; right axis: control voltage."
    for axes, (kind, word, unit) in zip(grid[:, 0], kinds, strict=True):
        size = {pair: float(np.abs(view.sampled(kind + pair)).max()) for pair in pairs}
        drawn = sorted(sorted(pairs, key=lambda pair: -size[pair])[:most])
        shade(axes, view.contact_spans)
        for number, pair in enumerate(drawn):
            color = JOINTS[number % len(JOINTS)]
            line: dict[str, Any] = {"color": color, "linestyle": _dash(pair), "label": kind + pair}
            held(axes, view.sample_time, view.sampled(kind + pair), view.end_s, zorder=3, **line)
        axes.axhline(0.0, color=FAINT, linewidth=0.7)
        axes.set_ylabel(f"[{unit}]")
        axes.set_title(word)
        axes.set_xlim(view.time[0] if view.time.size else 0.0, max(view.end_s, float(view.sample_time[-1])))
        _volts(view, axes, kind)
        legend(axes)
        if len(drawn) < len(pairs):
            caption += f" The {len(drawn)} largest of {len(pairs)} {word} are drawn; all are in the samples."
        sample_ticks(axes, view.sample_time)
    grid[-1, 0].set_xlabel("time [s]")
    absent = {"ksp", "ksd"} - {kind for kind, _, _ in kinds}
    if any(view.sampled(kind + pair).any() for kind, _, _ in kinds for pair in pairs if pair[0] != pair[1]):
        caption += " Dashed: cross gains between the joints, which change sign inside the workspace."
    elif len(pairs) > 1:
        caption += " The cross gains between the joints (dashed) are zero."
    if absent:
        caption += f" All {' and '.join(sorted(absent))} gains are zero."
    return Drawn(drawing, caption)


def _dash(pair: str) -> str | tuple[float, tuple[float, float]]:
    """Return dashes that fill each other's gaps for ij and ji: equal cross gains are both seen."""
    if pair[0] == pair[1]:
        return "-"
    return (0.0 if pair[0] < pair[1] else 4.0), (4.0, 4.0)


def _volts(view: View, axes: Axes, kind: str) -> None:
    """Add the scale in volts, from the board's full scale."""
    full, volts = view.constant("k_fs" if kind == "ksp" else "c_fs"), view.constant("v_fs")
    if not full or not volts:
        return
    factor = volts / full
    right = axes.secondary_yaxis(
        "right",
        functions=(lambda gain: np.multiply(gain, factor), lambda control: np.divide(control, factor)),
    )
    right.set_ylabel("[V]")


def headroom(view: View, most: int = 14) -> Drawn | None:
    """Largest output of every amplifier against its swing. Needs ``stats["headroom"]``."""
    amplifiers = view.amplifiers[:most]
    if not amplifiers:
        return None
    drawing, grid = figure(1.1 + 0.3 * len(amplifiers))
    axes = grid[0, 0]
    rows = np.arange(len(amplifiers))[::-1]
    for row, amplifier in zip(rows.tolist(), amplifiers, strict=True):
        color = LIMIT if amplifier.used >= 0.9 else JOINTS[0]
        axes.barh(row, min(amplifier.peak_v, amplifier.swing_v), height=0.62, color=color, zorder=2)
        axes.plot([amplifier.swing_v] * 2, [row - 0.4, row + 0.4], color=INK, linewidth=2.0, zorder=3)
        left = amplifier.swing_v - amplifier.peak_v
        words = "clips" if left <= 0 else f"{quantity(left, 'V', 2)} left, {share(amplifier.used)} used"
        axes.annotate(
            words, (max(amplifier.swing_v, amplifier.peak_v), row), xytext=(7, 0),
            textcoords="offset points", va="center", fontsize=9.0,
        )  # fmt: skip
    names = [f"{amplifier.name}  {amplifier.part}".strip() for amplifier in amplifiers]
    axes.set_yticks(rows, names)
    axes.set_ylim(-0.6, len(amplifiers) - 0.4)
    axes.set_xlim(0.0, 1.28 * max(amplifier.swing_v for amplifier in amplifiers))
    axes.grid(False, axis="y")
    axes.tick_params(axis="y", length=0)
    axes.set_xlabel("largest output during the run [V]; the stroke is the swing")
    caption = (
        "Headroom: largest output of each amplifier against the swing at which it clips, the fullest first; "
        "red from 90 %."
    )
    if len(view.amplifiers) > most:
        caption += (
            f" The {most} fullest of {len(view.amplifiers)} amplifiers are drawn; the others have more room."
        )
    return Drawn(drawing, caption)


def nodes(view: View, most: int = 6) -> Drawn | None:
    """Draw the recorded nodes of the netlist (signals with a dot in their name), one panel each."""
    names = [name for name in view.run.signals if "." in name]
    if not names or view.time.size < 2:
        return None
    drawn = names[:most]
    drawing, grid = figure(0.9 + 1.15 * len(drawn), len(drawn), 1, sharex=True)
    for name, axes in zip(drawn, grid[:, 0], strict=True):
        shade(axes, view.contact_spans)
        curve(axes, view.time, view.signal(name), color=INK, linewidth=1.0)
        axes.set_title(name, fontsize=9.5)
        axes.set_ylabel("[V]")
        axes.set_xlim(view.time[0], view.end_s)
    grid[-1, 0].set_xlabel("time [s]")
    caption = "Nodes of the netlist that the scene records; the shade is contact."
    if len(names) > most:
        caption += f" {len(names) - most} further nodes are in the data only: {', '.join(names[most:])}."
    return Drawn(drawing, caption)
