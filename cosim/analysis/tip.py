"""What a board renders at the fingertip along a wall's normal, and the device's viscosity there."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from cosim.analysis.held_contact import HeldContact
from cosim.errors import fail
from cosim.ngspice.child import Child
from cosim.plan import resolve
from cosim.scene import CircuitModelName, Scene
from cosim.types import Array, Complex
from mech import Chain

__all__ = ["Tip", "Wanted", "joint_area", "reached", "row", "tip_of"]


#: Points of the path round a circle: its integrand is smooth and periodic, the rule exact to rounding.
_CIRCLE = 64


def row(columns: dict[str, list[Any]], values: dict[str, Any]) -> None:
    """Add a row to the columns of a table."""
    for name, value in values.items():
        columns.setdefault(name, []).append(value)


@dataclass(frozen=True)
class Wanted:
    """Analog gains at the tip along the normal: N/m and N s/m."""

    stiffness: float = 0.0
    damping: float = 0.0


@dataclass(frozen=True)
class Tip(HeldContact):
    """A held contact with its `linear` circuit, looked at from the fingertip."""

    @cached_property
    def motion(self) -> Array:
        """Joint motion for a unit of motion along the normal, none along the wall [n] rad/m."""
        out: Array = np.linalg.pinv(self.linkage.jacobian(self.q)) @ self.normal
        return out

    @cached_property
    def pushed(self) -> Array:
        """Force along the normal of the torques that equal motors would give for a unit current [n] rad/m."""
        out: Array = self.motion * self.constants.motor_ratios(len(self.motion))
        return out

    def control(self, wanted: Wanted) -> Array:
        """Return the volts at the gain pins [m] for k n n^T and c n n^T at the tip."""
        c, square = self.constants, np.outer(self.torques, self.torques).ravel()
        return np.concatenate(
            [wanted.stiffness * square * c.v_fs / c.k_fs, wanted.damping * square * c.v_fs / c.c_fs]
        )

    def impedance(self, wanted: Wanted, hz: Array) -> Complex:
        """Return force over motion along the normal [F] N/m, the tip led along it: k + jwc of an ideal board.

        The motors' back-EMF is left out: it is no part of what is commanded.
        """
        n = self.circuit.joints
        y = self.circuit.response(2j * np.pi * np.asarray(hz), self.control(wanted))[:, :, :n]
        per_amp = self.constants.torque_per_amp
        out: Complex = -per_amp * np.einsum("i,fij,j->f", self.pushed, y, self.motion)
        return out

    def joint_viscosity(self) -> Array:
        """Return bearings and back-EMF at low frequency [n, n] N m s/rad."""
        n, c = self.circuit.joints, self.constants
        back = self.circuit.after(0.0)[0].real[:, len(self.circuit.gain) + n :]
        bearings = np.diag(self.linkage.pack()[0]["viscous"][:n])
        back = c.motor_ratios(n)[:, None] * back
        out: Array = bearings - c.torque_per_amp * c.gear * 0.5 * (back + back.T)
        return out

    def viscosity(self) -> float:
        """Return the device's viscosity along the normal, free along the wall: 1/(w^T B^-1 w) [N s/m].

        A late spring k n n^T takes k times its delay from just this, whatever B is.

        Raises
        ------
        InputError
            For a device without viscosity: delay has nothing to take.
        """
        w, inner = self.torques, self.joint_viscosity()
        least = float(np.linalg.eigvalsh(inner)[0])
        if not least > 0.0:
            fail(
                    "a joint has no viscosity that delay could eat, neither back-EMF nor friction",
                    file=self.scene.file_name, key="effects.viscous",
                    value=least, unit="N m s/rad",
                )  # fmt: skip
        return float(1.0 / (w @ np.linalg.solve(inner, w)))


def tip_of(scene: Scene, child: Child | None = None) -> Tip:
    """Return the scene with its `linear` circuit at the pose that touches its wall.

    Of a scene for `spice` it is the small-signal circuit of the same parts, slew and clipping left out.

    Raises
    ------
    InputError
        Without a wall, or for a board that has no linear model.
    """
    if scene.wall is None:
        fail("what is rendered is looked at along a wall's normal",
                    file=scene.file_name, key="wall")  # fmt: skip
    linear = scene
    if scene.solver.model is not CircuitModelName.SPICE:
        solver = scene.solver.model_copy(update={"model": CircuitModelName.LINEAR})
        linear = scene.model_copy(update={"solver": solver})
    return Tip.of(resolve(linear), child=child)


def reached(tip: Tip, points: int, margin_rad: float) -> list[Tip]:
    """Return the scene at a grid of poses over its workspace; a slider has the one.

    Parameters
    ----------
    points
        Of each joint angle.
    margin_rad
        Poses nearer to full stretch or fold are left out.

    Raises
    ------
    InputError
        For a chain of another number of joints than two.
    """
    if tip.scene.is_slider:
        return [tip]
    if tip.scene.joints != 2:
        fail("poses are mapped for two joints", key="device.chain")
    bends = np.linspace(margin_rad, np.pi - margin_rad, points)
    turns = np.linspace(-np.pi, np.pi, points, endpoint=False)
    return [tip.at(np.array([turn, bend])) for bend in bends for turn in turns]


def joint_area(chain: Chain, q: Array, radius: float) -> float:
    """Return the area [rad^2] within the joints' path while the tip goes round a circle, centre at `q`.

    Half the integral of q1 dq2 - q2 dq1, dq = J^-1 dr: smooth and periodic, so that equal steps are exact to
    rounding.

    Raises
    ------
    ValueError
        Where the circle leaves the workspace.
    """
    centre, seed, area = chain.forward(q), q, 0.0
    for turn in 2 * np.pi * np.arange(_CIRCLE) / _CIRCLE:
        out, along = np.array([np.cos(turn), np.sin(turn)]), np.array([-np.sin(turn), np.cos(turn)])
        seed = np.asarray(chain.inverse(centre + radius * out, seed=seed))
        dq = np.linalg.solve(chain.jacobian(seed), radius * along)
        area += float(seed[0] * dq[1] - seed[1] * dq[0])
    return abs(area) * np.pi / _CIRCLE
