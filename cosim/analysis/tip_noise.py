"""Force noise at a tip that is held still: of potentiometers and of components, for any analog gains.

The gains multiply: with k and c along the wall's normal every source's force is a + k p + c d, with transfers
a, p, d of the circuit. Its mean square over a band is a quadratic form in (1, k, c), computed once.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cosim.analysis.noise_period import noise_grid
from cosim.analysis.tip import Tip, Wanted, tip_of
from cosim.circuits.extraction.noise_contributions import ComponentNoise
from cosim.ngspice.child import Child, call
from cosim.ngspice.deck import Deck
from cosim.scene import Method, PotNoise, Scene
from cosim.types import Array, Complex

__all__ = [
    "NoiseForm",
    "component_force",
    "component_form",
    "flat",
    "position_density",
    "pot_density",
    "pot_form",
]


#: Of a density that is flat up to a corner, the share below these frequencies is negligible.
_LOW_HZ, _POINTS = 1e-1, 400


@dataclass(frozen=True)
class NoiseForm:
    """Mean square force along the normal as (1, k, c) G (1, k, c)^T; `gram` is G [3, 3] in SI."""

    gram: Array

    def rms(self, stiffness: Array | float, damping: Array | float) -> Array:
        """Return the rms force [N] for stiffness [N/m] and damping [N s/m], elementwise."""
        k, c = np.broadcast_arrays(np.asarray(stiffness, float), np.asarray(damping, float))
        v = np.stack([np.ones(k.shape), k, c], axis=-1)
        square = np.einsum("...a,ab,...b->...", v, self.gram, v)
        return np.asarray(np.sqrt(np.maximum(square, 0.0)), np.float64)


def flat(rms_rad: float, band_hz: float, points: int = _POINTS) -> tuple[Array, Array]:
    """Return frequencies and the one-sided density [rad^2/Hz] of white noise up to a band's end."""
    hz = np.concatenate([[0.0], np.geomspace(_LOW_HZ, band_hz, points)])
    return hz, np.full(len(hz), rms_rad**2 / band_hz)


def pot_density(scene: Scene, kind: PotNoise) -> tuple[Array, Array] | None:
    """Return frequencies and the one-sided density [rad^2/Hz] of a kind of potentiometer noise at rest.

    What runs draw is linear between independent values every h seconds: 2 h var sinc^4(f h). Kinds that
    belong to the angle or never change are silent at rest: None.
    """
    if kind not in (PotNoise.WHITE, PotNoise.PEAK_TO_PEAK):
        return None
    grid = noise_grid(
        scene.model_copy(update={"effects": scene.effects.model_copy(update={"pot_noise": kind})})
    )
    h = grid.periods * scene.computer.period_s / grid.ticks
    hz = np.concatenate([[0.0], np.geomspace(_LOW_HZ, 8.0 / h, _POINTS)])
    return hz, 2.0 * h * grid.variance * np.sinc(hz * h) ** 4


def position_density(scene: Scene, speed_rad_per_s: float) -> tuple[Array, Array]:
    """Return the same of noise that belongs to the angle, for a joint that turns at a speed.

    Runs blend independent values every `position_period_rad` by half cosines, so its density is that of the
    pulse cos(pi y/2), |y| < 1, in units of the time from value to value.
    """
    pot = scene.device.potentiometer
    h = pot.position_period_rad / speed_rad_per_s
    hz = np.concatenate([[0.0], np.geomspace(_LOW_HZ * min(1.0, 1.0 / h), 30.0 / h, 2 * _POINTS)])
    x = hz * h
    # (4/pi) cos(2 pi x)/(1 - (4 x)^2), written without the division by zero at x = 1/4
    pulse = np.sinc(2.0 * x - 0.5) + np.sinc(2.0 * x + 0.5)
    return hz, 2.0 * h * pot.noise_rad**2 * pulse**2


def pot_form(tip: Tip, density: tuple[Array, Array]) -> NoiseForm:
    """Return the force noise of independent noise of this density at every potentiometer."""
    hz, power = density
    n = tip.circuit.joints
    s = 2j * np.pi * hz
    parts = []
    for wanted in (Wanted(1.0), Wanted(0.0, 1.0)):
        y = tip.circuit.response(s, tip.control(wanted))[:, :, :n]
        parts.append(-tip.constants.torque_per_amp * np.einsum("i,fij->fj", tip.pushed, y))
    zero = np.zeros_like(parts[0])
    return NoiseForm(_gram(hz, np.stack([zero, *parts], axis=-1) * np.sqrt(power)[:, None, None]))


def component_form(tip: Tip, noise: ComponentNoise, band_hz: float) -> NoiseForm:
    """Return the force noise of the board's components up to a frequency, device by device independent."""
    inside = noise.hz <= band_hz
    scale = tip.constants.torque_per_amp
    base = noise.currents(np.zeros(len(noise.gain)))
    parts = [base]
    for wanted in (Wanted(1.0), Wanted(0.0, 1.0)):
        parts.append(noise.currents(tip.control(wanted)) - base)
    force = np.stack([scale * np.einsum("fdi,i->fd", part, tip.pushed) for part in parts], axis=-1)
    return NoiseForm(_gram(noise.hz[inside], force[inside]))


def component_force(scene: Scene, board: Deck, child: Child | None = None) -> float:
    """Return the rms force [N] of the board's components along the normal, the tip held still.

    At the scene's analog gains, up to its `device.component_noise_bandwidth_hz`.
    """
    tip, computer = tip_of(scene, child), scene.computer
    analog = computer.method is not Method.DISCRETE
    noise = call(
        "cosim.circuits.extraction.noise_contributions:component_noise", {"board": board},
        time_limit_s=scene.solver.time_limit_s, deck=str(board.path), child=child,
    )  # fmt: skip
    form = component_form(tip, noise, scene.device.component_noise_bandwidth_hz)
    gains = (computer.analog_stiffness_n_per_m, computer.analog_damping_n_s_per_m) if analog else (0.0, 0.0)
    return float(form.rms(*gains))


def _gram(hz: Array, force: Complex) -> Array:
    """Integrate the products of parts [F, sources, 3] over frequency, summed over sources."""
    products = np.einsum("fsa,fsb->fab", force.conj(), force).real
    out: Array = np.trapezoid(products, hz, axis=0)
    return out
