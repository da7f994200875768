"""Boards with op-amps made up at random in the vendors' manner: transistors, diodes, B sources inside."""

import numpy as np
import pytest
from extraction_boards import STATED, differences, extract, shipped

from cosim.circuits.fitting.rational_fit import GOOD
from cosim.ngspice.deck import PartSwap

#: Boltzmann's voltage at 27 degC, ngspice's own temperature [V].
_VT = 0.025865


def macro_model(seed):
    """A two-stage op-amp of random bandwidth, gain, bias current and output stage; stable as a follower."""
    rng = np.random.default_rng(seed)
    gbw, gain = 10 ** rng.uniform(5, 7), 10 ** rng.uniform(4.5, 6)
    second = gbw * 10 ** rng.uniform(0.7, 1.7)  # Hz, pole of the input pair
    tail, degeneration = 10 ** rng.uniform(-4.5, -3.5), rng.uniform(0.0, 2e3)
    load = 0.5 / tail  # Ohm: half a volt at rest
    slope = 1.0 / (2.0 * _VT / tail + degeneration)  # A/V of one side
    ga = 1e-4
    c2 = slope * load * ga * 2.0 / (2.0 * np.pi * gbw) * 0.5
    kind = ("npn", "pnp", "jfet")[seed % 3]
    lines = [".subckt made 1 2 3 4 5"]
    if kind == "jfet":
        beta = slope**2 / tail  # the pair's transconductance is sqrt(beta tail)
        lines += [
            f"J1 c1 2 e JX\nJ2 c2 1 e JX\nIt e 4 {tail!r}",
            f".model JX NJF(beta={beta!r} vto=-1 is=1e-15)",
        ]
        lines += [f"Rc1 3 c1 {load!r}\nRc2 3 c2 {load!r}"]
    else:
        top, bottom, source = ("3", "4", "e 4") if kind == "npn" else ("4", "3", "3 e")
        lines += [
            f"Q1 c1 2 e1 QX\nQ2 c2 1 e2 QX\nRe1 e1 e {degeneration + 1.0!r}\nRe2 e2 e {degeneration + 1.0!r}",
            f"It {source} {tail!r}\nRc1 {top} c1 {load!r}\nRc2 {top} c2 {load!r}\nRt e {bottom} 100meg",
            f".model QX {kind.upper()}(bf={rng.uniform(100, 1000)!r} is={10 ** rng.uniform(-17, -14)!r} "
            f"vaf={rng.uniform(30, 200)!r} cje=0.1p cjc=0.1p)",
        ]
    lines += [
        f"Cc c1 c2 {1.0 / (4.0 * np.pi * load * second)!r}",
        f"Bg 0 6 I={ga!r}*v(c1,c2)/(1+{rng.uniform(0, 0.3)!r}*v(c1,c2)*v(c1,c2))",
        f"R2 6 0 {gain / (slope * load * ga)!r}\nC2 6 0 {c2!r}",
        f"Bo 7 0 V={rng.uniform(11, 14)!r}*tanh(v(6)/12)\nRo 7 5 {rng.uniform(10, 200)!r}",
        "Dp 5 8 DX\nVp 3 8 1.5\nDn 9 5 DX\nVn 9 4 1.5",
        f"Rp 3 4 {rng.uniform(1e3, 1e5)!r}\nDs 4 3 DX",
        f".model DX D(is={10 ** rng.uniform(-16, -12)!r} cjo={rng.uniform(0.1, 2)!r}p rs=1)",
        ".ends made",
    ]
    return "* made for these tests\n" + "\n".join(lines) + "\n"


def made_board(folder, seed):
    file = folder / f"made{seed}.lib"
    file.write_text(macro_model(seed))
    return shipped(
        1, "gbw", ("voltage", "current")[seed % 2], parts={"opamp": PartSwap(file, "made", "1 2 3 4 5")}
    )


#: How many, and how many of them must be fitted to rounding: thirty poles of three op-amps in three decades
#: can be too close together for doubles. Which ones are depends on the last digits of ngspice's `.ac`: 21 are
#: exact on 39, 19 on 44 and 47; the others state errors of 1e-8 to 7e-5, which the test holds them to.
MODELS, EXACT = 24, 18
#: Between the points and through both sides of the multipliers, a fit may be worse than at its own points.
BETWEEN = 10.0


@pytest.mark.slow
@pytest.mark.long
def test_random_macro_models(tmp_path):
    exact = 0
    for seed in range(MODELS):
        deck = made_board(tmp_path, seed)
        circuit = extract(deck)
        stated = circuit.certificate["fit_error"]
        exact += stated <= GOOD
        assert (stated > GOOD) == ("note" in circuit.certificate), seed
        assert circuit.order >= 8, seed  # three op-amps' poles besides the capacitors and the motor
        assert (circuit.poles.real < 0.0).all(), seed
        assert differences(deck, circuit, np.array([10.0, 10.0])).max() < max(STATED, BETWEEN * stated), seed
    assert exact >= EXACT
