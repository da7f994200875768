"""Slips on a board that a model may not see: each is reported, and what is meant so is not."""

import re
from pathlib import Path
from shutil import copytree

import pytest

from cosim.assets import netlists_folder, scenes_folder
from cosim.caution import Caution, collected
from cosim.plan import resolve
from cosim.scene import load_scene

OPAMP = r"(?m)^xop 0 sum vcc vee out tl072$"
CODES = ("supplies-crossed", "source-held", "parameter-twice")
RESISTOR = r"(?m)^R31 .*$"


def doubts(tmp_path: Path, block: str, written: str, edited: str, *overrides: str) -> list[Caution]:
    """Resolve the slope on a board of which one block is edited; return what is doubted of the edit."""
    copytree(netlists_folder(), tmp_path / "netlists")
    file = tmp_path / "netlists" / block
    text, count = re.subn(written, edited, file.read_text(), count=1)
    assert count == 1
    file.write_text(text)
    board = f"device.board={(tmp_path / 'netlists/board2.cir').as_posix()!r}"
    with collected(forward=False) as cautions:
        resolve(load_scene(scenes_folder() / "slope.toml", [board, *overrides]))
    return [each for each in cautions if each.code in CODES]


@pytest.mark.parametrize(
    ("block", "written", "edited", "paths", "fault"),
    [
        ("blocks/summer.cir", OPAMP, "xop 0 sum vee vcc out tl072", ["xsum1.xop", "xsum2.xop"], "crossed"),
        ("blocks/summer.cir", OPAMP, "xop 0 sum vcc vcc out tl072", ["xsum1.xop", "xsum2.xop"], "on one net"),
        ("blocks/summer.cir", OPAMP, "xop 0 sum 0 vee out tl072", ["xsum1.xop", "xsum2.xop"], "at ground"),
        ("board2.cir", r"(?m)^(xder2 .*) vcc vee ", r"\1 vee vcc ", ["xder2.xop"], "crossed"),
        ("board2.cir", r"(?m)^(xksp11 .*) vcc vee ", r"\1 vee vcc ", ["xksp11.xmul"], "crossed"),
        ("board2.cir", r"(?m)^(xdrv2 .*) vcc vee ", r"\1 vee vcc ", ["xdrv2.xop"], "crossed"),
    ],
)
def test_supplies_that_nobody_wires_so(
    tmp_path: Path, block: str, written: str, edited: str, paths: list[str], fault: str
) -> None:
    """With plain op-amps the wall is as stiff as ever: their model does not look at its supplies."""
    found = doubts(tmp_path, block, written, edited)
    assert [each.text.split()[0] for each in found] == [f"xboard.{path}" for path in paths]
    assert all(fault in each.text for each in found)


@pytest.mark.parametrize(
    ("written", "edited"),
    [
        (OPAMP, "xop 0 sum vcc 0 out tl072"),  # a single supply
        (OPAMP, "xop 0 sum vp vee out tl072\nRf vcc vp 10\nCf vp 0 100n"),  # a filter in the supply
        (OPAMP, "xop sum 0 vcc vee out tl072"),  # the inputs: the stability verdict's
    ],
)
def test_supplies_that_may_be_meant(tmp_path: Path, written: str, edited: str) -> None:
    assert doubts(tmp_path, "blocks/summer.cir", written, edited) == []


@pytest.mark.parametrize(
    "source",
    [
        "V1 o2 out sin(0 0.1 50)",
        "V1 o2 out dc 0 SIN (0 0.1 50)",
        "V1 o2 out pwl(0 0 1 5)",
        "V1 o2 out trnoise(1m 1u 0 0)",
        "B1 o2 out v=0.1*sin(100*time)",
        "E1 o2 out vol='0.1*TIME'",
    ],
)
def test_a_source_that_changes_with_time_is_held_by_linear(tmp_path: Path, source: str) -> None:
    edited = f"R31 sum o2 {{r31}}\n{source}"
    (found,) = doubts(tmp_path, "blocks/summer.cir", RESISTOR, edited, "solver.model=linear")
    assert re.search(r"summer\.cir:9: [VBE]1 changes with time", found.text)


@pytest.mark.parametrize(
    ("source", "model"),
    [
        ("V1 o2 out sin(0 0.1 50)", "spice"),
        ("V1 o2 out 0", "linear"),
        ("V1 o2 out dc 1m ac 1", "linear"),
        ("B1 o2 out v=0.1*sin(100*v(sum))", "linear"),
        ("Rtime o2 out 1m", "linear"),
    ],
)
def test_sources_that_the_model_has_are_no_slip(tmp_path: Path, source: str, model: str) -> None:
    edited = f"R31 sum o2 {{r31}}\n{source}"
    assert doubts(tmp_path, "blocks/summer.cir", RESISTOR, edited, f"solver.model={model}") == []


@pytest.mark.parametrize(
    ("written", "edited", "said"),
    [
        (
            r"(?m)^\.param r_sum_fb=10.0k .*$",
            r".param r_sum_fb=20k\n\g<0>",
            "the value 20k in line 2;",
        ),
        (
            r"(?m)^\.param r_sum_fb=10.0k .*$",
            r".param R_SUM_FB=20k r_sum_fb=10k",
            "20k in line 2;",
        ),
        (RESISTOR, r".param x=1\n\g<0>\n.param X=2", "X = 2: has the value 1 in line 8;"),
    ],
)
def test_a_parameter_with_two_values(tmp_path: Path, written: str, edited: str, said: str) -> None:
    found = doubts(tmp_path, "blocks/summer.cir", written, edited)
    assert [each.code for each in found] == ["parameter-twice"]
    assert said in found[0].text


@pytest.mark.parametrize(
    ("written", "edited"),
    [
        (r"(?m)^\.param r_sum_fb=10.0k .*$", r"\g<0>\n.param r_sum_fb=10.0k"),  # the same again
        (RESISTOR, r".param r_sum_fb=20k\n\g<0>"),  # of its own inside a subcircuit
    ],
)
@pytest.mark.parametrize("value", ["xsum1.r31=11k", "r_sum_fb=11k"])
def test_a_parameter_with_one_value_in_each_place(
    tmp_path: Path, written: str, edited: str, value: str
) -> None:
    """Also where one placed block is edited, which gets a subcircuit of its own."""
    assert doubts(tmp_path, "blocks/summer.cir", written, edited, f"device.values.{value}") == []


def test_a_board_sets_what_its_blocks_have_as_their_default(tmp_path: Path) -> None:
    edited = r"\g<0>\n.param r_sum_fb=20k"
    assert doubts(tmp_path, "board2.cir", r"(?m)^\.include 'blocks/summer.cir'$", edited) == []
