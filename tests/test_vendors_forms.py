"""Statements of vendors' models that PSpice and LTspice read although they break the rules."""

import numpy as np
import pytest

from cosim.errors import InputError
from cosim.ngspice.lax_forms import put_right
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
        ("R1 a b 100 TC 3.11M 4.51U", "R1 a b 100 tc1=3.11M tc2=4.51U"),
        ("R1 a b 100 tc 1m,2u", "R1 a b 100 tc1=1m tc2=2u"),
        ("R1 a b 100 tc 1m", "R1 a b 100 tc1=1m"),
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
        "R1 a b tc 100",  # no value before it: TC would be the name of a model
        "R1 a b 100 tc=1m,2u",
    ],
)
def test_other_statements_stay(text):
    assert put_right(Line(text)).text == text


def test_a_table_that_was_put_right_is_told_and_has_its_values(tmp_path):
    note = put_right(Line("G1 a 0 TABLE {V(a)} (0,0)(1,1m))")).note
    assert "parentheses" in note
    simulator = Simulator()
    row = put_right(Line("G1 0 out TABLE {V(in)} ((-1,-2m)(0,0)(1,2m))(2,6m))")).text
    simulator.load(f"*\n*@ ngbehavior=psa\nVin in 0 1.5\n{row}\nRout out 0 1k\n.end\n")
    simulator.command("op")
    # between (1, 2 mA) and (2, 6 mA): 4 mA through 1 kOhm
    assert float(np.real(simulator.vector("out")[0])) == pytest.approx(4.0, rel=1e-3)


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
