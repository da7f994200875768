"""References of transients: extrapolation, IDA and ngspice agree on a circuit of diodes and B sources."""

import math

import numpy as np
import pytest
from reference.mna import Circuit
from reference.transient import Transient
from support import shared_child

from cosim.ngspice.child import call

#: A clipper of two diodes, its output squared by a B source and filtered; node `sq` has no capacitor.
DECK = """\
clipper
V1 in 0 {source}
R1 in a 1k
D1 a 0 soft
D2 0 a soft
C1 a 0 50n
B1 sq 0 v=v(a)*v(a)+0.1*v(a)
R2 sq out 10k
C2 out 0 20n
.model soft d(is=1e-9 n=1.5)
{options}.end
"""
END_S, HZ = 1e-3, 1e3


def drive(t):
    """A sine that begins with no slope, so that rest is a consistent start."""
    return 1.5 * (1.0 - math.cos(2 * math.pi * HZ * t))


@pytest.fixture(scope="module")
def extrapolated():
    circuit = Circuit(DECK.format(source="0", options=""))
    times = np.linspace(0.0, END_S, 201)
    return circuit, times, Transient(circuit, {"v1": drive}).by_extrapolation(times)


def test_extrapolation_has_converged(extrapolated):
    circuit, times, states = extrapolated
    lower = Transient(circuit, {"v1": drive}).by_extrapolation(times[::2], columns=6)
    # order 6 at twice the step: the finer one, of order 7, is 2^7 times closer, which is 1e-9
    assert np.abs(states[::2] - lower).max() < 2e-7


def test_ida_agrees_with_extrapolation(extrapolated):
    pytest.importorskip("sksundae")
    circuit, times, states = extrapolated
    other = Transient(circuit, {"v1": drive}).by_ida(times, 1e-9, 1e-11)
    # its tolerance of each step, times some hundred steps
    assert np.abs(other - states).max() < 1e-7 * np.abs(states).max()


def test_tight_ngspice_agrees_with_extrapolation(extrapolated):
    circuit, times, states = extrapolated
    options = ".options reltol=1e-6 abstol=1e-15 vntol=1e-9 chgtol=1e-18 method=trap\n"
    deck = DECK.format(source=f"dc 0 sin(1.5 -1.5 {HZ:g} 0 0 90)", options=options)
    step = END_S / 20_000
    asked = {"deck": deck, "command": f"tran {step!r} {END_S!r} 0 {step!r}", "names": ("time", "a", "out")}
    t, a, out = call("cosim.accuracy.hard_cases.hard_case:analysed", asked, child=shared_child())
    for name, volts in (("a", a), ("out", out)):
        exact = states[:, circuit.index[name]]
        # steps of 50 ns on a clipper of some 10 us: (0.005)^2/12 of volts
        off = np.abs(np.interp(times, t, np.real(volts)) - exact).max()
        print(f"{name}: ngspice off by {off:.1e} V")
        assert off < 1e-6, name
