"""Compiled code on disk: never stale, never damaged, and the same for a moved installation."""

import math
import os
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from cosim import numba_cache

ROOT = Path(__file__).resolve().parents[1]
#: A small function with a known value; prints it, and how often numba compiled it.
CALL = """
import cosim
from cosim.loop.linear.divided_differences import expm1
print(expm1(1.0 + 0.0j).real, sum(expm1.stats.cache_misses.values()))
"""


def call(place: Path, cache: Path, **more: str) -> tuple[float, int]:
    """Call it from the sources in `place`, in a process of its own."""
    env = {**os.environ, "NUMBA_CACHE_DIR": str(cache), "PYTHONPATH": str(place), **more}
    done = subprocess.run(
        [sys.executable, "-c", CALL], cwd=cache, env=env, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    value, misses = done.stdout.split()
    return float(value), int(misses)


@pytest.fixture(scope="module")
def warm(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A cache that holds the function."""
    cache = tmp_path_factory.mktemp("code")
    assert call(ROOT, cache) == (pytest.approx(math.expm1(1.0), rel=1e-15), 1)
    assert call(ROOT, cache)[1] == 0
    return cache


@pytest.mark.few(2)
@pytest.mark.parametrize(
    "damage",
    [
        lambda code: b"",
        lambda code: code[: len(code) // 2],
        lambda code: code[:-1],
        lambda code: code[:400] + bytes([code[400] ^ 8]) + code[401:],
        lambda code: b"\0" * len(code),
        lambda code: code + b"x",
    ],
)
@pytest.mark.parametrize("ending", ["nbi", "nbc"])
def test_damaged_code_is_compiled_anew(warm: Path, tmp_path: Path, ending: str, damage: Any) -> None:
    cache = tmp_path / "code"
    shutil.copytree(warm, cache)
    files = list(cache.rglob(f"*expm1*.{ending}"))
    assert len(files) == 1
    code = files[0].read_bytes()
    files[0].write_bytes(damage(code))
    assert call(ROOT, cache) == (pytest.approx(math.expm1(1.0), rel=1e-15), 1)
    assert call(ROOT, cache)[1] == 0


def test_a_child_reads_its_parents_code_and_the_parent_never_a_childs(warm: Path, tmp_path: Path) -> None:
    child, parent = tmp_path / "code-children", tmp_path / "code"
    child.mkdir()
    assert call(ROOT, child, COSIM_PARENTS_CODE=str(warm))[1] == 0
    assert not list(child.rglob("*.nbc"))
    # a parent that has nothing: the child compiles for itself, and the parent again
    parent.mkdir()
    assert call(ROOT, child, COSIM_PARENTS_CODE=str(parent))[1] == 1
    assert call(ROOT, child, COSIM_PARENTS_CODE=str(parent))[1] == 0
    assert call(ROOT, parent)[1] == 1


@pytest.mark.slow
def test_a_moved_installation_keeps_its_code(warm: Path, tmp_path: Path) -> None:
    place = tmp_path / "moved here"
    for folder in ("cosim", "mech"):
        shutil.copytree(ROOT / folder, place / folder, ignore=shutil.ignore_patterns("__pycache__"))
    cache = tmp_path / "code"
    shutil.copytree(warm, cache)
    assert call(place, cache)[1] == 0
    with (place / "cosim" / "loop" / "linear" / "divided_differences.py").open("a") as stream:
        stream.write("# changed\n")
    assert call(place, cache)[1] == 1


def test_a_module_is_compiled_anew_when_what_it_imports_changes(tmp_path, monkeypatch):
    """The folder changes with every source in the closure, and with no other."""
    before = {name: numba_cache.code_folder(name).name for name in numba_cache._sources()}
    sources = dict(numba_cache._sources())
    sources["mech.kinematics"] += b"\n"
    monkeypatch.setattr(numba_cache, "_sources", lambda: sources)
    changed = {name for name, folder in before.items() if numba_cache.code_folder(name).name != folder}
    assert changed == {name for name in sources if "mech.kinematics" in numba_cache._closure(name)}
    assert "mech.kinematics" in changed
    assert "cosim.loop.spice.coupling" in changed
    assert "cosim.loop.linear.matrix_phi" not in changed


def test_imports_are_found_in_every_form(monkeypatch):
    text = b"import mech.a, mech.b as b\nfrom mech.c import (\n    d,\n    e,  # word\n)\n"
    text += b"if x:\n    from mech import f, g as h\n"
    names = ("x", *(f"mech.{c}" for c in "abcfg"), "mech.c.d", "mech.c.e", "mech")
    monkeypatch.setattr(
        numba_cache, "_sources", lambda: {name: text if name == "x" else b"" for name in names}
    )
    numba_cache._imports.cache_clear()
    try:
        assert numba_cache._closure("x") == set(names)
    finally:
        numba_cache._imports.cache_clear()


@pytest.mark.slow
@pytest.mark.own_process
def test_warm_compiles_ahead_and_says_where(capsys: pytest.CaptureFixture[str]) -> None:
    from cosim import cli
    from cosim.numba_cache import cache_folder, is_warm

    assert cli.main(["warm"]) == 0
    out, err = capsys.readouterr()
    assert is_warm()
    assert cache_folder() in out
    assert "exact propagation: " in err
    assert "in step with ngspice: " in err
    assert "warning" not in err  # doubts about its own short runs are nobody's
