"""Decks made of the shipped netlists, run by the ngspice program or by the library, for tests."""

import os
import re
import shutil
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path

import pytest

from cosim.circuits.boardgen import board_text, pin_names

NETLISTS = Path(__file__).parents[1] / "netlists"

_MEASURE = re.compile(r"^([a-z]\w*)\s*=\s*([-+.\deE]+)(?:\s+at=.*)?$", re.MULTILINE)
_LIBRARY = """
import sys
from cosim.ngspice.lines import Line
from cosim.ngspice.simulator import Simulator
simulator = Simulator()
deck = sys.stdin.read()
# a test bench includes files and measures by itself: more than a deck of ours may
simulator.load(deck, [Line(row, trusted=True) for row in deck.rstrip("\\n").split("\\n")])
lines = simulator.command("run")
print("\\n".join(lines + (simulator.command("print onoise_total") if "noise" in sys.argv else [])))
"""


def measures(printed: str) -> dict[str, float]:
    """Read the measures among ngspice's words."""
    return {name: float(value) for name, value in _MEASURE.findall(printed)}


def _beside(folder: Path) -> None:
    """Put the netlists beside a deck: ngspice takes no path with a blank in ``.lib``, quoted or not."""
    if not folder.is_relative_to(NETLISTS) and not (folder / "netlists").exists():
        (folder / "netlists").symlink_to(NETLISTS)


def run_program(deck: Path) -> str:
    """Run a deck with ``ngspice -b`` from its own folder and return all it prints."""
    if shutil.which("ngspice") is None:
        pytest.skip("the ngspice program is not installed")
    _beside(deck.parent)
    done = subprocess.run(
        ["ngspice", "-b", deck.name], cwd=deck.parent, capture_output=True, text=True, timeout=60, check=False
    )
    printed = done.stdout + done.stderr
    assert done.returncode == 0, printed
    assert "Error" not in printed, printed
    return printed


def run_library(deck: Path, *arguments: str) -> str:
    """Run a deck with libngspice in a process of its own, from the deck's folder."""
    _beside(deck.parent)
    done = subprocess.run(
        [sys.executable, "-c", _LIBRARY, *arguments],
        input=deck.read_text(),
        cwd=deck.parent,
        env={**os.environ, "PYTHONPATH": str(NETLISTS.parent)},
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def parameters(*names: str) -> dict[str, float]:
    """Return the plain-number ``.param`` lines of the named netlist files, SPICE suffixes resolved."""
    scale = {"meg": 1e6, "k": 1e3, "m": 1e-3, "u": 1e-6, "n": 1e-9, "p": 1e-12, "": 1.0}
    by_name = {}
    for name in names:
        text = (NETLISTS / name).read_text()
        for key, number, suffix in re.findall(
            r"^\.param (\w+)=([-\d.e]+)(meg|k|m|u|n|p|)\b", text, re.MULTILINE
        ):
            by_name[key] = float(number) * scale[suffix]
    return by_name


def libraries(level: str = "ideal", motor: str = "ideal", potentiometer: str = "ideal", **levels: str) -> str:
    """Return ``.lib`` lines for all parts; `levels` names parts that differ from `level`."""
    chosen = {"tl072": level, "ad633": level, "opa548": level, "motor": motor, "potentiometer": potentiometer}
    chosen.update(levels)
    return "".join(f".lib 'netlists/parts/{part}.lib' {of}\n" for part, of in chosen.items())


def board_deck(
    folder: Path,
    joints: int,
    body: str,
    *,
    sources: Mapping[str, str] | None = None,
    driver: str = "voltage",
    level: str = "ideal",
    motor: str = "ideal",
    potentiometer: str = "ideal",
    **levels: str,
) -> Path:
    """Write a deck with one board `xboard`, a source ``V<pin>`` at each input (0 unless told) and `body`."""
    board = board_text(joints).replace(".include 'blocks", ".include 'netlists/blocks")
    given = dict(sources or {})
    inputs = [pin for pin in pin_names(joints) if not pin.startswith(("imot", "vcc", "vee"))]
    assert set(given) <= set(inputs), "unknown pin"
    deck = folder / "deck.cir"
    deck.write_text(
        "a board and its sources\n"
        + board
        + f".include 'netlists/blocks/driver_{driver}.cir'\n"
        + libraries(level, motor, potentiometer, **levels)
        + "".join(f"V{pin} {pin} 0 {given.get(pin, '0')}\n" for pin in inputs)
        + "Vcc vcc 0 15\nVee vee 0 -15\n"
        + f"xboard {' '.join(pin_names(joints))} board{joints}\n"
        + f"{body}\n.end\n"
    )
    return deck
