"""A run in a notebook: one figure, and the summary with measures and the main picture."""

from html import escape
from importlib import import_module
from typing import TYPE_CHECKING

from cosim.units import quantity
from reports.page import FIGURES, draw_all
from reports.summary import summary
from reports.view import RunLike, View

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["figure", "html"]


def figure(run: RunLike, name: str | None = None) -> "Figure":
    """Return a figure of a run: that of a name of `reports.page.FIGURES`, or the first that the run fills.

    Raises
    ------
    ValueError
        For an unknown name, or a figure for which the run lacks the signals.
    """
    from reports.style import look

    names = [each[0] for each in FIGURES]
    if name is not None and name not in names:
        raise ValueError(f"no figure {name!r}; there are {', '.join(names)}")
    view = View(run)
    with look():
        for each, _, module, function in FIGURES:
            if name is None or each == name:
                drawn = getattr(import_module(f"reports.{module}"), function)(view)
                if drawn is not None:
                    found: Figure = drawn.figure
                    return found
    raise ValueError(f"the run lacks the signals of {name or 'every figure'}")


def html(run: RunLike) -> str:
    """Return the summary, cautions, the measures with their units and the main picture as HTML."""
    view = View(run)
    rows = "".join(
        f"<tr><td>{escape(name)}</td><td>{escape(_number(row['value'], row['unit']))}</td>"
        f"<td>{escape(str(row['text']))}</td></tr>"
        for name, row in run.measures.items()
    )
    doubts = "".join(f"<li>{escape(str(caution))}</li>" for caution in run.warnings)
    pictures, _ = draw_all(view, first=True)
    return "".join(
        (
            f"<h4>{escape(str(view.scene_at('title', default='Co-simulation')))}</h4>",
            *(f"<p>{escape(sentence)}</p>" for sentence in summary(view)),
            f"<ul>{doubts}</ul>" if doubts else "",
            f"<table>{rows}</table>",
            *(f'<img alt="{escape(each.title)}" src="{each.source}">' for each in pictures),
        )
    )


def _number(value: object, unit: str) -> str:
    return quantity(value, unit, 5) if isinstance(value, int | float) else str(value)
