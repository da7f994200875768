"""A control law of the user's own: a Python class in a file, called once per sample.

The class has one method, `control(sample) -> Command`; everything around it (encoders, DACs, delay, skew)
stays as the scene says. It runs in the simulation's process and is trusted as any Python file is.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cosim.circuits.design_constants import DesignConstants
from cosim.loop.userclass import PrintCapture, in_users_words, load_class
from cosim.scene import Scene
from mech.addresses import address_of
from mech.kernels import jacobian, tip
from mech.records import NMAX


@dataclass(frozen=True)
class Sample:
    """What the computer knows at a sample.

    Attributes
    ----------
    tick, time_s : number and time of the sample
    q_rad, v_rad_per_s : [n] encoder angles and their difference quotient
    tip_m : [2] fingertip at `q_rad`; jacobian : [2, n] m/rad
    wall_point_m, wall_normal : [2] the wall of the scene
    scene : all that the scene states, such as ``sample.scene.computer.period_s``
    board : the board's design constants, such as ``sample.board.k_fs``

    Examples
    --------
    A law that pushes the tip out of the wall with 100 N/m.

    >>> class Law:
    ...     def control(self, sample: Sample) -> Command:
    ...         depth = (sample.wall_point_m - sample.tip_m) @ sample.wall_normal
    ...         force = 100.0 * max(depth, 0.0) * sample.wall_normal
    ...         return Command(torque_n_m=sample.jacobian.T @ force)
    >>> here = Sample(0, 0.0, *(np.zeros(1),) * 2, np.array([-0.01, 0.0]), np.array([[1.0], [0.0]]),
    ...               np.zeros(2), np.array([1.0, 0.0]), scene=None, board=None)
    >>> Law().control(here).torque_n_m.tolist()  # N m
    [1.0]
    """

    tick: int
    time_s: float
    q_rad: NDArray[np.float64]
    v_rad_per_s: NDArray[np.float64]
    tip_m: NDArray[np.float64]
    jacobian: NDArray[np.float64]
    wall_point_m: NDArray[np.float64]
    wall_normal: NDArray[np.float64]
    scene: Scene
    board: DesignConstants


@dataclass(frozen=True)
class Command:
    """What the computer asks of the board; what is left out is zero (`u_rad`: the present pose).

    Attributes
    ----------
    u_rad : [n] equilibria; stiffness, damping : [n, n] N m/rad and N m s/rad, row = motor, column = joint
    torque_n_m : [n] direct command at the joints

    Examples
    --------
    >>> Command(torque_n_m=[0.01, 0.0]).stiffness  # what is left out is zero
    0.0
    """

    u_rad: ArrayLike | None = None
    stiffness: ArrayLike = field(default=0.0)
    damping: ArrayLike = field(default=0.0)
    torque_n_m: ArrayLike = field(default=0.0)


def load_law(where: str, scene: Path | None, printed: PrintCapture | None = None) -> Any:
    """Make one object of the class `file.py:Class`, the file relative to the scene.

    Raises
    ------
    InputError
        When the file or the class is missing, cannot be made, or has no method `control`.
    """
    return load_class(
        where,
        scene,
        key="computer.law",
        what="a control law",
        method="control(sample)",
        printed=PrintCapture() if printed is None else printed,
    )


class UserLaw:
    """Bridge from compiled code to the user's `control`.

    Parameters
    ----------
    law : object with `control(sample) -> Command`
    state : the `STATE` record that compiled code works on
    failed : called with what went wrong; must stop the run
    where : how errors call it, 'file.py:Class'
    scene, board : the scene and the board's constants, as the law sees them
    printed : captures what the law prints
    """

    def __init__(
        self,
        law: Any,
        state: np.void,
        failed: Callable[[BaseException], None],
        where: str,
        scene: Scene,
        board: DesignConstants,
        printed: PrintCapture,
    ) -> None:
        self.law, self.state, self.failed, self.where = law, state, failed, where
        self.scene, self.board, self.printed = scene, board, printed
        self.callback = ctypes.CFUNCTYPE(None)(self._sample)
        self.address = address_of(self.callback)

    def _sample(self) -> None:
        try:
            self._control()
        except BaseException as error:  # ctypes would print the exception and go on
            self.failed(in_users_words(self.where, error, float(self.state["x"]["time"]), self.printed))

    def _control(self) -> None:
        n = int(self.state["n"])
        c, x, p = self.state["c"], self.state["x"], self.state["known"]
        q = x["q"][:n].copy()
        r, jac = np.zeros(2), np.zeros((2, NMAX))
        padded = np.zeros(NMAX)
        padded[:n] = q
        tip(p, padded, r)
        jacobian(p, padded, jac)
        pen = float(c["normal"] @ (c["point"] - r))
        sample = Sample(
            tick=int(x["tick"]),
            time_s=float(x["time"]),
            q_rad=q,
            v_rad_per_s=x["v"][:n].copy(),
            tip_m=r.copy(),
            jacobian=jac[:, :n].copy(),
            wall_point_m=c["point"].copy(),
            wall_normal=c["normal"].copy(),
            scene=self.scene,
            board=self.board,
        )
        with self.printed.listening():
            command = self.law.control(sample)
        if not isinstance(command, Command):
            raise TypeError(f"control(sample) returned {command!r} and no cosim.loop.userlaw.Command")
        x["r"], x["pen"], x["contact"] = r, pen, int(pen > 0)
        x["u"][:n] = _checked("u_rad", q if command.u_rad is None else command.u_rad, (n,), sample)
        x["cmd"][:n] = _checked("torque_n_m", command.torque_n_m, (n,), sample)
        x["ksp"][:n, :n] = _checked("stiffness", command.stiffness, (n, n), sample)
        x["ksd"][:n, :n] = _checked("damping", command.damping, (n, n), sample)


def _checked(what: str, given: ArrayLike, shape: tuple[int, ...], sample: Sample) -> NDArray[np.float64]:
    try:
        value = np.broadcast_to(np.asarray(given, dtype=float), shape)
    except ValueError:
        raise ValueError(f"the control law's {what} must fit the shape {shape}: {given!r}") from None
    if not np.isfinite(value).all():
        raise ValueError(f"the control law's {what} is not finite at sample {sample.tick}: {value.tolist()}")
    return value
