"""What makes a figure hard to read: labels on one another, nameless axes, words cut off, raw formulas."""

from itertools import combinations, pairwise

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.text import Text
from matplotlib.transforms import Bbox

#: Boxes of ticks may touch; this much of overlap [pixel] is seen. Texts side by side need a gap.
_SEEN, _GAP = 2.0, 6.0


def faults(figure: Figure) -> list[str]:
    """Return what is wrong with a finished figure, in words."""
    figure.draw_without_rendering()
    width, height = figure.canvas.get_width_height()
    texts = [each for axes in figure.axes for each in _texts(axes)]
    problems = [fault for axes in figure.axes for fault in _of_axes(axes)]
    for (one, box), (other, second) in combinations(texts, 2):
        if _overlap(box, second, -_GAP):
            problems.append(f"{one!r} lies on {other!r}")
    for text, box in texts:
        if min(box.x0, box.y0) < -_SEEN or box.x1 > width + _SEEN or box.y1 > height + _SEEN:
            problems.append(f"{text!r} is cut off")
    for each in figure.findobj(Text):
        if _shown(each) and "$" in each.get_text() and not each.get_parse_math():
            problems.append(f"a formula is drawn as it is written: {each.get_text()}")
    return problems


def _texts(axes: Axes) -> list[tuple[str, Bbox]]:
    """Return titles, texts and the legend of axes, each with its box."""
    words = [*axes.texts, axes.title, axes._left_title, axes._right_title]
    problems = [(each.get_text(), each.get_window_extent()) for each in words if _shown(each)]
    legend = axes.get_legend()
    return [*problems, (f"legend of {axes.get_ylabel()}", legend.get_window_extent())] if legend else problems


def _of_axes(axes: Axes) -> list[str]:
    problems = []
    for name, axis in (("x", axes.xaxis), ("y", axes.yaxis)):
        low, high = sorted(axis.get_view_interval())
        marks = zip(axis.get_majorticklocs(), axis.get_majorticklabels(), strict=False)
        labels = [label for place, label in marks if _shown(label) and low <= place <= high]
        if not axis.get_visible() or not labels:
            continue
        boxes = [(label.get_text(), label.get_window_extent()) for label in labels]
        if all(label.get_rotation() % 90 == 0 for label in labels):
            problems += [
                f"ticks {a} and {b} of {name} overlap"
                for (a, one), (b, other) in pairwise(boxes)
                if _overlap(one, other)
            ]
        words = axis.get_label_text() or axes.get_title() or axes.get_title("left")
        speak = all(text[:1].isalpha() for text, _ in boxes)
        if not (words or speak or axes.get_label() == "<colorbar>"):
            problems.append(f"{name} axis without a name: {[text for text, _ in boxes]}")
    return problems


def _shown(text) -> bool:
    return text.get_visible() and bool(text.get_text().strip())


def _overlap(one: Bbox, other: Bbox, seen: float = _SEEN) -> bool:
    wide = min(one.x1, other.x1) - max(one.x0, other.x0)
    high = min(one.y1, other.y1) - max(one.y0, other.y0)
    return bool(wide > seen and high > _SEEN)
