"""How netlists are read as people and vendors write them: encodings, values, libraries, sizes."""

import os
import shutil
import time
from contextlib import suppress
from pathlib import Path

import pytest
from support import scene_of, slider

from cosim.caution import collected
from cosim.circuits.design_constants import DesignConstants
from cosim.errors import InputError
from cosim.ngspice.deck import Deck, Feature, PartSwap, load_deck
from cosim.ngspice.dialect import Dialect
from cosim.ngspice.expression import evaluate
from cosim.ngspice.lines import Line, number, read_lines
from cosim.ngspice.syntax import malformed
from cosim.ngspice.values import as_meant
from cosim.plan import resolve
from cosim.scene import load_scene

DATA = Path(__file__).parent / "data" / "ngspice"
BOARD = DATA / "project" / "board.cir"
#: An op-amp of one pole and 100 Ohm: GBW 3 MHz, gain 200,000.
BODY = "ga 0 x 1 2 1m\nra x 0 200meg\nca x 0 53p\neo y 0 x 0 1\nro y 5 100\nrp 3 4 10k\n"
MYOP = f".subckt MYOP 1 2 3 4 5\n{BODY}.ends\n"


def library(folder: Path, text: str | bytes, dialect: str = "pspice", subckt: str = "MYOP") -> Deck:
    """Load the small board with its op-amp out of a vendor's library."""
    file = folder / "vendor.lib"
    file.write_bytes(text if isinstance(text, bytes) else text.encode())
    return load_deck(BOARD, parts={"opamp": PartSwap(file, subckt, "1 2 3 4 5", dialect)})


def project(folder: Path, addition: str = "", **edits: str) -> Path:
    """Copy the small board with lines in its block `stage` (and at its end), return its file."""
    copy = folder / "project"
    shutil.copytree(BOARD.parent, copy)
    stage = copy / "blocks" / "stage.cir"
    text = stage.read_text()
    assert ".ends" in text
    stage.write_text(text.replace(".ends", f"{edits.get('inside', '')}\n.ends") + edits.get("behind", ""))
    board = copy / "board.cir"
    board.write_text(board.read_text() + addition)
    return board


# --- characters and line ends -------------------------------------------------------------------------


@pytest.mark.parametrize(
    "raw",
    [
        MYOP.encode() + b"\x1a",
        MYOP.replace("\n", "\r\n").encode() + b"\x1a\x00\x00\x1a\r\n",
        MYOP.replace("\n", "\r").encode(),
        MYOP.replace(" ", "\t \t").encode(),
        MYOP.replace(" ", "\u00a0").encode("cp1252"),
        b"* 5 \xb5V, \x85 \x93typical\x94\n" + MYOP.encode(),
        b"\x0c" + MYOP.encode(),
        MYOP.encode("utf-8-sig"),
        MYOP.encode("utf-16"),
        MYOP.encode("utf-16-le"),
        MYOP.encode("utf-16-be"),
        MYOP.replace(".ends", ".ENDS* the next part follows").encode(),
        MYOP.replace(".ends", ".ends;end").encode(),
    ],
    ids=["eof", "dos", "cr", "tab", "nbsp", "cp1252", "page", "bom", "utf16", "le", "be", "star", "glued"],
)
def test_libraries_as_they_are_saved(tmp_path: Path, raw: bytes) -> None:
    plain = library(tmp_path, MYOP)
    assert library(tmp_path, raw).text == plain.text


@pytest.mark.parametrize("character", [*"\x00\x0b\x0c\x1b\x1c\x1d\x1e\x1f\x7f\x85\u2028\u2029\u200b\ufeff"])
def test_no_row_is_two_rows_to_another_reader(tmp_path: Path, character: str) -> None:
    with pytest.raises(InputError, match="control characters"):
        load_deck(project(tmp_path, inside=f"R9 sum 0 1k{character}R8 sum 0 1k"))


# --- values -------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("text", "ltspice"),
    [
        ("R1 a b 24k3", "R1 a b 24.3k"),
        ("R1 a b 4R7", "R1 a b 4.7"),
        ("C1 3v3 5v0 2u2F", "C1 3v3 5v0 2.2u"),
        ("R1 a b r=2k7", "R1 a b r=2.7k"),
        ("V1 3v3 0 dc 1k5", "V1 3v3 0 dc 1.5k"),
        (".param a=1 b=2k7", ".param a=1 b=2.7k"),
        (".model 1n4148 d(is=2n5 rs=1)", ".model 1n4148 d(is=2.5n rs=1)"),
        ("E1 3v3 0 4v5 0 2k7", "E1 3v3 0 4v5 0 2.7k"),
        ("E1 a 0 poly(2) (3v3,0) (4,0) 0 .5 2k5", "E1 a 0 poly(2) (3v3,0) (4,0) 0 .5 2.5k"),
        ("x1 3v3 0 2n2222 params: r=2k7", "x1 3v3 0 2n2222 params: r=2.7k"),
        ("M1 d g s b 2n7000 l=1u w=2u5", "M1 d g s b 2n7000 l=1u w=2.5u"),
    ],
)
def test_scale_in_place_of_the_point(text: str, ltspice: str) -> None:
    for dialect in (Dialect.NGSPICE, Dialect.PSPICE):
        assert "drops what stands behind" in as_meant(Line(text), dialect).fault
    read = as_meant(Line(text), Dialect.LTSPICE)
    assert (read.text, read.fault) == (ltspice, "")


@pytest.mark.parametrize(
    "text",
    [
        "R1 a b 4,7k", "R1 a b 1.2.3", "R1 a b 0x10", "L1 a b 1_000", "R1 a b 1k.5", "R1 a b 1k 5%",
        "C1 a b 1u 25V", "R1 a b {1k} 5", "V1 3v3 0 3v3", "I1 a 0 sin(0 1 1k5)", ".param x=1.2.3",
    ],
)  # fmt: skip
def test_values_that_ngspice_would_cut(text: str) -> None:
    """ngspice 39 reads 7k, 1.2, 1 mOhm, 1 H, 1k, 5 Ohm, 25 F, 5 Ohm, 3 V, ... of these and says nothing."""
    assert as_meant(Line(text), Dialect.NGSPICE).fault


@pytest.mark.parametrize(
    "text",
    [
        "Q1 c b e 2n2222", "D1 a k 1n4148", "X1 a b 1k5", "R1 1k5 2k7 10kOhm", "R1 a b 1d3", "R1 a b 10kΩ",
        "R1 a b 1k rmod", "R1 a b 1k tc=0.001,0.002", "C1 a b 10uF ic=0", "V1 a 0 pwl(0 0,1m 5)",
        "FB 7 99 POLY(5) VB VC VE VLP VLN 0 522.8E6 -500E6", ".model n npn(bf=100 tref=27C mfg=2n2222)",
        "B1 a 0 v=v(3v3)*2", "e1 a b value={v(3v3)*2.5e3}", "m1 d g s b 2n7000 l=1u", ".func f(a,b) {a+b}",
    ],
)  # fmt: skip
def test_values_and_names_that_stay(text: str) -> None:
    read = as_meant(Line(text), Dialect.NGSPICE)
    assert (read.text, read.fault, read.note) == (text, "", "")


@pytest.mark.parametrize("mu", ["\u00b5", "\u03bc"])
@pytest.mark.parametrize("encoding", ["utf-8", "cp1252", "utf-16"])
def test_micro_is_micro_in_any_alphabet(tmp_path: Path, mu: str, encoding: str) -> None:
    if (mu, encoding) == ("\u03bc", "cp1252"):
        return  # the code page has no Greek letters
    file = tmp_path / "x.cir"
    file.write_text(f"* title\nC1 a b 2.2{mu}F\n.param c=1{mu}\n", encoding=encoding)
    read = [as_meant(line, Dialect.NGSPICE).text for line in read_lines(file)]
    assert read == ["C1 a b 2.2uF", ".param c=1u"]
    assert number(f"1{mu}") == 1e-6


@pytest.mark.parametrize(
    ("drawn", "nominal"),
    [
        ("{agauss(24.3k,2.43k,3)}", "{24.3k}"),
        ("{gauss(1k, 0.1, 3)}", "{1k}"),
        ("{aunif(1k,5)+unif(2k,0.1)}", "{1k+2k}"),
        ("{limit(a*2,5)}", "{(a*2)}"),
        ("{mc(1k,tol)*(1+flat(0.1))}", "{1k*(1+0)}"),
        ("{1k+gauss(5)}", "{1k+0}"),
        ("{agauss(agauss(1k,1,1),2,3)}", "{(1k)}"),
    ],
)
def test_distributions_take_their_nominal_value_with_a_note(tmp_path: Path, drawn: str, nominal: str) -> None:
    deck = load_deck(project(tmp_path, inside=f".param a=1k tol=0.1\nR9 out 0 {drawn}"))
    assert f"R9 out 0 {nominal}" in deck.text
    assert sum("nominal value" in note and "stage.cir:" in note for note in deck.notes) == 1


def test_what_is_no_distribution_stays(tmp_path: Path) -> None:
    inside = ".func mc(a,b) {a+b}\nB9 w 0 v=limit(v(out),-1,1)\nR9 w 0 {mc(1k,1)}"
    text = load_deck(project(tmp_path, inside=inside)).text
    assert "limit(v(out),-1,1)" in text
    assert "{mc(1k,1)}" in text


# --- .lib FILE ----------------------------------------------------------------------------------------

INNER = (
    "* PSpice and LTspice include by .lib\n.lib inner.lib\n.subckt WRAP 1 2 3 4 5\nx1 1 2 3 4 5 MYOP\n.ends\n"
)


def test_lib_with_one_argument(tmp_path: Path) -> None:
    (tmp_path / "inner.lib").write_text(MYOP)
    for dialect in ("pspice", "ltspice"):
        assert ".subckt MYOP" in library(tmp_path, INNER, dialect, "WRAP").text
    with pytest.raises(InputError, match=r"vendor.lib:2: '.lib inner.lib': opens a section 'inner.lib'"):
        library(tmp_path, INNER, "ngspice", "WRAP")


def test_lib_with_one_argument_in_a_block_swallows_nothing(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"stage.cir:\d+: '.lib standard.bjt'.*no .endl closes"):
        load_deck(project(tmp_path, behind=".lib standard.bjt\n.param r_fb=1k\n"))


def test_a_missing_library_matters_only_where_something_is_missing(tmp_path: Path) -> None:
    deck = library(tmp_path, ".lib nom.lib\n" + MYOP)
    assert any("ignored 1 .lib" in note for note in deck.notes)
    for needed in ("q1 x y 0 qn", "x9 x y other"):
        with pytest.raises(InputError, match=r"there is no file .*nom.lib"):
            library(tmp_path, ".lib nom.lib\n" + MYOP.replace(".ends", f"{needed}\n.ends"))


# --- one bad line in another part ---------------------------------------------------------------------

OTHER = ".subckt OTHER 1 2 3\n{}\n.ends\n"


@pytest.mark.parametrize(
    "beside",
    [
        OTHER.format("q1 1 2 3 qn\n.model qn npn (is=1e-16 bf=100\n+cje=1p"),
        "This library holds two parts\n",
        "... and what follows\n",
        "# a comment of somebody's\n",
        OTHER.format("a1 1 2 fs\n.model fs filesource(file=\"x\")"),
        OTHER.format("r1 1 2 1k\nr1 1 2 2k"),
        OTHER.format("r1 1 2 24k3"),
        OTHER.format("x1 1 2 nowhere"),
        OTHER.format("r1 1 2"),
        ".subckt HELPER 1\nr1 1 0 1\n.ends\n.subckt HELPER 1\nr1 1 0 2\n.ends\n",
        ".model qn npn (bf=100\n",
        ".param broken\n",
        ".ends\n",
        ".csparam x\n",
        ".whatever\n",
    ],
)  # fmt: skip
@pytest.mark.parametrize("first", [True, False])
def test_other_parts_of_a_library_do_not_matter(tmp_path: Path, beside: str, first: bool) -> None:
    text = library(tmp_path, beside + MYOP if first else MYOP + beside).text
    assert text == library(tmp_path, MYOP).text


def test_what_a_part_needs_comes_along_and_is_judged(tmp_path: Path) -> None:
    needs = BODY + "x1 x y help\nr9 x 0 {rx}\nd1 x 0 dm\n"
    helpers = ".subckt help a b\nr1 a b {f(ry)}\n.ends\n.func f(x) {2*x}\n.param rx={2*ry}\n.param ry=1k\n"
    text = library(
        tmp_path, f".subckt MYOP 1 2 3 4 5\n{needs}.ends\n{helpers}.model dm d\n.model no d\n"
    ).text
    for line in (".subckt help a b", ".func f(x) {2*x}", ".param rx={2*ry}", ".param ry=1k", ".model dm d"):
        assert line in text
    assert ".model no d" not in text
    with pytest.raises(InputError, match=r"vendor.lib:\d+: .*is not closed"):
        library(tmp_path, f".subckt MYOP 1 2 3 4 5\n{needs}.ends\n{helpers}.model dm d (is={{1\n")


def test_of_two_subcircuits_the_first_counts_with_a_note(tmp_path: Path) -> None:
    deck = library(tmp_path, MYOP + MYOP.replace("10k", "20k"))
    assert "rp 3 4 10k" in deck.text
    assert any("subcircuit myop is defined again" in note for note in deck.notes)


def test_a_device_that_only_ltspice_has(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"vendor.lib:\d+: 'A1 .*A device of LTspice's"):
        library(tmp_path, MYOP.replace(".ends", "A1 1 2 0 0 0 0 x 0 OTA g=1m\n.ends"), "ltspice")


@pytest.mark.parametrize("pins", ["p m vcc vee out", "out p m vee vcc"])
def test_pins_that_are_named_alike_meet_by_name(tmp_path: Path, pins: str) -> None:
    """In the part's order, as the guide says, or in the model's: the first once met by place, in silence."""
    file = tmp_path / "alike.lib"
    file.write_text(".subckt alike out p m vee vcc\nR1 p m 1meg\nE1 out 0 p m 1e5\n.ends alike\n")
    board = load_deck(BOARD, parts={"opamp": PartSwap(file, "alike", pins)})
    assert "xop out inp inn vee vcc alike" in [line.text for line in board.lines]
    with pytest.raises(InputError, match=r"in the model's order, out p m vee vcc, or in the part's"):
        load_deck(BOARD, parts={"opamp": PartSwap(file, "alike", "m p vcc vee out")})


def test_dialects_of_the_parts_make_that_of_the_deck(tmp_path: Path) -> None:
    assert library(tmp_path, MYOP, "ltspice").lines[1].text == "*@ ngbehavior=ltpsa"
    power = PartSwap(tmp_path / "vendor.lib", "MYOP", "1 2 3 4 5", "pspice")
    opamp = PartSwap(tmp_path / "vendor.lib", "MYOP", "1 2 3 4 5", "ltspice")
    assert load_deck(BOARD, parts={"driver": power}).lines[1].text == "*@ ngbehavior=psa"
    both = load_deck(BOARD, parts={"driver": power, "opamp": opamp})
    assert both.lines[1].text == "*@ ngbehavior=ltpsa"


# --- form ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("line", "words"),
    [
        (".csparam", "must be .csparam name = value"),
        (".csparam x", "must be .csparam name = value"),
        (".csparam x 5", "must be .csparam name = value"),
        (".csparam x=", "must be .csparam name = value"),
        (".model", "must be .model name type"),
        (".model m", "must be .model name type"),
        (".model (d)", "must be .model name type"),
        (".model m {t} (file \"/etc/passwd\")", "must be .model name type"),
        ("B9 out 0 v=pwl(1)", "pwl"),
        ("E9 out 0 poly(", "is not closed"),
        ("R9 out 0 {1k}5", "behind"),
        (".param tp=\"filesource\"", "a string"),
        (".param a=1 tp = \"filesource\"", "a string"),
        ("xa out 0 sub params: t=\"x\"", "a string"),
        (".param", "must be .param name = value"),
        (".param x=", "must be .param name = value"),
    ],
)  # fmt: skip
def test_forms_that_ngspice_dies_of_or_misreads(tmp_path: Path, line: str, words: str) -> None:
    """Each of the first ten ends ngspice 39 with a segmentation fault."""
    with pytest.raises(InputError) as caught:
        load_deck(project(tmp_path, inside=line))
    assert words in str(caught.value)
    assert "stage.cir:" in str(caught.value)


# --- sizes --------------------------------------------------------------------------------------------


def quickly_refused(board: Path, words: str) -> None:
    start = time.process_time()
    with pytest.raises(InputError, match=words):
        load_deck(board)
    assert time.process_time() - start < 2.0  # a second, and what a loaded machine's caches cost


def test_subcircuits_that_multiply(tmp_path: Path) -> None:
    levels = "".join(
        f".subckt l{k} a\n" + "".join(f"x{i} a l{k + 1}\n" for i in range(10)) + ".ends\n" for k in range(9)
    )
    behind = f"\n{levels}.subckt l9 a\nr1 a 0 1k\n.ends\n"
    quickly_refused(project(tmp_path, inside="xl out l0", behind=behind), "elements")


def test_subcircuits_that_multiply_in_hiding(tmp_path: Path) -> None:
    text, inner = "", ".subckt l9 a\nr1 a 0 1k\n.ends\n"
    for k in range(8, -1, -1):
        text = f".subckt l{k} a\n{inner}" + "".join(f"x{i} a l{k + 1}\n" for i in range(10)) + ".ends\n"
        inner = text
    quickly_refused(project(tmp_path, inside="xl out l0", behind=f"\n{text}"), "elements")


@pytest.mark.parametrize("depth", [1, 2, 30])
def test_a_subcircuit_that_instantiates_itself(tmp_path: Path, depth: int) -> None:
    ring = "".join(f".subckt l{k} a\nx1 a l{(k + 1) % depth}\n.ends\n" for k in range(depth))
    quickly_refused(project(tmp_path, inside="xl out l0", behind=f"\n{ring}"), "instantiates itself")


def test_a_chain_of_instances(tmp_path: Path) -> None:
    chain = "".join(f".subckt l{k} a\nx1 a l{k + 1}\n.ends\n" for k in range(2000))
    behind = f"\n{chain}.subckt l2000 a\nr1 a 0 1\n.ends\n"
    quickly_refused(project(tmp_path, inside="xl out l0", behind=behind), "deep")


def test_nested_definitions(tmp_path: Path) -> None:
    nest = "".join(f".subckt l{k} a\n" for k in range(5000)) + ".ends\n" * 5000
    quickly_refused(project(tmp_path, behind=f"\n{nest}"), "deep")


@pytest.mark.parametrize("filled", [True, False])
def test_includes_that_double(tmp_path: Path, filled: bool) -> None:
    board = project(tmp_path, addition=".include d0.cir\n")
    for k in range(30):
        text = f".include d{k + 1}.cir\n" * 2 + (".param p=1\n" if filled else "")
        (board.parent / f"d{k}.cir").write_text(text)
    (board.parent / "d30.cir").write_text("* the end\n")
    quickly_refused(board, "lines")


@pytest.mark.few(6)
@pytest.mark.parametrize(
    "line",
    [
        "R9 out 0" + " " * 200_000 + "1k",
        ".param a" + " " * 200_000 + "=1",
        "R9 out 0 1k" + " =" * 50_000,
        ".if " + "!" * 200_000 + "1\n.endif",
        ".if " + "(" * 200_000 + "1" + ")" * 200_000 + "\n.endif",
        "B9 out 0 v=" + "'" * 99_999,
        "B9 out 0 v=" + "(" * 200_000,
        "* " + "\"" * 200_000,
        "R9 out 0 1k" + "\n+ tc1=0" * 50_000,
        "R9 out 0 1k ;" + ";$/" * 70_000,
        "R9 out 0 " + "agauss(" * 20_000,
        "\x1a" * 200_000 + "x",
    ],
    ids=["blanks", "equals", "many", "not", "brackets", "quotes", "open", "comment", "plus", "semicolons",
         "draws", "eof"],
)  # fmt: skip
def test_long_lines_take_linear_time(tmp_path: Path, line: str) -> None:
    board = project(tmp_path, inside=line)
    start = time.process_time()
    with suppress(InputError):
        load_deck(board)
    assert time.process_time() - start < 2.0


def test_files_that_are_no_files(tmp_path: Path) -> None:
    fifo = tmp_path / "board.cir"
    os.mkfifo(fifo)
    for file in (fifo, Path("/dev/zero"), Path("/dev/null")):
        quickly_refused(file, "not a regular file")
    board = project(tmp_path, addition=".include pipe.cir\n")
    os.mkfifo(board.parent / "pipe.cir")
    quickly_refused(board, "no file")
    big = tmp_path / "big.cir"
    with big.open("wb") as file:
        file.truncate(1 << 40)
    quickly_refused(big, "too large")


def test_scenes_that_are_no_files(tmp_path: Path) -> None:
    fifo = tmp_path / "scene.toml"
    os.mkfifo(fifo)
    for file in (fifo, Path("/dev/zero")):
        with pytest.raises(InputError, match="not a regular file"):
            load_scene(file)


@pytest.mark.parametrize("between", [*"\n\r\t\x0b\x0c\x1c\x85\u2028\u2029\u200b ;", "'", "{"])
def test_a_recorded_node_is_one_name(tmp_path: Path, between: str) -> None:
    scene = slider(record={"nodes": ["xboard.x1", f"a{between}.control"]}, solver={"model": "spice"})
    with pytest.raises(InputError, match=r"record.nodes = .*is not the name of a node"):
        resolve(scene_of(tmp_path, scene))


@pytest.mark.parametrize("bits", [1e11, 33.0, 0.5])
def test_a_resolution_that_no_converter_has(bits: float) -> None:
    values: dict[str, float | None] = dict.fromkeys(DesignConstants.names(), 1.0)
    assert DesignConstants.read(values, "board.cir").dac_bits == 1.0
    with pytest.raises(
        InputError, match=r"board.cir: dac_bits = .* bits: is not a possible resolution.*1 to 32"
    ):
        DesignConstants.read({**values, "dac_bits": bits}, "board.cir")


# --- arithmetic ---------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("0", 0.0), ("1k-1000", 0.0), ("2*(3+4)/7", 2.0), ("-a*a", -9.0), ("!a||b", 1.0), ("!(a&&b)", 0.0),
        ("1-2-3", -4.0), ("8/4/2", 1.0), ("1e-3*1k", 1.0), ("--a", 3.0), ("!!a", 1.0), ("+a", 3.0),
        ("1/0", None), ("a b", None), ("(a", None), ("a)", None), ("", None), ("c", None), ("a<b", None),
        ("f(a)", None), ("a*", None), ("*a", None), ("()", None), ("1e300*1e300", None), ("2k7", None),
    ],
)  # fmt: skip
def test_expressions(text: str, value: float | None) -> None:
    assert evaluate(text, {"a": 3.0, "b": 5.0}) == value


# --- values set from outside --------------------------------------------------------------------------

NETLISTS = Path(__file__).parents[1] / "netlists"
LEVELS = {"opamp": "gbw", "vca": "gbw", "driver_level": "gbw", "motor": "full"}


def shipped(features: tuple[Feature, ...] = (), **values: str) -> Deck:
    return load_deck(NETLISTS / "board2.cir", levels=LEVELS, overrides=values, features=features)


def text_of(deck: Deck, name: str) -> str:
    return next(line.text for line in deck.lines if line.text.startswith(f".param {name}="))


def test_values_from_outside_mean_what_those_of_a_file_mean() -> None:
    assert text_of(shipped(c_der_in="1\u03bc"), "c_der_in") == ".param c_der_in=1u"
    drawn = shipped(r_sum_fb="{agauss(10k,1k,3)}")
    assert text_of(drawn, "r_sum_fb") == ".param r_sum_fb={10k}"
    assert any("r_sum_fb" in note and "nominal value" in note for note in drawn.notes)


@pytest.mark.parametrize("character", [*"\r\x0b\x0c\x1c\x85\u2028\u2029"])
@pytest.mark.parametrize("form", ["10{}k", "{{10k{}}}", "{{10k{}.control}}"])
def test_a_value_is_one_row(character: str, form: str) -> None:
    with pytest.raises(InputError, match="r_sum_fb"):
        shipped(r_sum_fb=form.format(character))


@pytest.mark.parametrize(
    "value", ["24k3", "4,7k", "0x10", "1e-320", "-1e-31", "1e31", "{(1k}", "{1k}5", "{1k)}"]
)
def test_values_that_are_none(value: str) -> None:
    with pytest.raises(InputError, match="r_sum_fb"):
        shipped(r_sum_fb=value)


@pytest.mark.parametrize(
    ("line", "value"),
    [
        ("R1 a b 10 k", "10k"),
        ("c1 a b 1.5 nF tol=1", "1.5nF"),
        ("L1 a b 2 mH", "2mH"),
        (".param a=169 k b=2", "169k"),
        (".param b = 2 a = 5 MEG", "5MEG"),
        ("R1 a b 10 kOhm", "10kOhm"),
        ("R1 a b 10 Ω", None),
        ("R1 a b 10k rmod", None),
        ("R1 a b 10k k", None),
        (".param a=1 + 2", None),
        ("V1 k m 10", None),
        ("D1 a k d", None),
        ("R1 u k 10", None),
    ],
)
def test_a_scale_behind_a_blank_is_reported(line: str, value: str | None) -> None:
    problem = malformed(Line(line))
    assert (problem is not None) == (value is not None)
    assert problem is None or f"write {value}" in problem.message


@pytest.mark.parametrize("zero", ["0", "{0}", "{1k-1000}", "{r_sum_cmd-20k}", "0meg", "{-0}"])
def test_a_resistor_of_zero_ohm_by_any_road(tmp_path: Path, zero: str) -> None:
    with pytest.raises(InputError, match="of 0 Ohm"):
        shipped(r_sum_fb=zero)
    with pytest.raises(InputError, match="of 0 Ohm"):
        load_deck(NETLISTS / "board2.cir", levels=LEVELS, overrides={"xsum1.r31": zero})
    if "cmd" not in zero:
        with pytest.raises(InputError, match=r"stage.cir:\d+: 'R9 out sum .*of 0 Ohm"):
            load_deck(project(tmp_path, inside=f"R9 out sum {zero}"))


def test_a_value_that_an_effect_sets_is_refused() -> None:
    offset = (Feature("opamp_offset", False, ("opamp",)),)
    with pytest.raises(InputError, match=r"opamp_offset = '1': is what effects.opamp_offset sets"):
        shipped(offset, opamp_offset="1")


def test_a_value_that_nothing_uses_is_reported() -> None:
    def warned(on: bool, **values: str) -> bool:
        with collected() as cautions:
            shipped((Feature("opamp_offset", on, ("opamp",)),), **values)
        return any(c.code == "value-unused" and next(iter(values)) in c.text for c in cautions)

    assert warned(False, tl072_vos="5m")
    assert not warned(True, tl072_vos="5m")
    assert warned(True, tl072_sr="1meg")  # the slew limit is off
    for used in ("r_sum_fb", "tl072_gbw", "tl072_swing", "k_fs", "motor_k"):
        assert not warned(False, **{used: "2"}), used


# --- notes --------------------------------------------------------------------------------------------

BOYLE = (DATA / "vendor" / "boyle.lib").read_text()


def including(folder: Path, about: str = "") -> Deck:
    """Load the small board whose stage takes a Boyle model that the board includes itself."""
    board = project(folder, addition=".include boyle.lib\n")
    (board.parent / "boyle.lib").write_text(f"{about}\n{BOYLE}")
    stage = board.parent / "blocks" / "stage.cir"
    text = stage.read_text()
    assert " opx" in text
    stage.write_text(text.replace(" opx", " tl072"))
    return load_deck(board)


def test_an_amplifier_that_the_board_includes_itself(tmp_path: Path) -> None:
    deck = including(tmp_path / "a")
    assert not any("terminal" in note for note in deck.notes), deck.notes
    assert sum("no table of loops and headroom" in note and "tl072" in note for note in deck.notes) == 1
    described = including(tmp_path / "b", "*@ role=opamp out=5")
    assert [a.part for a in described.amplifiers].count("tl072") == 2
    assert not any("headroom" in note for note in described.notes)


def test_notes_on_nodes_know_the_forms_of_controlled_sources(tmp_path: Path) -> None:
    inside = (
        "E7 e7 0 poly(2) (sum,0) (out, vcc) 0 1 1\nE8 e7 0 POLY(1) sum 0 0 1\nG9 e7 0 value={v(out)}\n"
        ".include 'more.cir'"
    )
    board = project(tmp_path, inside=inside)
    (board.parent / "blocks" / "more.cir").write_text("R7 e7 0 1k\n")
    assert not any("terminal" in note for note in load_deck(board).notes)
    lonely = project(tmp_path / "x", inside="E7 out 0 poly(1) (lonely,0) 0 1")
    assert any("terminal touches node lonely" in note for note in load_deck(lonely).notes)
