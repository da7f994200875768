"""Exact second moments of a held contact under its potentiometers' noise, without random draws.

The noise is what a run draws (`cosim.loop.noise`): independent values on a grid, linear between its ticks.
Samples and ticks repeat together after a few periods, so the scene is a linear system with periodic
coefficients, its covariance cyclostationary. It is solved over that common period, with everything that
happens between two events integrated exactly; rms values are those over time.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from cosim.analysis.control_law import law_point, resting_pose
from cosim.analysis.covariance_steps import integral, repeated, stationary, summed
from cosim.analysis.held_contact import HeldContact
from cosim.analysis.linearise import linearise
from cosim.analysis.noise_period import Grid, common_period, noise_grid
from cosim.analysis.period_map import Lifted, lift
from cosim.errors import InputError, Problem, fail
from cosim.scene import PotNoise, Scene
from cosim.types import Array

__all__ = [
    "NoiseCovariance",
    "beyond_linear",
    "covariance",
    "moments_about",
    "noise_covariance",
    "require_linear",
    "static_covariance",
]


#: A bandwidth that is shifted by more than this share to make them meet is reported.
_SHIFTED = 1e-9
#: Standard deviations that the contact and the driver's limit must leave room for.
_ROOM = 4.0


@dataclass(frozen=True)
class NoiseCovariance:
    """Second moments of a contact under the noise of its potentiometers, about the pose of rest.

    Attributes
    ----------
    kind
        Of the noise.
    q
        Pose of rest [rad].
    mean
        By name as in `System.outputs`: covariance averaged over time.
    at_samples
        The same just before the first sample of the common period.
    step, added
        Map of X over the common period from just before a sample, and what noise adds to its covariance.
    state
        Stationary covariance of X there; symmetric, positive semidefinite.
    rows
        By name: what each output takes from X there.
    periods
        Sampling periods in the common period.
    notes
        What was left out.
    """

    kind: str
    q: Array
    mean: dict[str, Array]
    at_samples: dict[str, Array]
    step: Array
    added: Array
    state: Array
    rows: dict[str, Array]
    periods: int
    notes: tuple[str, ...]

    def rms(self, name: str) -> float:
        """Return the root of the mean square over time, of a vector that of its length."""
        return math.sqrt(float(np.trace(self.mean[name])))

    def freedom(self, name: str, count: int) -> float:
        """Return the degrees of freedom of a variance estimated from `count` values about the known mean.

        The values are those of the first component just before the samples that begin a common period; they
        are correlated, so that Var(s^2) = 2/count sum of gamma_k^2 (1 - |k|/count) for Gaussian noise.
        """
        row = self.rows[name][:1]
        seen, first, total = row @ self.state, float((row @ self.state @ row.T)[0, 0]), 0.0
        for k in range(1, count):
            seen = seen @ self.step.T
            gamma = float((seen @ row.T)[0, 0])
            total += 2.0 * gamma**2 * (1.0 - k / count)
            if k > 10 and np.abs(seen).max() < 1e-9 * np.abs(self.state).max():
                break
        return count * first**2 / (first**2 + total)

    def transient(self, name: str, count: int) -> Array:
        """Return rms values just before the sample `count` common periods long, from rest at the first."""
        p = np.zeros_like(self.state)
        out = np.zeros(count)
        for k in range(count):
            p = self.step @ p @ self.step.T + self.added
            out[k] = math.sqrt(max(float(np.trace(self.rows[name] @ p @ self.rows[name].T)), 0.0))
        return out

    def as_dict(self) -> dict[str, object]:
        """Return rms values JSON-ready; names carry units."""
        return {
            "kind": self.kind,
            "force_noise_rms_n": self.rms("motor_normal"),
            "force_noise_all_rms_n": self.rms("motor_force"),
            "operator_force_noise_rms_n": self.rms("operator_normal"),
            "jitter_rms_m": self.rms("tip"),
            "penetration_jitter_rms_m": self.rms("penetration"),
            "angle_jitter_rms_rad": [math.sqrt(x) for x in np.diag(self.mean["angles"]).clip(0.0)],
            "common_period_samples": self.periods,
            "pose_rad": self.q.tolist(),
            "notes": list(self.notes),
        }


def covariance(
    lifted: Lifted, grid: Grid, kind: str = "white", notes: tuple[str, ...] = ()
) -> NoiseCovariance:
    """Return the stationary second moments of a scene lifted with noise.

    Raises
    ------
    InputError
        When the contact is not stable, or something is free to drift: nothing is stationary then.
    """
    assert lifted.noise is not None
    period = common_period(lifted, grid)
    pieces, product, added, draw = period.pieces, period.step, period.added, period.draw
    try:
        state = stationary(product, added)
    except ValueError:
        z = np.linalg.eigvals(product)
        worst = z[int(np.argmax(np.abs(z)))]
        raise InputError(
            Problem(
                f"the held contact has no stationary noise: a mode grows by {abs(worst):.6g} in "
                f"{grid.periods} period(s), so it is unstable, or free where nobody holds it",
                key="computer.discrete_stiffness_n_per_m",
            )
        ) from None
    # what happens within: second moments at all starts, gathered by the length of their stretches
    gathered: dict[float, Array] = {}
    p = state
    for piece, (step, more) in zip(pieces, period.steps, strict=True):
        starts = summed(step, p, piece.count)
        if piece.count > 1:
            power, cover, sums = repeated(step, more, piece.count)
            starts, p = starts + sums, power @ p @ power.T + cover
        else:
            p = step @ p @ step.T + more
        behind = piece.event @ starts @ piece.event.T + (piece.count * draw if piece.fresh else 0.0)
        moment = piece.stretch.enter @ behind @ piece.stretch.enter.T
        length = float(f"{piece.stretch.length_s:.12e}")
        gathered[length] = gathered.get(length, np.zeros_like(moment)) + moment
    system = lifted.system
    e = np.zeros(system.b.shape)
    e[:, -system.joints :] = system.e
    moments = [integral(system.a, system.b, e, h, moment) for h, moment in gathered.items()]
    total: Array = np.sum(moments, axis=0) / (grid.periods * system.period_s)
    rows = {name: lifted.output(out) for name, out in system.outputs.items()}
    seen = {name: row @ pieces[-1].stretch.exit for name, row in rows.items()}
    return NoiseCovariance(
        kind=kind, q=system.q,
        mean={name: row @ total @ row.T for name, row in rows.items()},
        at_samples={name: row @ state @ row.T for name, row in seen.items()},
        step=product, added=added, state=state, rows=seen, periods=grid.periods,
        notes=(*system.notes, *notes),
    )  # fmt: skip


def static_covariance(lifted: Lifted, variance: float) -> NoiseCovariance:
    """Return the second moments over offsets that stay: they shift the pose of rest, linearly."""
    assert lifted.noise is not None
    system, size, n = lifted.system, lifted.size, lifted.system.joints
    step = lifted.period()
    inner = slice(0, lifted.noise[0].start)
    offset = np.zeros((size, n))
    offset[lifted.noise[0]] = offset[lifted.noise[1]] = np.eye(n)
    count = inner.stop
    offset[inner] = np.linalg.solve(np.eye(count) - step[inner, inner], (step @ offset)[inner])
    state = variance * offset @ offset.T
    times = [*lifted.instants(), system.period_s]
    last = lifted.stretch(times[-2], times[-1] - times[-2], (0.0, 1.0)).exit
    rows = {name: lifted.output(out) @ last for name, out in system.outputs.items()}
    mean = {name: row @ state @ row.T for name, row in rows.items()}
    return NoiseCovariance(
        "static", system.q, mean, mean, step, np.zeros((size, size)), state, rows, 1, system.notes
    )


def require_linear(scene: Scene) -> None:
    """Raise an `InputError` where noise or scene are not linear about a contact at rest."""
    kind, file = scene.effects.pot_noise, scene.file_name
    reasons = {
        PotNoise.NONE: "the scene has no noise of its potentiometers",
        PotNoise.POSITION: "noise that belongs to the angle is no noise in time: at rest it is silent",
    }
    if kind in reasons:
        fail(reasons[kind], file=file, key="effects.pot_noise", value=kind.value)
    if scene.effects.coulomb:
        fail(
                "Coulomb friction is not linear about rest: small noise moves nothing",
                file=file, key="effects.coulomb", value=True, allowed="false",
            )  # fmt: skip


def noise_covariance(contact: HeldContact) -> NoiseCovariance:
    """Return the exact second moments of a scene at rest in contact, under its potentiometers' noise.

    The pose of rest is searched from that of the contact.

    Raises
    ------
    InputError
        Where noise or scene are not linear about the contact, with the reason.
    """
    require_linear(contact.scene)
    at_rest = contact.at(resting_pose(contact))
    lifted = lift(linearise(at_rest), noise=True)
    moments = moments_about(at_rest, lifted)
    if contact.scene.effects.pot_noise is PotNoise.STATIC:
        return moments
    return _checked(moments, at_rest, lifted)


def moments_about(contact: HeldContact, lifted: Lifted | None = None) -> NoiseCovariance:
    """Return the second moments about the contact's own pose, which need not be one of rest.

    Raises
    ------
    InputError
        When the contact is not stable, or something is free to drift.
    """
    scene = contact.scene
    kind = scene.effects.pot_noise
    lifted = lifted or lift(linearise(contact), noise=True)
    if kind is PotNoise.STATIC:
        return static_covariance(lifted, scene.device.potentiometer.noise_rad**2)
    grid = noise_grid(scene)
    notes = (
        ["the components' noise, which is no part of these figures"] if scene.effects.component_noise else []
    )
    if grid.shift > _SHIFTED:
        notes.append(
            f"the noise's bandwidth was shifted by {grid.shift:.2g} of itself, to meet the samples again"
        )
    return covariance(lifted, grid, kind.value, tuple(notes))


def _checked(moments: NoiseCovariance, at_rest: HeldContact, lifted: Lifted) -> NoiseCovariance:
    """Add notes where noise of this size reaches the wall's surface or the driver's limit."""
    rms_a = np.sqrt(np.diag(moments.mean["currents"]).clip(0.0))
    beyond = beyond_linear(at_rest, moments.rms("penetration"), rms_a, lifted.system.current_a)
    return replace(moments, notes=(*moments.notes, *beyond))


def beyond_linear(at_rest: HeldContact, depth_m: float, rms_a: Array, current_a: Array) -> list[str]:
    """Return notes where noise reaches the wall's surface or the driver's limit.

    Parameters
    ----------
    depth_m, rms_a
        Rms of the depth [m] and of the currents [n] A about rest.
    current_a
        [n], currents at rest [A].
    """
    notes = []
    depth = law_point(at_rest.scene, at_rest.constants, at_rest.linkage, at_rest.q).penetration_m
    if depth < _ROOM * depth_m:
        notes.append(
            f"the contact is only {1e3 * depth:.3g} mm deep, {depth / depth_m:.2g} "
            "standard deviations: the tip leaves the wall now and then"
        )
    limit = at_rest.circuit.limit
    if ((current_a + _ROOM * rms_a > limit[:, 1]) | (current_a - _ROOM * rms_a < limit[:, 0])).any():
        notes.append("the noise reaches the driver's current limit, which a linear system does not know")
    return notes
