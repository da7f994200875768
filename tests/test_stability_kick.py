"""The transient that confirms a growing pole, where ngspice does not get through it at once."""

import numpy as np
import pytest
from support import BOARD1

from cosim.circuits.extraction import testbench
from cosim.circuits.instability import search
from cosim.circuits.instability.stability_verdict import Question
from cosim.errors import SimulationError
from cosim.ngspice.deck import PartSwap, load_deck
from cosim.stability_gate import FINITE

GAIN, POLE_HZ = 1e5, 10.0


@pytest.fixture
def crossed(tmp_path):
    """A board whose op-amps, of one pole each, have their inputs crossed: every loop grows."""
    file = tmp_path / "one.lib"
    pole = 1.0 / (2.0 * np.pi * POLE_HZ * 1e6)
    file.write_text(
        f"* one pole\n.subckt one 1 2 3 4 5\nG1 0 6 1 2 {GAIN * 1e-6!r}\nR1 6 0 1meg\nC1 6 0 {pole!r}\n"
        "E1 7 0 6 0 1\nR2 7 5 10\nR3 3 0 1meg\nR4 4 0 1meg\n.ends\n"
    )
    swap = PartSwap(file, "one", "2 1 3 4 5")
    return load_deck(BOARD1, levels={**FINITE, "driver": "voltage"}, parts={"opamp": swap})


@pytest.mark.parametrize(("in_vain", "confirmed"), [(1, True), (2, False)])
def test_a_kick_is_simulated_again_with_wider_tolerances(crossed, monkeypatch, in_vain, confirmed):
    simulate, calls = testbench.Testbench.transient, []

    def transient(self, *asked):
        calls.append(asked)
        if (len(calls) - 1) % 2 < in_vain:  # of the two attempts for each candidate
            raise SimulationError("the time step became too small")
        return simulate(self, *asked)

    monkeypatch.setattr(testbench.Testbench, "transient", transient)
    found = search.judge({"question": Question((crossed,))}, lambda _: None)
    assert found.instabilities
    assert len(calls) % 2 == 0
    assert all(each.confirmed is confirmed for each in found.instabilities)
    # the follower of the angle with crossed inputs: C s v = g v - v/R, so s = 2 pi f (A - 1)
    rate = 2 * np.pi * POLE_HZ * (GAIN - 1)
    assert max(each.real for each in found.instabilities) == pytest.approx(rate, rel=0.02)


@pytest.mark.parametrize(("of_the_phantom", "told"), [(3.9, "true"), (15.0, "phantom"), (1.0, "true")])
def test_the_pole_that_grows_as_fast_as_it_should_is_told(crossed, monkeypatch, of_the_phantom, told):
    """A slower pole makes the kick of what is no pole grow as well, but as t^2 and not by exp(2.5)."""
    rate = 2 * np.pi * POLE_HZ * (GAIN - 1)
    phantom = complex(20 * rate, 2e3 * rate)
    truly = search._poles
    monkeypatch.setattr(search, "_poles", lambda seen, loop: [(loop[0], phantom), *truly(seen, loop)])
    monkeypatch.setattr(
        search._Court,
        "_growth",
        lambda self, port, pole, ohms, volts: of_the_phantom if pole == phantom else 12.0,
    )
    found = search.judge({"question": Question((crossed,))}, lambda _: None).instabilities
    expected = phantom.real if told == "phantom" else rate
    assert all(each.confirmed for each in found)
    assert max(each.real for each in found) == pytest.approx(expected, rel=0.02)
