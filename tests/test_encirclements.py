"""Poles counted on impedances that are known in closed form, and where rounding hides them."""

import numpy as np
import pytest

from cosim.circuits.instability.encirclements import SWEEP, count, measure
from cosim.errors import SimulationError


def _asked(impedance, noise_from_hz):
    """Answer sweeps with an impedance of one port; from a frequency on its phase is without meaning."""
    rng, asked = np.random.default_rng(1), [0]

    def ask(sweep):
        kind, points, low, high = sweep.split()
        low, high = float(low), float(high)
        hz = (
            np.logspace(np.log10(low), np.log10(high), round(int(points) * np.log10(high / low)) + 1)
            if kind == "dec"
            else np.linspace(low, high, int(points))
        )
        asked[0] += len(hz)
        z = impedance(2j * np.pi * hz)
        noisy = hz >= noise_from_hz
        z[noisy] *= np.exp(1j * rng.uniform(-np.pi, np.pi, noisy.sum()))
        return hz, z[:, None, None]

    return ask, asked


@pytest.mark.parametrize(("sign", "poles"), [(1.0, 0), (-1.0, 1)])
def test_rounding_beyond_every_part_ends_the_sweep(sign, poles):
    # 1 kOhm with a pole at 1e6 rad/s, left or right; the phase is noise from 60 THz on
    ask, asked = _asked(lambda s: 1e3 / (1.0 + sign * s / 1e6), 6e13)
    seen, chosen = measure(ask)
    assert chosen == [0]
    assert count(seen.of(chosen)) == poles
    assert 1e10 < seen.hz[-1] < 6e13
    assert asked[0] < 10_000  # every round of a search without end has about five times the points


def test_rounding_within_the_band_of_parts_is_told():
    ask, asked = _asked(lambda s: 1e3 / (1.0 + s / 1e6), 1e9)
    with pytest.raises(SimulationError, match="lost in rounding"):
        measure(ask)
    assert asked[0] < 10_000


def test_a_sweep_without_rounding_keeps_its_ends():
    ask, _ = _asked(lambda s: 1e3 / (1.0 + s / 1e6), np.inf)
    seen, _ = measure(ask)
    low, high = SWEEP.split()[2:]
    assert (seen.hz[0], seen.hz[-1]) == (pytest.approx(float(low)), pytest.approx(float(high)))
