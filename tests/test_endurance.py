"""Long runs do not drift: the clock, the ledger of energy, the place at rest, the memory."""

import numpy as np
import pytest

from benchmarks import endurance

#: What the drop turns over [J]: 0.2 kg fall 10 mm and sink as far, and some bounces.
TURNOVER_J = 0.05


def settled(track: endurance.Track, name: str) -> float:
    """Slope of a line through what was noted, a sample or a second."""
    return track.lines()[name][0]


def test_at_rest_rounding_does_no_work() -> None:
    """3000 samples of the drop, which rests from 2 s on.

    The last digit of the energy turned over may be lost a sample, not more: it was 2.8e-14 J before the
    speeds at the nodes were made to add up to the way.
    """
    track, wrong = endurance.drop(3000)
    assert wrong == 0
    noted = np.array(track.marks).reshape(-1, len(track.names))
    assert abs(noted[:, 1]).max() < 1e-5 * TURNOVER_J  # a ledger closes to that (`energy_ledger.CLOSURE`)
    late = noted[4:]
    assert abs(np.diff(late[:, 1])).max() / 256 < np.finfo(float).eps * TURNOVER_J
    assert np.ptp(late[:, 2]) < 1e-9  # rad: the tolerance of the coupling is 1e-7


@pytest.mark.slow
def test_a_million_samples_of_the_drop() -> None:
    track, wrong = endurance.drop(endurance.SAMPLES)
    assert wrong == 0
    assert abs(settled(track, "ledger_j")) < np.finfo(float).eps * TURNOVER_J
    assert abs(track.lines()["ledger_j"][2]) < 1e-9 * TURNOVER_J
    assert abs(settled(track, "bytes")) < 0.2  # what is noted takes 32 bytes every 256 samples


@pytest.mark.slow
def test_ngspice_runs_at_constant_memory() -> None:
    """An hour takes half an hour of computing: 100 s, 8000 samples and more, tell a leak of a point."""
    track = endurance.press(100.0)
    points = 0.5 * 100.0 / 5e-4
    assert abs(track.lines()["bytes"][2]) < 8.0 * points / 4  # a vector of one number a point is told
    assert abs(track.lines()["ledger_j"][2]) < 1e-9
