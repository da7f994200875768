"""Every example in a docstring is run; every public name has one."""

import doctest
import importlib
import inspect
from pathlib import Path

import pytest

import cosim

ROOT = Path(__file__).resolve().parents[1]
FLAGS = doctest.NORMALIZE_WHITESPACE


def modules() -> list[str]:
    """Names of the modules with examples."""
    paths = (path for top in ("cosim", "mech", "reports") for path in sorted((ROOT / top).rglob("*.py")))
    names = (
        ".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__")
        for path in paths
        if ">>> " in path.read_text(encoding="utf-8")
    )
    return list(names)


MODULES = modules()


# A scene that is shortened until nothing touches is a doubtful one; that is not its example's point.
@pytest.mark.filterwarnings("ignore::cosim.caution.Doubt")
@pytest.mark.parametrize("name", MODULES)
def test_examples(name: str) -> None:
    failed, tried = doctest.testmod(importlib.import_module(name), optionflags=FLAGS)
    assert tried
    assert not failed


def test_there_are_examples_enough() -> None:
    finder = doctest.DocTestFinder(exclude_empty=True)
    rows = [test for name in MODULES for test in finder.find(importlib.import_module(name)) if test.examples]
    assert len(rows) >= 40


@pytest.mark.parametrize("name", [name for name in cosim.__all__ if name != "errors"])
def test_a_public_name_has_an_example(name: str) -> None:
    text = inspect.getdoc(getattr(cosim, name)) or ""
    own = [inspect.getdoc(member) or "" for member in vars(getattr(cosim, name)).values() if callable(member)]
    assert ">>> " in "\n".join([text, *own]), f"{name} has no example"
