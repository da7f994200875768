"""Where the fingertip went: workspace, path over the wall, force near it."""

import numpy as np
from matplotlib.axes import Axes

from cosim.types import Array
from reports.decimate import keep_peaks
from reports.style import FAINT, FORCE, INK, POSITION, WALL, Drawn, figure
from reports.view import View, WallFrame

__all__ = ["path"]


#: The largest arrow is the panel's height divided by this.
_ARROWS = 3.2


def _linkage(view: View, at: int) -> tuple[Array, Array]:
    """Corners of the linkage [m] at point `at`, from its base to its tip."""
    lengths = view.scene_at("device", "chain", "lengths_m", default=())
    if len(lengths) != view.joints or not view.has(*(f"q{j + 1}" for j in range(view.joints))):
        return np.zeros(0), np.zeros(0)
    angle = np.cumsum([view.signal(f"q{j + 1}")[at] for j in range(view.joints)])
    size = np.asarray(lengths, dtype=np.float64)
    return (
        np.concatenate(([0.0], np.cumsum(size * np.cos(angle)))),
        np.concatenate(([0.0], np.cumsum(size * np.sin(angle)))),
    )


def _thin_path(view: View, first: Array, second: Array) -> tuple[Array, Array]:
    """Thin a path in the plane: the points that either coordinate needs."""
    times = np.union1d(*(keep_peaks(view.time, part, 800)[0] for part in (first, second)))
    at = np.searchsorted(view.time, times)
    return first[at], second[at]


def _square(axes: Axes) -> None:
    """Frame what is drawn in a square of equal scales."""
    axes.set_aspect("equal")
    box = axes.dataLim
    half = 0.54 * max(box.width, box.height) or 1.0
    axes.set_xlim((box.x0 + box.x1) / 2 - half, (box.x0 + box.x1) / 2 + half)
    axes.set_ylim((box.y0 + box.y1) / 2 - half, (box.y0 + box.y1) / 2 + half)


def _draw_wall(axes: Axes, wall: WallFrame) -> None:
    """Fill the inside of the wall over what the axes show, without changing their limits."""
    x, y = axes.get_xlim(), axes.get_ylim()
    point, normal, tangent = 1e3 * np.array(wall.point), np.array(wall.normal), np.array(wall.tangent)
    # From the foot of the frame's centre, a diagonal and more to all sides covers the frame.
    centre = np.array([sum(x), sum(y)]) / 2
    foot = point + float((centre - point) @ tangent) * tangent
    far = 2.0 * (x[1] - x[0]) + float(np.abs((centre - point) @ normal))
    corners = np.array([foot - far * tangent, foot + far * tangent])
    corners = np.concatenate((corners, corners[::-1] - far * normal))
    axes.fill(corners[:, 0], corners[:, 1], color=WALL, alpha=0.55, linewidth=0, zorder=0, label="wall")
    axes.plot(*corners[:2].T, color=INK, linewidth=1.0, zorder=1)
    axes.set_xlim(x)
    axes.set_ylim(y)


def path(view: View) -> Drawn | None:
    """Draw the path over the wall, the linkage at four instants, and the force near the wall.

    Needs ``x, y``; with ``q1..`` and link lengths the linkage, with a wall and ``fx, fy`` the second panel.
    """
    if not view.has("x", "y"):
        return None
    near = view.place is not None
    drawing, grid = figure(3.9, 1, 2 if near else 1, **({"width_ratios": (1.0, 1.25)} if near else {}))
    space = grid[0, 0]
    x, y = 1e3 * view.signal("x"), 1e3 * view.signal("y")
    space.plot(*_thin_path(view, x, y), color=FORCE, linewidth=1.6, label="fingertip", zorder=4)
    moments = np.searchsorted(view.time, np.linspace(view.time[0], view.end_s, 4)).clip(0, view.time.size - 1)
    for number, at in enumerate(moments.tolist()):
        corners = _linkage(view, at)
        if corners[0].size:
            shade_of = str(0.75 - 0.2 * number)
            space.plot(
                1e3 * corners[0], 1e3 * corners[1], "-o", color=shade_of, linewidth=2.0, markersize=3.5,
                zorder=2, label=f"t = {view.time[at]:.2f} s",
            )  # fmt: skip
    _square(space)
    space.set_xlabel("x [mm]")
    space.set_ylabel("y [mm]")
    if view.wall is not None:
        _draw_wall(space, view.wall)
    space.legend(
        loc="upper center", bbox_to_anchor=(0.5, -0.17), ncols=3, handlelength=1.5, columnspacing=1.0
    )
    space.set_title("workspace")
    jointed = bool(_linkage(view, 0)[0].size)
    caption = "Left: the fingertip's path" + (
        " and the linkage at four instants, light to dark." if jointed else "."
    )
    if not near:
        return Drawn(drawing, caption.removeprefix("Left: "))
    return Drawn(drawing, caption + (_phase if view.straight else _near_the_wall)(view, grid[0, 1]))


def _phase(view: View, axes: Axes) -> str:
    """Draw speed over position: what there is to see of a motion straight onto the wall."""
    assert view.place is not None
    across = 1e3 * view.place[1]
    apart = np.concatenate(([True], np.diff(view.time) > 0.0))
    speed = np.interp(view.time, view.time[apart], np.gradient(view.place[1][apart], view.time[apart]))
    axes.plot(*_thin_path(view, across, speed), color=FORCE, linewidth=1.3, zorder=3)
    axes.margins(0.06)
    axes.set_xlim(axes.get_xlim())
    axes.axvspan(axes.get_xlim()[0], 0.0, color=WALL, alpha=0.55, linewidth=0, zorder=0)
    axes.axvline(0.0, color=INK, linewidth=1.0, zorder=1)
    axes.axhline(0.0, color=FAINT, linewidth=0.7)
    axes.set_xlabel("off the wall [mm]")
    axes.set_ylabel("speed away from the wall [m/s]")
    axes.set_title("speed over position")
    return (
        " Right: speed over position; the grey half is inside the wall, and a spiral inwards comes to rest."
    )


def _near_the_wall(view: View, axes: Axes) -> str:
    assert view.place is not None
    along, across = (1e3 * part for part in view.place)
    axes.plot(*_thin_path(view, along, across), color=FORCE, linewidth=1.3, zorder=3)
    axes.set_xlabel("along the wall [mm]")
    axes.set_ylabel("off the wall [mm]")
    axes.set_title("near the wall")
    axes.margins(0.1, 0.06)
    low, high = axes.get_ylim()
    high = max(high, 0.25 * (high - low))
    # A nearly straight motion is not stretched sideways; the panel is about 1.7 times as wide as high.
    left, right = axes.get_xlim()
    spare = max(1.7 * (high - low) - (right - left), 0.0)
    axes.set_xlim(left - spare / 2, right + spare / 2)
    axes.axhspan(axes.get_ylim()[0] - 10 * (high - low), 0.0, color=WALL, alpha=0.55, linewidth=0, zorder=0)
    axes.axhline(0.0, color=INK, linewidth=1.0, zorder=1)
    axes.set_ylim(low, high)
    caption = (
        " Right: the same path in the wall's frame, each axis on its own scale; the grey half is inside."
    )
    inside = np.flatnonzero(view.contact)
    if view.force is not None and inside.size:
        instants = np.linspace(view.time[inside[0]], view.time[inside[-1]], 18)
        chosen = np.unique(inside[np.searchsorted(view.time[inside], instants).clip(0, inside.size - 1)])
        push = (view.force[0][chosen], view.force[1][chosen])
        largest = float(np.hypot(*push).max()) or 1.0
        arrows = axes.quiver(
            along[chosen],
            across[chosen],
            *push,
            angles="uv",
            scale_units="height",
            scale=_ARROWS * largest,
            width=0.0045,
            color=POSITION,
            zorder=5,
        )
        # Room for the tips.
        left, right = axes.get_xlim()
        tips = along[chosen] + push[0] / largest * (right - left) / (1.6 * _ARROWS)
        margin = 0.02 * (right - left)
        axes.set_xlim(min(left, tips.min() - margin), max(right, tips.max() + margin))
        unit = _round_force(largest)
        axes.quiverkey(arrows, 0.86, 1.045, unit, f"{unit:g} N", labelpos="E", coordinates="axes")
        caption += (
            " Arrows: force on the operator; an upright arrow is a frictionless wall, a leaning one drags."
        )
    return caption


def _round_force(value: float) -> float:
    """Return the largest of 1, 2, 5 times a power of ten that is not above `value`."""
    if value <= 0.0:
        return 1.0
    power = 10.0 ** np.floor(np.log10(value))
    return float(max(step * power for step in (1.0, 2.0, 5.0) if step * power <= value * (1 + 1e-12)))
