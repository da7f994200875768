"""The loader: flat decks, parts, swaps, overrides, origins."""

from pathlib import Path

import pytest

from cosim.errors import InputError
from cosim.ngspice.deck import Deck, PartSwap, board_pins, load_deck
from cosim.ngspice.dialect import Dialect
from cosim.ngspice.lines import number, read_lines, tokens

DATA = Path(__file__).parent / "data" / "ngspice"
BOARD = DATA / "project" / "board.cir"
REAL = Path(__file__).parent.parent / "netlists"


def statements(deck: Deck, keyword: str) -> list[str]:
    return [line.text for line in deck.lines if line.keyword == keyword]


def rewrite(tmp_path: Path, old: str, new: str, file: str = "board.cir") -> Path:
    """Copy the small project with one edit; return its board."""
    import shutil

    project = tmp_path / "project"
    shutil.copytree(DATA / "project", project)
    text = (project / file).read_text()
    assert old in text
    (project / file).write_text(text.replace(old, new))
    return project / "board.cir"


def test_deck_is_flat_and_knows_its_board() -> None:
    deck = load_deck(BOARD)
    assert deck.board == "board1"
    assert deck.joints == 1
    assert sorted(deck.pins) == sorted(board_pins(1))
    assert ".lib" not in deck.text
    assert ".include" not in deck.text
    assert ".tran" not in deck.text
    assert len(statements(deck, ".subckt")) == 6  # board, stage, driver, opx, power, motor
    assert [part.name for part in deck.parts] == ["motor", "opx", "power"]
    assert any(".save" in note for note in deck.notes)


def test_deck_is_deterministic_and_carries_no_path(tmp_path: Path) -> None:
    copy = rewrite(tmp_path, "a line of", "a line of")
    assert load_deck(copy).text == load_deck(BOARD).text
    assert load_deck(copy).digest == load_deck(BOARD).digest


def test_every_line_knows_its_origin() -> None:
    deck = load_deck(BOARD)
    for line in deck.lines[1:]:
        source = Path(line.file).read_text().splitlines()
        if line.keyword != ".ends":
            assert source[line.lineno - 1].lower().split()[0] == line.keyword


def test_levels_choose_sections_and_the_kind_of_drive() -> None:
    plain = load_deck(BOARD)
    deck = load_deck(
        BOARD, levels={"opamp": "gbw", "driver": "current", "driver_level": "full", "motor": "emf"}
    )
    assert "C1 x 0 53p" in deck.text
    assert "C1 x 0 53p" not in plain.text
    assert "Rk drv 0 1k" in deck.text
    assert "Rk drv 0 2k" in plain.text
    assert "Rout x out 1" in deck.text
    assert "0.04*V(vel)" in deck.text


@pytest.mark.parametrize(
    ("levels", "words"),
    [
        ({"opamp": "full"}, ["opx.lib", "full", "ideal, gbw"]),
        ({"driver": "hydraulic"}, ["hydraulic", "current, voltage"]),
        ({"opam": "gbw"}, ["nearest is opamp"]),
    ],
)
def test_unknown_level_is_refused(levels: dict[str, str], words: list[str]) -> None:
    with pytest.raises(InputError) as caught:
        load_deck(BOARD, levels=levels)
    for word in words:
        assert word in str(caught.value)


def test_amplifiers_have_the_names_ngspice_gives_their_outputs() -> None:
    by_name = {a.path: (a.part, a.role, a.out_node, a.swing_param) for a in load_deck(BOARD).amplifiers}
    assert by_name == {
        "xboard.xdiff1.xop": ("opx", "opamp", "xboard.x1", "opx_swing"),
        "xboard.xsum1.xop": ("opx", "opamp", "xboard.o", "opx_swing"),
        "xboard.xdrv.xop": ("power", "driver", "xboard.xdrv.drv", None),
    }


def test_part_for_part_swap_maps_pins_by_name() -> None:
    deck = load_deck(BOARD, parts={"opx": "opy"})
    assert "xop out vcc vee inn inp opy" in deck.text
    assert ".subckt opx" not in deck.text
    assert {a.part for a in deck.amplifiers if a.role == "opamp"} == {"opy"}
    assert load_deck(BOARD, parts={"opamp": "OPY"}).text == deck.text


@pytest.mark.parametrize("pins", ["1 2 3 4 5", "p m vcc vee out", ["1", "2", "3", "4", "5"]])
def test_vendor_model_by_pin_map(pins: str) -> None:
    deck = load_deck(BOARD, parts={"opamp": PartSwap(DATA / "vendor" / "boyle.lib", "tl072", pins)})
    assert "xop inp inn vcc vee out tl072" in deck.text
    assert ".SUBCKT OTHER" not in deck.text  # what the model does not need stays out
    assert ".MODEL JX" in deck.text
    assert {a.out_node for a in deck.amplifiers if a.part == "tl072"} == {"xboard.x1", "xboard.o"}


def test_vendor_model_in_pspice_dialect_says_so_in_the_deck() -> None:
    swap = PartSwap(DATA / "vendor" / "pspice.lib", "OPA_PS", "in+ in- v+ v- out", "pspice")
    deck = load_deck(BOARD, parts={"opamp": swap})
    assert deck.lines[1].text == "*@ ngbehavior=psa"
    assert "EDIFF $N_0001 0" in deck.text
    assert "xop out inp inn vcc vee opa_ps" in deck.text
    assert ".SUBCKT LAG" in deck.text
    assert ".PARAM TAU" in deck.text


@pytest.mark.parametrize(
    ("parts", "words"),
    [
        ({"opx": "opz"}, ["no such part", "nearest is op"]),
        ({"opamps": "opy"}, ["nearest is opamp"]),
        ({"opx": "power"}, None),
        ({"opx": "motor"}, ["pins of motor", "p m vcc vee out"]),
        ({"opx": PartSwap(DATA / "vendor" / "boyle.lib", "TL071", "1 2 3 4 5")}, ["nearest is tl072"]),
        (
            {"opx": PartSwap(DATA / "vendor" / "boyle.lib", "TL072", "1 2 3 4")},
            ["1 2 3 4 5", "p m vcc vee out"],
        ),
        ({"opx": PartSwap(DATA / "vendor" / "none.lib", "TL072", "1 2 3 4")}, ["none.lib", "No such file"]),
        ({"opx": PartSwap(DATA / "vendor" / "boyle.lib", "TL072", "", "hspice")}, ["dialect", "pspice"]),
    ],
)
def test_wrong_swaps(parts: dict[str, PartSwap | str], words: list[str] | None) -> None:
    if words is None:  # another part with the same pins is allowed, whatever its role
        assert "power" in {part.name for part in load_deck(BOARD, parts=parts).parts}
        return
    with pytest.raises(InputError) as caught:
        load_deck(BOARD, parts=parts)
    for word in words:
        assert word in str(caught.value)


def test_override_of_a_parameter_reaches_every_use() -> None:
    deck = load_deck(BOARD, overrides={"R_FB": "47k"})
    assert ".param r_in=10k r_fb=47k" in deck.text


def test_override_of_an_element_and_of_one_instance() -> None:
    deck = load_deck(
        BOARD, overrides={"r3": "12k", "xdiff1.r2": "22k", "xsum1.R12": "{r_fb*2}", "xsum1.r1": "5k"}
    )
    assert "R3 cmd1 s 12k" in deck.text
    assert "xdiff1 u1 pot1 x1 vcc vee stage r2=22k" in deck.text
    copies = [line for line in statements(deck, ".subckt") if "__" in line]
    assert len(copies) == 1
    assert "R12 inn out {r_fb*2}" in deck.text
    assert "R12 inn out {r2}" in deck.text  # the other instance keeps its own
    assert next(row for row in deck.text.splitlines() if row.startswith("xsum1")).endswith("r1=5k")
    assert len(deck.amplifiers) == 3  # a copied subcircuit still holds its amplifier


def test_override_finds_board_elements_before_those_inside_parts() -> None:
    deck = load_deck(BOARD, levels={"opamp": "gbw"}, overrides={"R1": "33k"})
    assert "R1 w s 33k" in deck.text
    assert "R1 x 0 {opx_gain*1k}" in deck.text


def test_wrong_overrides_are_reported_at_once() -> None:
    wrong = {
        "r_fbb": "1k",
        "xdif1.r1": "1k",
        "xdiff1.r9": "1k",
        "r3": "1k\n.control",
        "R2": "nan",
        "Bspring": "1",
    }
    with pytest.raises(InputError) as caught:
        load_deck(BOARD, overrides=wrong)
    text = str(caught.value)
    assert len(caught.value.problems) == len(wrong)
    assert "nearest is r_fb" in text
    assert "nearest is xdiff1" in text
    assert "not an element with one value" in text


def test_two_subcircuits_with_one_designator_are_ambiguous(tmp_path: Path) -> None:
    board = rewrite(tmp_path, "R3 cmd1 s 10k", "R3 cmd1 s 10k\nR11 s 0 1meg")
    with pytest.raises(InputError, match="several subcircuits"):
        load_deck(board, overrides={"R11": "1k"})


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("+ cmd1 imot1 $", "+ imot1 $", ["lacks the pin", "cmd1", "board.cir:7"]),
        ("+ vcc vee\n", "+ vcc vee usp1\n", ["unknown pin", "usp1"]),
        ("+ vcc vee\n", "+ vcc vee pot2\n", ["unknown pin", "pot2"]),
        ("+ vcc vee\n", "+ vcc vee vcc\n", ["twice"]),
        (
            "vcc vee stage\nB",
            "vcc vee stagee\nB",
            ["'stagee' is not defined", "nearest is stage", "board.cir:12"],
        ),
        ("vcc vee stage\nB", "vcc stage\nB", ["4 nodes", "stage has 5", "board.cir:12"]),
        ("blocks/stage.cir", "blocks/stag.cir", ["board.cir:5", "nearest is stage.cir"]),
        (".ends Board1", "", [".subckt board1 without .ends"]),
        ("* a comment between", ".ends\n.ends\n* a", [".ends without .subckt"]),
        ("R3 cmd1 s 10k", "R3 cmd1 s", ["board.cir:17", "has no value"]),
        ("R3 cmd1 s 10k", "R3 cmd1 s {r_in", ["board.cir:17", "'{' is not closed"]),
        ("V(ksp11)/10", "V(ksp11))/10", ["board.cir:13", "')' closes nothing"]),
        ("R3 cmd1 s 10k", "R2 cmd1 s 10k", ["board.cir:17", "R2 is defined again", "board.cir:16"]),
        (".save all", ".sav all", ["unknown statement", ".sav all"]),
    ],
)
def test_wrong_boards_name_file_line_and_remedy(tmp_path: Path, old: str, new: str, words: list[str]) -> None:
    with pytest.raises(InputError) as caught:
        load_deck(rewrite(tmp_path, old, new))
    for word in words:
        assert word in str(caught.value)


def test_no_board_and_no_file(tmp_path: Path) -> None:
    (tmp_path / "x.cir").write_text(".subckt foo a b\nR1 a b 1k\n.ends\n")
    with pytest.raises(InputError, match=r"must hold one board.*foo"):
        load_deck(tmp_path / "x.cir")
    with pytest.raises(InputError, match="No such file"):
        load_deck(tmp_path / "y.cir")
    (tmp_path / "z.cir").write_bytes(b"\x7fELF\0\0")
    with pytest.raises(InputError, match="control characters"):
        load_deck(tmp_path / "z.cir")


def test_a_board_that_includes_itself(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="includes itself"):
        load_deck(rewrite(tmp_path, "blocks/stage.cir", "board.cir"))


def test_same_name_with_two_meanings(tmp_path: Path) -> None:
    board = rewrite(tmp_path, ".save all", ".subckt stage a b\nR1 a b 1\n.ends")
    with pytest.raises(InputError, match=r"stage is defined again.*stage.cir:2"):
        load_deck(board)


def test_a_misspelt_node_is_noted(tmp_path: Path) -> None:
    deck = load_deck(rewrite(tmp_path, "R2 y s 10k", "R2 y sx 10k"))
    assert any("board1" in note and "sx" in note for note in deck.notes)
    assert not any("terminal" in note for note in load_deck(BOARD).notes)


def test_kicad_export_loads(tmp_path: Path) -> None:
    board = rewrite(tmp_path, "x1", "/Spring/X_1")
    text = board.read_text().replace("V(/Spring/X_1)", 'V("/Spring/X_1")')
    board.write_text(text.replace('V=V("/Spring/X_1")*V(ksp11)/10', "V=V(ksp11)/10"))
    assert "xboard./spring/x_1" in {a.out_node for a in load_deck(board).amplifiers}


def test_pyspice_text_and_a_test_bench_in_the_same_file_load(tmp_path: Path) -> None:
    board = rewrite(tmp_path, "* A board of one joint", ".title A board\n* of one joint")
    board.write_text(board.read_text() + "Vtest a 0 1\nRtest a 0 1k\n.op\n.end\n")
    deck = load_deck(board)
    assert deck.text == load_deck(BOARD).text
    assert any("Vtest, Rtest" in note for note in deck.notes)


def test_a_title_line_is_not_an_element(tmp_path: Path) -> None:
    board = rewrite(tmp_path, "* A board of one joint", "Some title 1 2 3")
    assert load_deck(board).text == load_deck(BOARD).text


def test_real_boards_load_at_every_level() -> None:
    for file, joints in (("board1.cir", 1), ("board2.cir", 2)):
        for level in ("ideal", "gbw", "full"):
            for drive in ("voltage", "current"):
                levels = {"opamp": level, "vca": level, "driver_level": level, "driver": drive}
                deck = load_deck(REAL / file, levels=levels)
                assert deck.joints == joints
                assert not deck.notes
                # a joint has summing amplifier, driver and difference amplifier, a pair two multipliers
                assert len(deck.amplifiers) >= 3 * joints + 2 * joints**2


def test_comments_and_continuations(tmp_path: Path) -> None:
    file = tmp_path / "x.cir"
    file.write_bytes(
        b"\xef\xbb\xbfr1 a b 1k ; tail\r\n* whole\r\n\r\n+ tol=1 $ more\r\n"
        b"b1 n$1 0 v='a;b' // x\r\nr2 a,$ c\n"
    )
    lines = read_lines(file)
    assert [line.text for line in lines] == ["r1 a b 1k tol=1", "b1 n$1 0 v='a;b'", "r2 a,"]
    assert lines[0].comment == "tail more"
    assert [line.lineno for line in lines] == [1, 5, 6]
    assert read_lines(file, Dialect.PSPICE)[-1].text == "r2 a,$ c"


def test_tokens_and_numbers() -> None:
    assert tokens("r1 a b {x + 1} k = 2 v='a b' c=={d}") == [
        "r1",
        "a",
        "b",
        "{x + 1}",
        "k=2",
        "v='a b'",
        "c=={d}",
    ]
    # the scales of the ngspice manual, 2.3.2: M is milli, MEG mega, units are ignored
    expected = {
        "8.2k": 8200.0,
        "3MEG": 3e6,
        "3M": 3e-3,
        "1e-3u": 1e-9,
        "100nF": 1e-7,
        "-.5": -0.5,
        "10kOhm": 1e4,
    }
    for text, value in expected.items():
        assert number(text) == pytest.approx(value, rel=1e-15)
    for text in ("nan", "inf", "k", "", "1k 2", "{x}"):
        assert number(text) is None


def test_a_node_that_only_current_sources_touch_is_refused_across_subcircuits(tmp_path: Path) -> None:
    """ngspice gives it no row and no word (hard case 41); what feeds it may lie inside a subcircuit."""
    feed, end = ".subckt feed a b\nI1 0 a 1m\nR1 b 0 1k\n.ends\n", ".ends Board1"
    board = rewrite(tmp_path, end, f"Xf lost u1 feed\n{end}\n{feed}")
    with pytest.raises(InputError, match=r"floating node: xboard\.lost has no DC path to ground") as caught:
        load_deck(board)
    assert caught.value.problems[0].value == "I1 0 a 1m"
    board.write_text(board.read_text().replace(end, f"R99 lost 0 1k\n{end}"))
    load_deck(board)
