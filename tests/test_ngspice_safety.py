"""A netlist may describe a circuit and nothing else."""

from pathlib import Path

import pytest

from cosim.errors import InputError
from cosim.ngspice.deck import load_deck
from cosim.ngspice.flatten import including
from cosim.ngspice.lines import Line
from cosim.ngspice.safety import refusal

BOARD = Path(__file__).parent / "data" / "ngspice" / "project"

REFUSED = [
    ".control",
    ".CONTROL",
    ".controls",
    ".exec ls",
    ".endc",
    "shell touch /tmp/x",
    "system ls",
    "codemodel evil.cm",
    "pre_osdi evil.osdi",
    "osdi evil.osdi",
    ".pre_osdi evil.osdi",
    ".write out.raw",
    ".wrdata out.txt v(1)",
    ".load x.raw",
    ".hdl x.va",
    ".sav all",
    ".incl 'x.cir'",
    '.model f filesource (file="/etc/passwd" amploffset=[0])',
    '.model d d_source(input_file = "x.txt")',
    '.model s d_state(state_file="x.txt")',
    '.model t table2d (offset=0 file="t.txt")',
    '.model p d_process (process_file="/bin/sh")',
    '.model c d_cosim simulation="x.so"',
    "V1 a 0 pwl file=x.txt",
    'B1 a 0 wavefile = "x.wav"',
    "N1 a b model",
    "*ng_script",
    "=x",
]
ALLOWED = [
    ".param file_gain=3",
    ".model dx d(is=1e-15)",
    ".options reltol=1e-4",
    "R1 a b 1k",
    "Xfile a b filter",
    "A1 [a] out limit1",
    "E1 a 0 POLY(2) (3,0) (4,0) 0 .5 .5",
    ".print tran v(a)",  # dropped before ngspice sees it
    "*@ role=opamp",
]


@pytest.mark.parametrize("text", REFUSED)
def test_refused(text: str) -> None:
    problem = refusal(Line(text, "x.cir", 3))
    assert problem is not None
    assert "x.cir:3" in str(problem)


@pytest.mark.parametrize("text", ALLOWED)
def test_allowed(text: str) -> None:
    assert refusal(Line(text, "x.cir", 3)) is None


def project(tmp_path: Path, board: str = "", stage: str = "", part: str = "") -> Path:
    import shutil

    shutil.copytree(BOARD, tmp_path / "p")
    for file, addition in (("board.cir", board), ("blocks/stage.cir", stage), ("parts/opx.lib", part)):
        path = tmp_path / "p" / file
        path.write_text(path.read_text() + addition)
    return tmp_path / "p" / "board.cir"


CONTROL = "\n.control\nshell touch {marker}\n.endc\n"


@pytest.mark.parametrize("place", ["board", "stage"])
def test_control_blocks_are_refused_in_nested_files(tmp_path: Path, place: str) -> None:
    board = project(tmp_path, **{place: CONTROL.format(marker="x")})
    with pytest.raises(InputError, match=r"commands in a netlist are not run") as caught:
        load_deck(board)
    assert ("board.cir" if place == "board" else "stage.cir") in str(caught.value)


def test_control_blocks_inside_a_part_are_refused(tmp_path: Path) -> None:
    board = project(tmp_path)
    file = tmp_path / "p" / "parts" / "opx.lib"
    file.write_text(file.read_text().replace(".subckt opx", ".control\nshell ls\n.endc\n.subckt opx"))
    with pytest.raises(InputError, match=r"opx.lib:9"):
        load_deck(board)


@pytest.mark.parametrize(
    "trick",
    [
        "R9 a b 1k\r.control\rshell ls\r.endc\n",  # an old line end hides a line
        ".con\n+trol\nshell ls\n.endc\n",
        "  \t.control\nshell ls\n.endc\n",
        ".include 'more.cir'\n",
    ],
)
def test_tricks_do_not_pass(tmp_path: Path, trick: str) -> None:
    board = project(tmp_path, board=trick)
    (board.parent / "more.cir").write_text("* x\n.control\nshell ls\n.endc\n")
    with pytest.raises(InputError):
        load_deck(board)


@pytest.mark.parametrize("character", ["\x0c", "\x0b", "\x1c", "\x85", "\u2028"])
def test_characters_that_end_a_line_for_some_are_refused(tmp_path: Path, character: str) -> None:
    board = project(tmp_path)
    board.write_text(board.read_text() + f"R9 a b 1k{character}.control\n", encoding="utf-8")
    with pytest.raises(InputError, match="control characters"):
        load_deck(board)


def test_script_comments_never_reach_ngspice(tmp_path: Path) -> None:
    deck = load_deck(project(tmp_path, board="*# shell ls\n*ng_script\n"))
    assert "shell" not in deck.text
    assert "ng_script" not in deck.text


def test_includes_may_not_leave_the_project(tmp_path: Path) -> None:
    (tmp_path / "outside.cir").write_text("* nothing\n.param k=1\n")
    for name in ("../outside.cir", str(tmp_path / "outside.cir"), "link.cir"):
        board = project(tmp_path, board=f".include '{name}'\n")
        (board.parent / "link.cir").symlink_to(tmp_path / "outside.cir")
        with pytest.raises(InputError, match="leaves the project"):
            load_deck(board)
        assert ".param k=1" in load_deck(board, trust=True).text
        assert ".param k=1" in load_deck(board, root=tmp_path).text
        with including([tmp_path]):
            assert ".param k=1" in load_deck(board).text
        with including([tmp_path / "p" / "blocks"]), pytest.raises(InputError, match="--include"):
            load_deck(board)
        import shutil

        shutil.rmtree(tmp_path / "p")


def test_trust_lifts_the_rules(tmp_path: Path) -> None:
    board = project(tmp_path, board=CONTROL.format(marker="x"))
    deck = load_deck(board, trust=True)
    assert ".control" in deck.text
    assert "shell touch x" in deck.text


def test_all_refusals_are_reported_at_once(tmp_path: Path) -> None:
    board = project(tmp_path, board="shell ls\n.write x\n", stage="system ls\n")
    with pytest.raises(InputError) as caught:
        load_deck(board)
    assert len(caught.value.problems) == 3
