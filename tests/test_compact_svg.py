"""Figures inside a page: about half the bytes of the files beside it, and the same picture."""

import re
from pathlib import Path

import numpy as np
import pytest
from browser import Browser
from matplotlib.image import imread
from synthetic import slope_run

from reports import write_report
from reports.compact_svg import compact, data_uri
from reports.style import figure, look, pictures

#: Width of a figure on the screen [px].
WIDTH = 900


@pytest.mark.browser
def test_a_page_s_figures_are_those_beside_it(tmp_path: Path) -> None:
    """In a browser, side by side: what lines move by a hundredth of a point is a shade of their edges."""
    page = write_report(slope_run(), tmp_path)
    sources = re.findall(r'<img src="([^"]*)"', page.read_text(encoding="utf-8"))
    files = sorted((tmp_path / "figures").glob("*.svg"))
    assert len(sources) == len(files) > 6
    assert sum(map(len, sources)) < 0.7 * sum(path.stat().st_size for path in files)
    names = re.findall(r'<figure id="([^"]*)"', page.read_text(encoding="utf-8"))
    rows = "".join(
        f'<img src="figures/{name}.svg" width="{WIDTH}"><img src="{source}" width="{WIDTH}"><br>'
        for name, source in zip(names, sources, strict=True)
    )
    both = tmp_path / "both.html"
    both.write_text(f"<style>* {{ margin: 0; }} img {{ vertical-align: top; }}</style><nobr>{rows}</nobr>")
    with Browser(2 * WIDTH, 900) as browser:
        assert browser.visit(both).complaints == []
        assert all(browser.evaluate("[...document.images].map(i => i.naturalWidth > 0)"))
        browser.screenshot(tmp_path / "both.png")
    seen = imread(tmp_path / "both.png")[:, :, :3]
    left, right = seen[:, :WIDTH], seen[:, WIDTH : 2 * WIDTH]
    assert left.std() > 0.05
    off = np.abs(left - right).max(axis=2)
    assert np.mean(off > 0.25) < 1e-4
    assert off.mean() < 1e-3


def test_what_goes_and_what_stays() -> None:
    """No name without a reference, no metadata; letters and clips as they were; nothing ends an attribute."""
    with look():
        drawing, axes = figure(2.0)
        axes[0, 0].plot([0.0, 1.0, 2.0], [0.0, 1.0, 0.5], "o-", label="a < b & 'c'")
        axes[0, 0].legend()
        svg = pictures(drawing)["svg"]
    text = compact(svg)
    assert b"metadata" in svg
    assert not re.search("metadata|<!--|\\bg id=", text)
    assert len(re.findall("<use", text)) == len(re.findall(b"<use", svg))
    assert text.count("clip-path") == svg.count(b"clip-path")
    names = re.findall(r' id="([^"]+)"', text)
    assert len(names) == len(set(names)) > 0
    assert set(re.findall(r'(?:href="#|url\(#)([^")]+)', text)) == set(names)
    assert not set('"<>&#') & set(data_uri(svg))
