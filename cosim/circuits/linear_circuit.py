"""The `ideal` and `linear` circuit models: linear networks with multipliers between them."""

from __future__ import annotations

from dataclasses import dataclass, field, fields
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from cosim.types import Array, Complex

__all__ = ["GOOD", "LinearCircuit", "channel_names", "rational"]

#: A fit this good needs no remark: 1e-9 is promised, also between the points of a sweep.
GOOD = 3e-10


def channel_names(joints: int) -> list[str]:
    """Return the gain pins in the order of the multipliers: springs row by row, then dampers."""
    each = range(1, joints + 1)
    return [f"{kind}{i}{j}" for kind in ("ksp", "ksd") for i in each for j in each]


def rational(s: ArrayLike, a: Array, b: Array, c: Array, d: Array) -> Complex:
    """Return C (sI - A)^-1 B + D at the points `s`; shape [len(s), outputs, inputs]."""
    points: Complex = np.atleast_1d(np.asarray(s, np.complex128))
    out: Complex = np.zeros((len(points), *d.shape), np.complex128)
    out += d
    if len(a):
        left = points[:, None, None] * np.eye(len(a)) - a
        out += c @ np.linalg.solve(left, np.broadcast_to(b.astype(complex), (len(points), *b.shape)))
    return out


@dataclass(frozen=True)
class LinearCircuit:
    """A board of n joints around its operating point, its m = 2 n^2 multipliers kept as products.

    Before the multipliers: z' = a_pre z + b_pre [pot; u] and X = c_pre z + d_pre [pot; u] + e_pre d pot/dt.
    Multiplier c: w_c = gain_c (X_c + x_offset_c) (Y_c + y_offset_c).
    After them: q' = a_post q + b_post [w; cmd; vel] and
    imot = c_post q + d_post [w; cmd; vel] + offset, clamped to `limit`.

    Attributes
    ----------
    joints
        n. The multipliers stand in the order of `channel_names`.
    model
        ``"ideal"`` (no states) or ``"linear"``.
    a_pre, b_pre, c_pre, d_pre
        [Np, Np], [Np, 2 n], [m, Np], [m, 2 n]; inputs are the pins pot and u [V].
    e_pre
        [m, n], V per V/s at pot: the damper as frequency goes to zero, or a pure differentiator.
    gain
        [m], 1/V: w_c per X_c and volt at the channel's gain pin.
    a_post, b_post, c_post, d_post
        [Nq, Nq], [Nq, m + 2 n], [n, Nq], [n, m + 2 n]; inputs are w [V], cmd [V], vel [V]; outputs A.
    offset
        [n] A at zero input, without what passes the multipliers.
    limit
        [n, 2] A, lowest and highest current of each motor.
    certificate
        What the model promises, ready for JSON.
    x_offset, y_offset
        [m] V, of each multiplier's inputs, with all that stands before them.
    """

    joints: int
    model: str
    a_pre: Array
    b_pre: Array
    c_pre: Array
    d_pre: Array
    e_pre: Array
    gain: Array
    a_post: Array
    b_post: Array
    c_post: Array
    d_post: Array
    offset: Array
    limit: Array
    certificate: dict[str, Any] = field(default_factory=dict)
    x_offset: Array = field(default_factory=lambda: np.zeros(0))
    y_offset: Array = field(default_factory=lambda: np.zeros(0))

    def __post_init__(self) -> None:
        n, m = self.joints, 2 * self.joints**2
        before, after = self.a_pre.shape[0], self.a_post.shape[0]
        for name in ("x_offset", "y_offset"):
            if not getattr(self, name).size:
                object.__setattr__(self, name, np.zeros(m))
        shapes = {
            "a_pre": (before, before), "b_pre": (before, 2 * n), "c_pre": (m, before), "d_pre": (m, 2 * n),
            "e_pre": (m, n), "gain": (m,), "a_post": (after, after), "b_post": (after, m + 2 * n),
            "c_post": (n, after), "d_post": (n, m + 2 * n), "offset": (n,), "limit": (n, 2),
            "x_offset": (m,), "y_offset": (m,),
        }  # fmt: skip
        for name, shape in shapes.items():
            value: Array = getattr(self, name)
            if value.shape != shape:
                raise ValueError(f"{name} has the shape {value.shape}, not {shape}")
            if not (np.isfinite(value).all() or (name == "limit" and not np.isnan(value).any())):
                raise ValueError(f"{name} is not finite")

    @property
    def order(self) -> int:
        """Number of states."""
        return len(self.a_pre) + len(self.a_post)

    @property
    def poles(self) -> Complex:
        """Eigenvalues of both networks [rad/s]."""
        out: Complex = np.concatenate([np.linalg.eigvals(self.a_pre), np.linalg.eigvals(self.a_post)])
        return out.astype(complex)

    def before(self, s: ArrayLike) -> Complex:
        """Return [pot; u] -> X at the points `s` [rad/s]; shape [len(s), m, 2 n]."""
        points = np.atleast_1d(np.asarray(s, complex))
        out = rational(points, self.a_pre, self.b_pre, self.c_pre, self.d_pre)
        out[:, :, : self.joints] += points[:, None, None] * self.e_pre
        return out

    def after(self, s: ArrayLike) -> Complex:
        """Return [w; cmd; vel] -> imot at the points `s` [rad/s]; shape [len(s), n, m + 2 n]."""
        return rational(s, self.a_post, self.b_post, self.c_post, self.d_post)

    def response(self, s: ArrayLike, control_v: Array) -> Complex:
        """Return [pot; u; cmd; vel] -> imot with the gain pins held at `control_v` [m].

        The shape is [len(s), n, 4 n].
        """
        m = len(self.gain)
        after = self.after(s)
        through = after[:, :, :m] @ ((self.gain * (control_v + self.y_offset))[:, None] * self.before(s))
        return np.concatenate([through, after[:, :, m:]], axis=2)

    def arrays(self) -> dict[str, Array]:
        """Return the arrays by name."""
        return {f.name: value for f in fields(self) if isinstance(value := getattr(self, f.name), np.ndarray)}
