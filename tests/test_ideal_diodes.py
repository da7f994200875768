"""LTspice's idealised diodes: straight in three regions, where ngspice would put a junction."""

import numpy as np
import pytest
from extraction_boards import shipped

from cosim.errors import InputError
from cosim.ngspice.ideal_diodes import as_sources
from cosim.ngspice.lines import Line
from cosim.ngspice.parts import PartSwap
from cosim.ngspice.simulator import Simulator


def _rows(text):
    return [Line(row) for row in text.splitlines()]


def _current(model, volts):
    rows = as_sources(_rows(f"D1 in 0 clamp\n.model clamp {model}"))
    simulator = Simulator()
    simulator.load("*\n" + "\n".join(["Vin in 0 0", *(line.text for line in rows), ".end"]) + "\n")
    simulator.command(f"alter vin = {volts}")
    simulator.command("op")
    return -float(np.real(simulator.vector("vin#branch")[0]))


@pytest.mark.parametrize("volts", [-9.0, -6.5, -1.0, 0.5, 2.0, 7.0])
def test_its_current_is_straight_in_three_regions(volts):
    # LTspice's help: 1/Ron beyond Vfwd, 1/Rrev beyond -Vrev, 1/Roff everywhere between
    off = 1e-6 * volts
    expected = off + (volts - 2.0) * (0.1 - 1e-6) if volts > 2.0 else off
    expected += (volts + 6.0) * (0.05 - 1e-6) if volts < -6.0 else 0.0
    known = _current("D(Ron=10 Roff=1Meg Vfwd=2 Vrev=6 Rrev=20)", volts)
    assert known == pytest.approx(expected, rel=1e-6, abs=1e-12)


def test_what_it_does_not_state_is_ltspices_default():
    assert _current("d Vfwd=13", 12.0) == pytest.approx(0.0, abs=1e-9)
    assert _current("d Vfwd=13", 15.0) == pytest.approx(2.0, rel=1e-6)  # Ron is 1 Ohm
    assert _current("d Vfwd=13", -1e3) == pytest.approx(0.0, abs=1e-6)  # no Vrev, no breakdown
    assert _current("d Ron=5 Vrev=4", -9.0) == pytest.approx(-1.0, rel=1e-6)  # Rrev is Ron


def test_a_junction_stays_and_names_mean_the_nearest_model():
    text = (
        ".model d d(Ron=1)\n.subckt a 1 2\nd1 1 2 d\n.model d d(is=1f)\n.ends\n"
        ".subckt b 1 2\nd1 1 2 d off\nd2 1 2 e 4\n.ends\n.model e d(is=1f n=2)\nd3 1 0 d"
    )
    rows = [line.text for line in as_sources(_rows(text))]
    assert [row for row in rows if row[0] == "d"] == ["d1 1 2 d", "d2 1 2 e 4"]
    assert [row.split()[0] for row in rows if row[0] in "br"] == ["bd1", "rd1_off", "bd3", "rd3_off"]


@pytest.mark.parametrize(
    ("row", "model", "named"),
    [("D1 a 0 m", "D(Vfwd=1 Ilimit=1m)", "ilimit"), ("D1 a 0 m 3", "D(Ron=1)", "with 3")],
)
def test_what_is_not_read_is_a_fault(row, model, named):
    assert named in as_sources(_rows(f"{row}\n.model m {model}"))[0].fault


#: An op-amp for LTspice whose output is to stand between +-VS less 2 V.
CLAMPED = """\
.subckt amp 1 2 3 4 5
.param VS=15
G1 0 x 1 2 1m
R1 x 0 100meg
C1 x 0 53p
D1 x 0 lim
E1 y 0 x 0 1
R2 y 5 50
.model lim D(Vfwd={VS-2} Vrev={VS-2} Ron=10 epsilon=.1)
.ends
"""


def test_a_part_clamps_where_its_file_says(tmp_path):
    file = tmp_path / "amp.lib"
    file.write_text(CLAMPED)
    deck = shipped(1, "gbw", parts={"opamp": PartSwap(file, "amp", "1 2 3 4 5", "ltspice")})
    assert any("D1 is an idealised diode of LTspice" in note for note in deck.notes)
    simulator = Simulator()
    simulator.load(
        deck.text.removesuffix(".end\n")
        + "Vcc vcc 0 15\nVee vee 0 -15\nVp p 0 1\nXt p 0 vcc vee out amp\nRt out 0 1meg\n.end\n"
    )
    simulator.command("op")
    # 1 mA on its way to 100 V: 13 V and 10 mV across the diode's 10 Ohm
    assert float(np.real(simulator.vector("out")[0])) == pytest.approx(13.01, abs=0.002)


def test_a_current_limit_is_refused_by_file_and_line(tmp_path):
    file = tmp_path / "amp.lib"
    file.write_text(CLAMPED.replace("Ron=10", "Ilimit=1m"))
    with pytest.raises(InputError, match=r"amp\.lib:6: .*LTspice's idealised diode is not read with ilimit"):
        shipped(1, "gbw", parts={"opamp": PartSwap(file, "amp", "1 2 3 4 5", "ltspice")})
