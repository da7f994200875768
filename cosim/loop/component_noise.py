"""Component noise in time: one random stream per device, shaped by its spectrum, the same in every model.

The measured transfers (`noise_contributions.py`) are applied to white streams by FFT, so that what two motors
share of a device is correlated as it is in the circuit. The result enters at two places: in series with X of
the multipliers, from where it passes through them at whatever gains the computer sets, and at the pins cmd,
where the noise of all that comes behind (multipliers' outputs, summer, driver, motor) is referred to, so that
it passes summer, driver and current limit like a command.

Ticks stand 1/(2 bandwidth) apart, and between them the noise is linear. A line from tick to tick takes
(2 + cos(2 pi f dt))/3 of the power that the ticks have at f, images beyond the bandwidth included; the ticks
are drawn as much stronger. So the noise has all the power that was measured up to the bandwidth: its density
is kept to 1.5 % up to half of that, falls to one half at the bandwidth, and what is missing stands above it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from cosim.errors import fail
from cosim.loop.noise import stream
from cosim.ngspice.deck import Deck
from cosim.scene import Scene
from cosim.types import Array, Complex, Report

if TYPE_CHECKING:
    from cosim.circuits.extraction.noise_contributions import ComponentNoise

__all__ = ["ComponentGrid", "component_grid", "realise", "references"]


#: Further length of the streams [s]: the FFT joins end and start, and no memory of the circuit is longer.
_APART_S = 1.0
#: The pins cmd do not move all motors where the determinant, relative to the largest entry, is below this.
_SINGULAR = 1e-9


@dataclass(frozen=True)
class ComponentGrid:
    """Component noise over a run, linear between ticks.

    Attributes
    ----------
    values : [ticks, g + n] V: noise at the g different X, then at the pins cmd
    dt : s, spacing of the ticks
    group : [m] which X a multiplier has
    probes : per multiplier the name of its X probe and the sign with which its voltage adds to X
    devices : names of the streams
    draws : how many random numbers were drawn
    about : what is drawn and what is left out, JSON-ready
    """

    values: Array
    dt: float
    group: NDArray[np.int64]
    probes: tuple[tuple[str, float], ...]
    devices: tuple[str, ...]
    draws: int
    about: dict[str, Any]

    @property
    def inputs(self) -> int:
        """Number of different X."""
        return int(self.group.max()) + 1


def component_grid(scene: Scene, board: Deck, report: Report) -> ComponentGrid | None:
    """Measure the board's noise and draw it for a scene, in ngspice's process; nothing where it is off."""
    if not scene.effects.component_noise:
        return None
    from cosim.circuits.extraction.noise_contributions import component_noise  # few runs have this noise

    measured = component_noise({"board": board}, report)
    return realise(measured, scene.seed, scene.duration_s, scene.device.component_noise_bandwidth_hz)


def references(noise: ComponentNoise) -> Complex:
    """Return each device's noise at every different X and at the pins cmd [F, D, g + n] V/sqrt(Hz).

    Raises
    ------
    InputError
        When the pins cmd do not move all motors: then nothing can be referred to them.
    """
    size = np.abs(np.linalg.det(noise.command))
    if not size.min() > _SINGULAR * np.abs(noise.command).max() ** noise.joints:
        fail(
            "component noise is referred to the pins cmd, and on this board they do not move every motor",
            key="effects.component_noise",
            value=True,
            allowed="false",
        )
    at_cmd = np.linalg.solve(noise.command, noise.motor.transpose(0, 2, 1)).transpose(0, 2, 1)
    at_x = noise.x[:, :, [group[0] for group in noise.groups]]
    return np.concatenate([at_x, at_cmd], axis=2)


def realise(noise: ComponentNoise, seed: int, duration_s: float, bandwidth_hz: float) -> ComponentGrid:
    """Draw the noise of a run.

    The values depend on seed, board, length of the run and bandwidth; a device's stream only on the seed and
    its name. The mean over the run has the density of the lowest frequency measured.
    """
    from scipy.fft import next_fast_len  # both import slowly, and few runs have this noise
    from scipy.interpolate import CubicSpline

    dt = 1.0 / (2.0 * bandwidth_hz)
    ticks = math.ceil(duration_s / dt) + 2
    size = int(next_fast_len(ticks + math.ceil(_APART_S / dt), real=True))
    table = references(noise)
    hz = np.fft.rfftfreq(size, dt)
    known = np.clip(hz, noise.hz[0], noise.hz[-1])
    drawn = np.sqrt(bandwidth_hz * 3.0 / (2.0 + np.cos(2.0 * np.pi * hz * dt)))
    spectrum = np.zeros((len(hz), table.shape[2]), complex)
    at = np.log(noise.hz)
    for d, device in enumerate(noise.devices):
        white = stream(seed, f"component/{device}", 0).standard_normal(size)
        # a white series of unit variance has the one-sided density 1/bandwidth
        shape = CubicSpline(at, table[:, d], axis=0)(np.log(known)) * drawn[:, None]
        spectrum += shape * np.fft.rfft(white)[:, None]
    values = np.fft.irfft(spectrum, size, axis=0)[:ticks]
    group = np.zeros(len(noise.gain), np.int64)
    for number, members in enumerate(noise.groups):
        group[list(members)] = number
    return ComponentGrid(
        np.ascontiguousarray(values), dt, group, noise.probes, noise.devices, size * len(noise.devices),
        summary(noise, bandwidth_hz),
    )  # fmt: skip


def summary(noise: ComponentNoise, bandwidth_hz: float) -> dict[str, Any]:
    """Say what is drawn and what is left out [A rms at each motor], with all gains zero and springs full."""
    top = float(noise.hz[-1])
    states = {"gains_zero": noise.springs(0.0), "springs_full": noise.springs(1.0)}
    return {
        "bandwidth_hz": bandwidth_hz,
        "devices": len(noise.devices),
        "rms_a": {name: noise.rms(v, (0.0, bandwidth_hz)).tolist() for name, v in states.items()},
        "left_out_to_hz": top,
        "left_out_a": {name: noise.rms(v, (bandwidth_hz, top)).tolist() for name, v in states.items()},
        "notes": list(noise.notes),
    }
