"""Labels of the user's in pictures: a dollar is a dollar."""

import io

import pytest

from reports.style import Drawn, figure, look

NAMES = ("o$x", "$a$", r"R$1$=5 $\frac{$", r"\bad{$$", "/Net-(U1-Pad1)", "in+", "a_b^c", "%", "{}", "\\")


@pytest.mark.few(5)
@pytest.mark.parametrize("scale", ["linear", "log"])
@pytest.mark.parametrize("name", NAMES)
def test_names_are_drawn_as_they_are(name: str, scale: str) -> None:
    with look():
        drawing, grid = figure(3.0)
        axes = grid[0, 0]
        axes.plot([1.0, 1e5], [1.0, 1e4], label=name)
        axes.set_xscale(scale)
        axes.set_title(name)
        axes.set_xlabel(name)
        axes.annotate(name, (10.0, 10.0))
        axes.set_yticks([1.0, 5e3], [name, name])
        axes.legend()
        drawn = Drawn(drawing, "")
        drawn.figure.savefig(io.BytesIO(), format="png")
        texts = {
            text.get_text(): text.get_parse_math()
            for text in drawing.findobj(lambda a: hasattr(a, "get_parse_math"))
        }
    assert texts[name] is False
    if scale == "log":  # the powers of ten are still written as such
        assert any("10^" in text and parsed for text, parsed in texts.items())
