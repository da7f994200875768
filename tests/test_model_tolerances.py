"""DEV and LOT on a .model line, as PSpice writes them: what is drawn, what ngspice gets, what is refused."""

import re
import subprocess
from pathlib import Path

import numpy as np
import pytest
from support import SCENES
from toleranced_boards import SUMMER, board, read, values

from cosim import cli
from cosim.ngspice.dialect import Dialect
from cosim.ngspice.lines import Line
from cosim.ngspice.model_tolerances import deviations
from cosim.ngspice.values import as_meant

R = "Rsp11 wsp11 sum1 {r_sum_spring}"


def meant(text: str, dialect: Dialect = Dialect.NGSPICE) -> Line:
    return as_meant(Line(text), dialect)


# ---- what is written, what ngspice gets, and the tolerances: (kind, shape, share)

_DEV, _LOT = ("dev", "uniform", 0.01), ("lot", "uniform", 0.05)
READ = [
    (".model rmod RES(R=1 DEV=1% LOT=5%)", ".model rmod r", [_DEV, _LOT]),
    (".MODEL rmod RES (R=1 LOT 5% DEV 1%)", ".MODEL rmod r", [_LOT, _DEV]),
    (".model rmod res r = 1 dev = 1 % lot = 5 %", ".model rmod r", [_DEV, _LOT]),
    (".model rmod R(r=1.0 dev=0.01)", ".model rmod r", [_DEV]),
    (".model cmod CAP(C=1 LOT/UNIFORM=5% TC1=1m)", ".model cmod c(TC1=1m)", [_LOT]),
    (".model lmod IND(L=1 DEV/GAUSS 1%)", ".model lmod l", [("dev", "gauss", 0.01)]),
    (".model m RES(R=1,DEV / gauss=1%,LOT/Uniform=5%)", ".model m r", [("dev", "gauss", 0.01), _LOT]),
    (".model rmod RES(R=1 DEV=1% TC1=1m,1u)", ".model rmod r(TC1=1m,1u)", [_DEV]),
    (".model cmod CAP", ".model cmod c", []),
    (".model cmod CAP(C=1)", ".model cmod c", []),
]  # fmt: skip


@pytest.mark.parametrize(("written", "plain", "drawn"), READ)
def test_spellings(written: str, plain: str, drawn: list[tuple[str, str, float]]) -> None:
    line = meant(written)
    assert not line.fault
    assert line.text == plain
    assert [(each.kind, each.shape, each.size) for each in deviations(line)] == drawn


@pytest.mark.parametrize(
    "text",
    [
        ".model rmod RES(R=1)", ".model rmod R(r=10k tc1=1m)", ".model d1 D(is=1e-14)", ".model lot D",
        ".model dev r(tc1=1m)", ".model q npn(bf=100 devs=1)",
    ],
)  # fmt: skip
def test_models_without_are_left_alone(text: str) -> None:
    assert meant(text) == Line(text)


@pytest.mark.parametrize(
    ("text", "why"),
    [
        (".model m RES(R=2 DEV=1%)", "R=2 is a factor of every value in PSpice, and none in ngspice"),
        (".model m CAP(C=1u)", "C=1u is a factor"),
        (".model m RES(R=1 DEV/1/GAUSS=1%)", "1/gauss is no shape that is drawn here"),
        (".model m RES(R=1 DEV/bimodal=1%)", "bimodal is no shape"),
        (".model m RES(R=1 DEV=-1%)", "is no tolerance"),
        (".model m RES(R=1 DEV=0)", "is no tolerance"),
        (".model m RES(R=1 DEV={tol})", "is no tolerance"),
        (".model m RES(R=1 DEV=)", "is no tolerance"),
        (".model m RES(R=1 LOT/GAUSS)", "is no tolerance"),
        (".model m RES(DEV=1% R=1)", "stands behind no parameter"),
        (".model m RES(R=1 DEV=1% DEV=2%)", "is stated twice"),
    ],
)
def test_what_cannot_be_drawn_is_refused(text: str, why: str) -> None:
    assert why in meant(text).fault


def test_tolerances_of_other_parameters_are_told_and_not_drawn() -> None:
    line = meant(".model q NPN(BF=100 DEV=50% IS=1f LOT=10%)")
    assert (line.text, line.note) == (".model q NPN(BF=100 IS=1f)", "tolerances of bf, is are not drawn")
    assert not deviations(line)
    line = meant(".model rmod RES(R=1 DEV=1% TC1=1m DEV=10%)")
    assert line.note == "tolerances of tc1 are not drawn"
    assert [each.size for each in deviations(line)] == [0.01]


def test_a_model_before_the_value_is_put_behind_it() -> None:
    for written, text in (
        ("r1 a b rmod 10k", "r1 a b 10k rmod"), ("C1 a b cmod {c*2} ic=0", "C1 a b {c*2} cmod ic=0"),
        ("l1 a b 1m lmod", "l1 a b 1m lmod"), ("r1 a b 10k", "r1 a b 10k"),
        ("r1 a b rmod r=10k", "r1 a b rmod r=10k"), ("c1 a b c=1u m=2", "c1 a b c=1u m=2"),
    ):  # fmt: skip
        assert meant(written).text == text


# ---- on a board


def with_models(model: str) -> tuple[tuple[str, str, str], ...]:
    """The springs' resistors of one joint's row from a model, the second of twice the value."""
    text = ".subckt board2"
    return (
        ("board2.cir", text, f"{model}\n{text}"),
        ("board2.cir", R, "Rsp11 wsp11 sum1 rmod 24.3k"),
        ("board2.cir", "Rsp12 wsp12 sum1 {r_sum_spring}", "Rsp12 wsp12 sum1 48.6k rmod"),
    )


def test_each_element_draws_its_dev_and_all_share_the_lot(tmp_path: Path) -> None:
    """Uniform: variance tol^2/3; deviations are lot + dev of the value that each element states."""
    result = read(tmp_path, *with_models(".model rmod RES(R=1 DEV=1% LOT=5%)"))
    of = {each.key: each for each in result.components}
    assert (of["rsp11"].nominal, of["rsp12"].nominal) == (24.3e3, 48.6e3)
    assert of["rsp11"].lots == of["rsp12"].lots == ("lot:rmod",)
    assert Path(of["rsp11"].file).name == "board2.cir"
    n = 4000
    drawn = values(result, n)
    off = np.array([drawn["rsp11"] / 24.3e3, drawn["rsp12"] / 48.6e3]) - 1.0
    expected = (0.05**2 * np.ones((2, 2)) + 0.01**2 * np.eye(2)) / 3.0
    np.testing.assert_allclose(np.cov(off), expected, rtol=5 * np.sqrt(2 / n))
    own = off[0] - off[1]
    assert np.abs(own).max() <= 0.02
    assert np.abs(off).max() <= 0.06
    assert abs(np.corrcoef(own, off.mean(axis=0))[0, 1]) < 5 / np.sqrt(n)


def test_gauss_is_a_standard_deviation_within_three(tmp_path: Path) -> None:
    result = read(tmp_path, *with_models(".model rmod RES(R=1 DEV/GAUSS=1%)"))
    off = values(result)["rsp11"] / 24.3e3 - 1.0
    assert off.std() == pytest.approx(0.98659 * 0.01, rel=0.05)  # 5 standard errors of 4000
    assert 0.02 < np.abs(off).max() <= 0.03


def test_an_element_s_own_tolerance_comes_before_its_model_s(tmp_path: Path) -> None:
    edits = with_models(".model rmod RES(R=1 DEV=1% LOT=5%)")
    own = (*edits[:1], ("board2.cir", R, "Rsp11 wsp11 sum1 rmod 24.3k $ tol=0.1% uniform"), *edits[2:])
    result = read(tmp_path, *own)
    assert np.abs(values(result)["rsp11"] / 24.3e3 - 1.0).max() <= 0.001


def test_the_board_runs_as_without_and_in_plain_ngspice(tmp_path: Path) -> None:
    """The loader's deck has neither word; plain ngspice ignores both for resistors, and reads the values."""
    from cosim.ngspice.deck import load_deck

    models = (".model rmod RES(R=1 DEV=1% LOT=5%)", ".model rmod r")
    decks = [load_deck(board(tmp_path / str(k), *with_models(m))).text for k, m in enumerate(models)]
    paths = [re.sub(r"netlists/.*", "", deck) for deck in decks]
    assert [line for line in paths[0].splitlines() if "rmod" in line] == [
        line for line in paths[1].splitlines() if "rmod" in line
    ]
    deck = tmp_path / "plain.cir"
    deck.write_text(
        f"divider\n{models[0]}\nv1 a 0 3\nr1 a b rmod 20k\nr2 b 0 10k rmod\n.op\n.print op v(b)\n.end\n"
    )
    plain = subprocess.run(["ngspice", "-b", str(deck)], capture_output=True, text=True, timeout=60)
    assert re.search(r"^\s*b\s+1\.0+e\+00", plain.stdout, re.M), plain.stdout


def test_a_refusal_names_file_and_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = board(tmp_path, *with_models(".model rmod RES(R=1 DEV/1=1%)"))
    line = 1 + file.read_text().splitlines().index(".model rmod RES(R=1 DEV/1=1%)")
    words = ("--set", f"device.board={file}", "-n", "2", "-o", str(tmp_path / "out"))
    assert cli.main(["mc", str(SCENES / "press.toml"), *words]) == 2
    told = capsys.readouterr().err
    assert f"board2.cir:{line}" in told
    assert "1 is no shape that is drawn here" in told


def test_elements_of_a_part_and_values_of_the_user(tmp_path: Path) -> None:
    """A block's own model, and a value from outside in place of the one behind a model."""
    edits = (
        (SUMMER, ".subckt summer", ".model rmod RES(R=1 DEV=1%)\n.subckt summer"),
        *with_models("* none")[1:],
    )
    result = read(tmp_path, *edits, overrides=("device.values.rsp11=20k",))
    of = {each.key: each for each in result.components}
    assert of["rsp11"].nominal == 20e3
    assert Path(of["rsp11"].file).name == "summer.cir"
