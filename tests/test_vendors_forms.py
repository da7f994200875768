"""Statements of vendors' models that PSpice and LTspice read although they break the rules."""

import numpy as np
import pytest

from cosim.circuits.extraction.swing import SwingFrom, swings
from cosim.errors import InputError, SimulationError
from cosim.ngspice.dialect import Dialect
from cosim.ngspice.foreign_functions import in_own_words
from cosim.ngspice.lax_forms import put_right, read_over
from cosim.ngspice.lines import Line
from cosim.ngspice.netlist import element_nodes, parse
from cosim.ngspice.parts import PartSwap
from cosim.ngspice.simulator import Simulator


@pytest.mark.parametrize(
    ("written", "read"),
    [
        ("G1 a 0 TABLE {V(a,b)} ((-1,-1n)(0,0)(16,1n))(16.1,1))",
         "G1 a 0 TABLE {V(a,b)} (-1,-1n) (0,0) (16,1n) (16.1,1)"),
        ("E1 a 0 table {v(a)} = (0,0)((1,2)", "E1 a 0 table {v(a)} = (0,0) (1,2)"),
        ("X1 a b,c part k=1", "X1 a b c part k=1"),
        ("E1 a 0 poly(2),(b,0),(c,0) 0 .5 .5", "E1 a 0 poly(2) (b,0) (c,0) 0 .5 .5"),
        ("G1 a 0 POLY(1) , (b,c) 1 2", "G1 a 0 POLY(1) (b,c) 1 2"),
        ("R1 a b 100 TC 3.11M 4.51U", "R1 a b 100 tc1=3.11M tc2=4.51U"),
        ("R1 a b 100 tc 1m,2u", "R1 a b 100 tc1=1m tc2=2u"),
        ("R1 a b 100 tc 1m", "R1 a b 100 tc1=1m"),
        ("BG1 a 0 i=V(c,d)*2 rpar=1k", "BG1 a 0 i=(V(c,d)*2)+v(a,0)/(1k)"),
        ("B1 a b I = V(c) + 1 Rpar = {r}", "B1 a b I=(V(c) + 1)+v(a,b)/(r)"),
        ("B1 a b v=V(c) rpar=1k", "B1 a b v=V(c)"),
    ],
)  # fmt: skip
def test_what_pspice_reads_is_put_right(written, read):
    assert put_right(Line(written)).text.split() == read.split()


@pytest.mark.parametrize(
    "text",
    [
        "G1 a 0 TABLE {V(a,b)} ((-1,-1n) (0,0) (1,1n))",  # balanced: ngspice's own business
        "G1 a 0 TABLE {V(a,b)} ((0,0)(x,1)",  # no number
        "G1 a 0 TABLE {V(a,b)} (0,0)(1,1,1))",  # no pairs
        "X1 a b part k={limit(a,b,c)}",
        "R1 tc b 100",
        "E1 a 0 poly(2) (b,0) (c,0) (0,1,1)",
        "E1 a 0 poly(2) (b,0) (c,0),(0,1,1)",
        "R1 a b tc 100",  # no value before it: TC would be the name of a model
        "R1 a b 100 tc=1m,2u",
    ],
)
def test_other_statements_stay(text):
    assert put_right(Line(text)).text == text


def test_a_table_that_was_put_right_is_reported_and_has_its_values(tmp_path):
    note = put_right(Line("G1 a 0 TABLE {V(a)} (0,0)(1,1m))")).note
    assert "parentheses" in note
    simulator = Simulator()
    row = put_right(Line("G1 0 out TABLE {V(in)} ((-1,-2m)(0,0)(1,2m))(2,6m))")).text
    simulator.load(f"*\n*@ ngbehavior=psa\nVin in 0 1.5\n{row}\nRout out 0 1k\n.end\n")
    simulator.command("op")
    # between (1, 2 mA) and (2, 6 mA): 4 mA through 1 kOhm
    assert float(np.real(simulator.vector("out")[0])) == pytest.approx(4.0, rel=1e-3)


def test_a_current_source_with_a_resistor_of_its_own():
    simulator = Simulator()
    row = put_right(Line("B1 0 out i=v(in)*1m rpar=2k")).text
    simulator.load(f"*\nVin in 0 3\n{row}\nRload out 0 2k\n.end\n")
    simulator.command("op")
    # 3 mA into twice 2 kOhm in parallel: 3 V; without its own resistor 6 V, with the wrong sign no end
    assert float(np.real(simulator.vector("out")[0])) == pytest.approx(3.0, rel=1e-6)


@pytest.mark.parametrize(
    ("text", "nodes"),
    [
        ("G1 98 22 POLY(2) (20,2) (21,2) (0,0,0,0,0.4u)", ["98", "22", "20", "2", "21", "2"]),
        ("G1 98 22 poly(2) 20 2 21 2 0 0 1", ["98", "22", "20", "2", "21", "2"]),
        ("G2 98 29 (24,25) 8.59E-5", ["98", "29", "24", "25"]),
        ("E2 98 29 24 25 1", ["98", "29", "24", "25"]),
        ("E3 a b VALUE={V(c)*2}", ["a", "b"]),
        ("R1 a b 1k", ["a", "b"]),
    ],
)
def test_nodes_of_controlled_sources(text, nodes):
    assert element_nodes(Line(text)) == nodes


def test_an_end_with_the_subcircuits_name_closes_it_in_a_vendors_file():
    rows = [Line(".subckt amp a b"), Line("R1 a b 1k"), Line(".end amp")]
    assert list(parse(rows, lenient=True).blocks) == ["amp"]
    with pytest.raises(InputError, match=r"amp without \.ends"):
        parse(rows)
    assert list(parse([*rows[:2], Line(".end other")], lenient=True).blocks) == []


@pytest.mark.parametrize(
    ("written", "read"),
    [
        (".SUBCKT part a k PARAMS: n = 1 ibv = 1M)", ".SUBCKT part a k PARAMS: n = 1 ibv = 1M"),
        (".subckt part a k params: n={2*(1+m)})", ".subckt part a k params: n={2*(1+m)}"),
        (".model d d(is=1e-14 n=2))", ".model d d(is=1e-14 n=2)"),
        (".model q npn (is=1e-16 bf=170", ".model q npn (is=1e-16 bf=170)"),
    ],
)
def test_a_parenthesis_at_the_end_is_read_over_with_a_note(written, read):
    line = read_over(Line(written))
    assert line.text == read
    assert "(" in line.note or ")" in line.note


@pytest.mark.parametrize(
    "text",
    [
        ".model d d(is=1e-14 n=2)",
        ".model d d(is={1e-14 n=2)",  # a brace
        ".model q npn (is=1e-16 (bf=170",
        ".subckt part a k params: (n=1",  # ngspice takes this for a function
        "R1 a b 1k)",
        "B1 a b V=v(c)*(",  # overwrites the stack of ngspice 39
    ],
)
def test_other_parentheses_stay(text):
    assert read_over(Line(text)) == Line(text)


#: A level shifter and an op-amp with a parenthesis too many in a header and one too few in a model.
PARENTHESES = """\
.subckt amp 1 2 3 4 5 params: gm = 1m ohms = 100meg)
G1 0 x (1,2) {gm}
RX x 0 {ohms}
CX x 0 53p
DX x lim clamp
VX lim 0 {volts}
E1 y 0 x 0 1
RO y 5 100
RP 3 4 10k
.model clamp d (is=1e-14
+ n=1.5
.ends amp
.param volts=13
"""


@pytest.mark.parametrize("dialect", list(Dialect))
def test_a_board_takes_a_part_with_such_parentheses(tmp_path, dialect):
    from extraction_boards import shipped

    file = tmp_path / "amp.lib"
    file.write_text(PARENTHESES)
    deck = shipped(1, "gbw", parts={"opamp": PartSwap(file, "amp", "1 2 3 4 5", dialect)})
    assert sum("read over" in note or "not closed" in note for note in deck.notes) == 2
    simulator = Simulator()
    simulator.load(deck.text.removesuffix(".end\n") + "Vcc vcc 0 15\nVee vee 0 -15\n.end\n")


def test_a_model_may_have_the_name_of_a_sources_keyword():
    simulator = Simulator()
    simulator.load("*\nI1 0 out DC 2m\nR1 out 0 1k\nD1 0 out dc\n.model dc d(is=1e-14)\n.end\n")
    simulator.command("op")
    # 2 mA into 1 kOhm; the diode is reverse-biased
    assert float(np.real(simulator.vector("out")[0])) == pytest.approx(2.0, rel=1e-6)


#: An op-amp as vendors write them, with all of these forms in one file.
FORMS = """\
.subckt forms 1 2 3 4 5
G1 0 x (1,2) 1m
RX x 0 100meg TC 1m 1u
CX x 0 53p
GL x 0 TABLE {V(x)} ((-20,-1m)(-14,0)(14,0))(20,1m))
XO x,y BUFFER
RO y 5 100
RP 3 4 10k
.end forms
.subckt BUFFER in out
E1 out 0 in 0 1
.ends
"""


def test_a_file_with_all_of_these_forms_makes_a_board(tmp_path):
    from extraction_boards import shipped

    file = tmp_path / "forms.lib"
    file.write_text(FORMS)
    deck = shipped(1, "gbw", parts={"opamp": PartSwap(file, "forms", "1 2 3 4 5", "pspice")})
    assert "tc1=1m tc2=1u" in deck.text
    assert any("parentheses" in note for note in deck.notes)


def _value(formula, volts, dialect):
    """What ngspice makes of a B source with this formula in a file of this dialect."""
    text = in_own_words(f"B1 out 0 V={formula}", dialect, ())
    simulator = Simulator()
    mode = Dialect.behaviour([dialect])
    simulator.load(
        f"*\n*@ ngbehavior={mode}\nVin in 0 {volts}\nVl low 0 -2\nVh high 0 3\n{text}\nR1 out 0 1k\n.end\n"
    )
    simulator.command("op")
    return float(np.real(simulator.vector("out")[0]))


@pytest.mark.parametrize("dialect", [Dialect.PSPICE, Dialect.LTSPICE])
@pytest.mark.parametrize("volts", [-5.0, -1.0, 0.0, 0.5, 2.0, 7.0])
def test_a_table_is_linear_between_its_points_and_constant_outside(volts, dialect):
    points = [-1.0, -2.0, 0.0, 0.5, 2.0, 1.0]
    formula = f"1+table(v(in),{','.join(map(str, points))})*2"
    expected = 1.0 + 2.0 * np.interp(volts, points[::2], points[1::2])
    assert _value(formula, volts, dialect) == pytest.approx(expected, rel=1e-9)
    # points that are voltages: a multiplier's output between its supplies
    formula = "Table ( v(in), v(low),v(low), v(high),v(high) )"
    assert _value(formula, volts, dialect) == pytest.approx(min(max(volts, -2.0), 3.0), rel=1e-9)


@pytest.mark.parametrize("volts", [-1.5, 0.4, 0.6, 2.5])
def test_functions_of_ltspice_have_the_values_of_its_manual(volts):
    x = volts
    for formula, expected in {
        "hypot(v(in),2)": np.hypot(x, 2.0), "arctan(v(in))": np.arctan(x), "square(v(in)-1)": (x - 1.0) ** 2,
        "buf(v(in))": float(x > 0.5), "inv(v(in))": float(x <= 0.5), "int(v(in))": np.trunc(x),
        "round(v(in)+0.2)": np.floor(x + 0.7), "pwr(v(in),3)": abs(x) ** 3,
        "pwrs(v(in),3)": np.sign(x) * abs(x) ** 3, "pwrs(hypot(v(in),0),3)": abs(x) ** 3,
    }.items():  # fmt: skip
        assert _value(formula, volts, Dialect.LTSPICE) == pytest.approx(expected, rel=1e-6, abs=1e-9), formula


@pytest.mark.parametrize(
    "text",
    [
        "B1 out 0 V=table(v(in),1)",  # no pairs
        "B1 out 0 V=hypot(v(in))",  # one argument is missing
        "B1 out 0 V=table(v(in),1,2",  # not closed
        "X1 a b table(1)",  # no formula
        "B1 out 0 V=v(table)",  # a node
        "E1 out 0 TABLE {v(in)} = (0,0) (1,1)",  # the other form of a table, which ngspice knows
        "B1 out 0 V=" + "hypot(1," * 2000 + "v(in)" + ")" * 2000,
        # five tables in each other, of thirty points each: 60**5 copies of the innermost
        "B1 out 0 V=" + "table(" * 5 + "v(in)" + ("," + ",".join(map(str, range(60))) + ")") * 5,
    ],
)
def test_other_calls_stay_for_ngspice_to_name(text):
    left = in_own_words(text, Dialect.LTSPICE, ())
    assert left == text or "table" in left or "hypot" in left
    assert len(left) < 60_000


def test_a_function_that_the_file_defines_is_its_own():
    text = "B1 out 0 V=square(v(in))"
    assert in_own_words(text, Dialect.LTSPICE, {"square"}) == text
    assert in_own_words(text, Dialect.PSPICE, ()) == text


#: A multiplier as enthusiasts write them for LTspice: a product between the supplies.
MULTIPLIER = """\
.subckt product 1 2 3 4 5 6 7 8
R1 1 2 100k
R3 3 4 100k
B1 9 0 V=(V(1)-V(2))*(V(3)-V(4))/10+V(6)
R5 9 10 10
C5 10 0 63.7p
B2 77 0 V=table(V(10),V(5),V(5),V(8),V(8))
R7 77 7 0.1
Rz 6 0 1g
.ends product
"""


def test_a_multiplier_between_its_supplies_makes_a_board_and_is_watched(tmp_path):
    from extraction_boards import shipped

    file = tmp_path / "product.lib"
    file.write_text(MULTIPLIER)
    swap = PartSwap(file, "product", "x1 x2 y1 y2 vee z w vcc", "ltspice")
    deck = shipped(1, "gbw", parts={"vca": swap})
    limits = swings(Simulator(), deck)
    vcas = [a for a in deck.amplifiers if a.role == "vca"]
    assert vcas
    for a in vcas:  # 10 V at X, 20 V at the control: 20 V wanted, 15 V of supply less 0.1 Ohm of 10 kOhm
        assert limits[a.path].limit_v == pytest.approx(15.0, rel=2e-5)
        assert limits[a.path].source == SwingFrom.MEASURED


def test_a_multiplier_without_a_slope_is_named():
    # Of V = x y the slopes at x = 0 are y and 0; XSPICE's model takes V/x, 0/0.
    simulator = Simulator()
    rows = ["t", "V1 x 0 0 ac 1", "V2 y 0 1", "A1 [x y] o product", ".model product mult", "R1 o 0 1k"]
    simulator.load("\n".join([*rows, ""]))
    simulator.command("ac lin 1 1k 1k")
    with pytest.raises(SimulationError, match="multiplier product has no slope"):
        simulator.vector("o")
    simulator.load("\n".join([*rows[:3], "B1 o 0 V=v(x)*v(y)", ""]))
    simulator.command("ac lin 1 1k 1k")
    assert simulator.vector("o") == pytest.approx([1.0])
