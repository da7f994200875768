"""The notebooks of `examples/` run from top to bottom, and come to what they say."""

import ast
import contextlib
import io
import json
import re
from pathlib import Path

import pytest

import cosim
from cosim.assets import scenes_folder

EXAMPLES = Path(__file__).resolve().parents[1] / "examples"
NOTEBOOKS = sorted(EXAMPLES.glob("*.ipynb"))
#: Settings that make a notebook short, and what it must print.
SHORT = {
    "monte_carlo": ({}, r"xsum1\.r31 .*at 0\.1%"),
    "stability_map": (
        {"1e-3:3e-2:7:log": "2e-3:2e-2:3:log", "[0.0, 1.0, 2.0]": "[0.0, 2.0]"},
        r"virtual damping: -(0\.[89]|1\.[01])",
    ),
    "edit_a_board": ({"18k:30k:5": "18k:30k:2"}, r"designed: 104\.\d N/m\nedited: 126\.\d N/m"),
    "own_law_and_operator": ({}, r"asked for (\d+\.\d)\d* N/m at .* the law says \1"),
}


def code_cells(path):
    """Return the code of a notebook, cell by cell."""
    cells = json.loads(path.read_text(encoding="utf-8"))["cells"]
    return ["".join(cell["source"]) for cell in cells if cell["cell_type"] == "code"]


def run_cells(cells):
    """Run cells as a notebook does; return what they print, and their last expressions."""
    names, printed, shown = {}, io.StringIO(), []
    with contextlib.redirect_stdout(printed):
        for code in cells:
            *_, last = tree = ast.parse(code).body
            lone = isinstance(last, ast.Expr)
            module = ast.Module(tree[:-1] if lone else tree, [])
            exec(compile(module, "cell", "exec"), names)
            if lone:
                value = eval(compile(ast.Expression(last.value), "cell", "eval"), names)
                shown.append(value)
    return printed.getvalue(), shown


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook_is_clean(path):
    """No outputs are committed, every cell is Python, and the words come before the code."""
    notebook = json.loads(path.read_text(encoding="utf-8"))
    assert notebook["nbformat"] == 4
    assert notebook["cells"][0]["cell_type"] == "markdown"
    assert all(not cell.get("outputs") for cell in notebook["cells"])
    for code in code_cells(path):
        compile(code, str(path), "exec")
    assert path.stem in SHORT


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::cosim.caution.Doubt")
@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook_runs(path):
    changes, expected = SHORT[path.stem]
    cells = code_cells(path)
    for old, new in changes.items():
        assert any(old in code for code in cells), old
        cells = [code.replace(old, new) for code in cells]
    printed, shown = run_cells(cells)
    assert re.search(expected, printed), printed
    for value in shown:
        if type(value).__module__.startswith("cosim."):
            assert "<img" in value._repr_html_()
        elif type(value).__module__.startswith("reports."):
            assert value._repr_png_().startswith(b"\x89PNG")


@pytest.mark.filterwarnings("ignore::cosim.caution.Doubt")
def test_what_a_front_door_returns_shows_and_draws_itself():
    """A sweep, a study and a batch of devices, small; what is not there is an error in words."""
    scene = cosim.load_scene(scenes_folder() / "press.toml")
    swept = cosim.sweep(scene, {"computer.period_s": [0.005, 0.01]}, ["k_max"])
    study = cosim.study(scenes_folder() / "paper/0_2_passive.toml")
    batch = cosim.monte_carlo(scene, ["eta < 0.1"], samples=4)
    for each, words in ((swept, "computer.period_s"), (study, study.title), (batch, "eta &lt;= 0.1")):
        html = each._repr_html_()
        assert words in html
        assert "<table" in html
        assert re.search(r'<img alt="[^"]+" src="data:image', html)
        assert each.plot()._repr_png_().startswith(b"\x89PNG")
    with pytest.raises(ValueError, match="no fitted surface"):
        batch.plot("blame")
    for each in (study, batch):
        with pytest.raises(ValueError, match="nonsense"):
            each.plot("nonsense")
    words = cosim.sweep(scene, {"effects.driver": ["voltage", "current"]}, ["k_max"])
    assert "current" in words._repr_html_()
    with pytest.raises(ValueError, match="not of numbers"):
        words.plot()
