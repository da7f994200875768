"""Passivity against closed forms: Colgate and Schenkel, devices with dynamics, energy of runs."""

import math

import numpy as np
import pytest
from held_scenes import RADIUS, at_wall, carriage
from linear_runs import ideal, lagging
from support import EMF_TRUE, merge, quick, slider

from cosim.analysis.device_passivity import delivered, device_of, law_of
from cosim.analysis.passivity import Device, Law, _used, least_damping, needed_damping, share_used, wall


def plain(b):
    return Device(np.ones(1), lambda omega: np.full((len(omega), 1, 1), b, complex))


def tip(impedance, command=None):
    """A device of one joint from its impedance at frequencies [rad/s]."""
    return Device(
        np.ones(1),
        lambda omega: impedance(1j * omega).real.astype(complex)[:, None, None],
        command,
    )


@pytest.mark.parametrize(
    ("law", "known"),
    [
        (wall(133.0, 0.0, 0.025), 1.6625),
        (wall(1000.0, 1.0, 1e-3), 1.5),
        (wall(1000.0, -1.0, 1e-3), 1.5),
        (wall(1000.0, 0.0, 1e-3, periods=1), 1.5),
        (wall(1000.0, 1.0, 1e-3, keep=0.5), 0.5 + 1.0 / 3.0),  # low-pass 1 ms: B T/(T + 2 tau)
    ],
    ids=["K", "K and B", "K and -B", "delay", "filtered"],
)
def test_published_numbers(law, known):
    """Theory's table, exact; the extension of a constant viscosity is the same condition."""
    result = needed_damping(law)
    assert result.value == pytest.approx(known, rel=1e-9)
    assert result.value <= result.upper <= result.value * (1 + 1e-8)
    # the extension's grid begins at 1e-4 of the half circle, where the delay's curve is 1e-7 lower
    assert share_used(law, plain(1.0)).value == pytest.approx(known, rel=2e-6)


@pytest.mark.parametrize("seed", range(20))
def test_the_certificate_against_a_dense_sweep(seed):
    """Random stable laws with light poles: peaks far narrower than any grid are found all the same."""
    generator = np.random.default_rng(seed)
    n = int(generator.integers(2, 6))
    a = generator.standard_normal((n, n))
    a *= (1.0 - 10.0 ** generator.uniform(-6, -1)) / np.abs(np.linalg.eigvals(a)).max()
    law = Law(a, generator.standard_normal(n), generator.standard_normal(n), 3.0, 1e-3)
    result = needed_damping(law)
    peaks = np.abs(np.angle(np.linalg.eigvals(a)))
    widths = np.geomspace(1e-9, 1.0, 400)
    theta = np.concatenate(
        [np.linspace(1e-5, np.pi, 20001), *[p + widths for p in peaks], *[p - widths for p in peaks]]
    )
    top = 2.0 * np.pi * law.period_s * result.frequency_hz
    theta = np.append(theta[(theta > 1e-4) & (theta <= np.pi)], max(top, 1e-4))
    z = np.exp(1j * theta)
    # the quotient as it stands in the condition: rounding of 1e-15 |H| over 5e-9 at the least angle
    needed = 0.5e-3 / (1 - np.cos(theta)) * ((1 - 1 / z) * law.response(z)).real
    rounding = 1e-6 * np.abs(law.response(z)).max() * law.period_s
    assert needed.max() <= result.upper + rounding
    if top > 1e-4:
        assert needed[-1] == pytest.approx(result.value, abs=rounding)


def test_a_peak_between_the_grids_points_is_found():
    """A broad resonance, and one of width 1e-8 that is higher: 6e-3 lie between two points of the grid.

    Near its pole p = (1 - w) exp(j t) the narrow one adds g/(2 (z - p)) to H, so -T Re{g/(2 (z - 1) (z - p))}
    to the damping: a circle of diameter T g/(4 sin(t/2) w) that touches 0, in the direction of
    -1/((z - 1) z), which has the cosine sin(3 t/2); its real part reaches (1 + sin(3 t/2))/2 of the diameter.
    """

    def resonance(radius, angle, gain):
        turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
        return radius * turn, np.array([gain, 0.0]), np.array([1.0, 0.0])

    angle, width, gain, period = np.pi * 100.5 / 512.0, 1e-8, 1e-4, 1e-3
    (a, b, c), (a2, b2, c2) = resonance(0.9, 2.0, 1.0), resonance(1.0 - width, angle, gain)
    zero = np.zeros((2, 2))
    law = Law(
        np.block([[a, zero], [zero, a2]]), np.concatenate([b, b2]), np.concatenate([c, c2]), 3.0, period
    )
    broad = needed_damping(Law(a, b, c, 3.0, period))
    result = needed_damping(law)
    peak = period * gain / (4.0 * math.sin(angle / 2.0) * width) * (1.0 + math.sin(1.5 * angle)) / 2.0
    assert peak > 100.0 * broad.value
    # what the broad one adds there is less than its own maximum
    assert result.value == pytest.approx(peak, abs=2.0 * broad.value)
    assert result.frequency_hz == pytest.approx(angle / (2.0 * np.pi * period), abs=1e-3)


@pytest.mark.parametrize(("hz", "known"), [(10.0, 25.7), (100.0, 108.0), (1000.0, 159.2), (1e9, 168.0)])
def test_a_damper_with_a_differentiator(hz, known):
    """c = 2, b = 0.1, one pole, T = 25 ms; the ideal damper gives 2 (b + c)/T = 168 N/m."""
    device = tip(lambda s: 0.1 + 2.0 / (1.0 + s / (2.0 * np.pi * hz)))
    assert 1.0 / share_used(wall(1.0, 0.0, 0.025), device).value == pytest.approx(known, abs=0.05)


def test_the_sum_over_aliases_is_its_closed_form():
    """At w = pi/T, b(w) = b/(1 + 1/w^2): sums of 1/n^2 and 1/n^4 over odd n, pi^2/8 and pi^4/96."""
    b, period = 0.7, 1.0
    device = tip(lambda s: b / (1.0 - 1.0 / s**2) + 0.0 * s)
    two = 2.0 * (math.pi**2 / 8.0) / math.pi**2
    four = 2.0 * (math.pi**4 / 96.0) / math.pi**4
    exact = 2.0 * (two + four) / b  # Re{(1 - exp(-j pi)) K}/T = 2 K/T
    assert _used(wall(1.0, 0.0, period), device, math.pi) == pytest.approx(exact, rel=1e-9)


@pytest.mark.parametrize("share", [0.1, 0.5, 0.9])
def test_a_delay_of_less_than_a_period(share):
    """Near w = 0: K/2 (h + sqrt(h^2 + T^2 f (1 - f))), h = T/2 + t_d, f = t_d/T, from the sum of the aliases.

    The second term under the root is the sum over n of |1 - exp(-2 pi j n f)|^2/w_n^2: what a late hold does
    to the aliases. Whole periods have none.
    """
    period, k = 1e-3, 1000.0
    late = share * period
    half = period / 2 + late
    exact = k / 2 * (half + math.sqrt(half**2 + period**2 * share * (1 - share)))
    result = share_used(wall(k, 0.0, period, lag_s=late), plain(1.0))
    assert result.value == pytest.approx(exact, rel=2e-5)
    assert result.value > k * half


def test_the_sum_over_aliases_of_a_late_force():
    """In the middle of the band, against a million aliases one by one and the integral over the others.

    In the sum that turns they cancel to 1e-12.
    """
    period, share, theta, b = 1e-3, 0.3, 2.0, 0.8
    law = wall(1000.0, 0.5, period, lag_s=share * period)
    omega = (theta + 2.0 * np.pi * np.arange(-500_000, 500_001)) / period
    over_t = law.response(np.array([np.exp(1j * theta)]))[0] / period
    p = over_t * (1.0 - np.exp(-1j * theta)) / (1j * omega) * np.exp(-1j * omega * law.lag_s)
    s = np.sum(p / (1j * omega)) / b
    squares = np.sum(1.0 / omega**2) + period**2 / (2.0 * np.pi**2 * 500_000.5)
    root = abs(over_t * (1.0 - np.exp(-1j * theta))) ** 2 * (squares / b) ** 2 - s.imag**2
    exact = 0.5 * (math.sqrt(root) - s.real)
    path = Device(np.ones(1), plain(b).damping, lambda x: np.ones((len(x), 1), complex))
    assert _used(law, path, theta) == pytest.approx(exact, rel=1e-9)


def test_a_path_of_its_own_that_does_nothing():
    straight = lambda omega: np.ones((len(omega), 1), complex)  # noqa: E731
    for law in (wall(1000.0, 0.0, 1e-3), wall(1000.0, 2.0, 1e-3, periods=1)):
        with_path = Device(np.ones(1), plain(1.0).damping, straight)
        assert share_used(law, with_path).value == pytest.approx(share_used(law, plain(1.0)).value, rel=1e-6)


def test_the_least_damping_of_analog_paths():
    """Spring k through one pole: b - k tau at w = 0; damper c through two equal poles: b - c/8."""
    tau, k = 1.0 / (2e3 * math.pi), 10446.0
    value, _ = least_damping(tip(lambda s: 1.6625 + k / (s * (1 + tau * s))))
    assert value == pytest.approx(1.6625 - k * tau, abs=1e-6)
    assert abs(value) < 1e-4  # the published limit itself
    value, omega = least_damping(tip(lambda s: 0.5 + 4.0 / (1 + 1e-4 * s) ** 2))
    assert value == pytest.approx(0.0, abs=1e-9)
    assert omega == pytest.approx(math.sqrt(3.0) / 1e-4, rel=1e-4)


# ---- scenes


def test_the_boards_back_emf_is_the_viscosity(tmp_path):
    """Nothing brakes but the motor: b = EMF/r^2 at the tip, and the limit is 2 b/T."""
    scene = carriage(tmp_path, 0.01, 0.2, 0.0, discrete_stiffness_n_per_m=100.0)
    device = device_of(at_wall(scene, ideal(1)))
    b = EMF_TRUE / RADIUS**2
    assert 1.0 / device.mobility(np.array([1.0, 1e3, 1e9])) == pytest.approx(b, rel=1e-9)
    share = share_used(law_of(scene), device).value
    assert 100.0 / share == pytest.approx(2.0 * b / 0.01, rel=1e-6)


def test_a_lag_of_the_circuit_costs_damping(tmp_path):
    """Spring of 100 N/m through poles of 1 kHz before and behind: -k sum(tau) at low frequency."""
    scene = carriage(
        tmp_path, 0.01, 0.2, 1.6, method="combined", analog_stiffness_n_per_m=100.0,
        discrete_stiffness_n_per_m=50.0,
    )  # fmt: skip
    device = device_of(
        at_wall(scene, lagging(ideal(1, emf=False), 2e3 * math.pi, 2e3 * math.pi)),
    )
    tau = 1.0 / (2e3 * math.pi)
    assert device.damping(np.array([1e-3]))[0, 0, 0].real / RADIUS**2 == pytest.approx(
        1.6 - 2.0 * tau * 100.0, rel=1e-5
    )
    assert share_used(law_of(scene), device).value > 50.0 * 0.01 / 2.0 / 1.6


@pytest.mark.parametrize("share", [0.9, 1.1])
def test_a_run_beyond_passivity_delivers_energy(tmp_path, share):
    """A carriage that hits a sampled wall of 2 b/T x share, all damping in its bearings."""
    b, period = 2.0, 0.01
    tables = merge(
        slider(
            duration_s=1.0,
            computer={
                "period_s": period, "method": "discrete", "analog_stiffness_n_per_m": 0.0,
                "discrete_stiffness_n_per_m": share * 2.0 * b / period,
            },
            device={
                "slider": {"mass_kg": 0.2, "viscous_n_m_s": b * RADIUS**2},
                "start": {"q_rad": [0.02], "v_rad_per_s": [-2.0]},
            },
            effects={"viscous": True},
            solver={"model": "ideal"},
        ), {},
    )  # fmt: skip
    run = quick(tmp_path, tables)
    result = delivered(run.signals, run.events, run.ledger)
    assert result.contacts
    # a held force is late by half a period: the display gives what the bearings then take
    assert result.most_j > 0.0
    assert not result.passive
    viscous = -run.ledger["work_j"]["viscous"]
    assert result.end_j < viscous


def test_a_continuous_spring_delivers_nothing(tmp_path):
    """What an ideal analog spring gives back it has been given: it is on between the same two samples only.

    Contact begins at a sample inside the wall, so the spring finds itself compressed: energy from switching
    on, k x^2/2, at most k (v T)^2/2 (theory), and nothing beyond.
    """
    tables = slider(
        duration_s=0.3,
        computer={"period_s": 0.002, "analog_stiffness_n_per_m": 100.0},
        device={
            "slider": {"mass_kg": 0.2},
            "start": {"q_rad": [0.02], "v_rad_per_s": [-2.0]},
        },
        solver={"model": "ideal"},
    )
    run = quick(tmp_path, tables)
    result = delivered(run.signals, run.events, run.ledger)
    most = 0.5 * 100.0 * (2.0 * RADIUS * 0.002) ** 2
    assert -result.doubt_j <= result.most_j <= most + result.doubt_j
    # started inside, at rest on its spring, it has no switching on at all: e_spring pays for everything
    inside = merge(
        tables, {"device": {"start": {"q_rad": [-0.02], "v_rad_per_s": [0.0]}}, "duration_s": 0.02}
    )
    run = quick(tmp_path, inside)
    assert delivered(run.signals, run.events, run.ledger).passive
