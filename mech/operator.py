"""Who holds the fingertip: nobody, a point mass, a hand, or a class of the user's own.

An operator packs itself into a record (`mech.records.OPERATOR`) that the compiled kernels work on. The
first three run compiled; a user's class is called back from the kernel at every evaluation, which costs
some microseconds instead of nanoseconds (`compiled` says which).
"""

import ctypes
import inspect
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import Any, final

import numpy as np

from mech.addresses import address_of
from mech.parameter_checks import Checker, ParameterError, Refusal
from mech.records import KNOTS, OPERATOR, OperatorKind
from mech.userfile import load_file

__all__ = ["Hand", "NoOperator", "Operator", "PointMass", "UserOperator", "load_user"]

Rows = Sequence[Sequence[float]]


class Operator(ABC):
    """What acts on the fingertip with a force that depends on time, position and velocity."""

    compiled: bool = True
    """False when the kernels have to call Python back."""

    mass_kg: float = 0.0
    """Mass that moves with the fingertip."""

    @abstractmethod
    def pack(self) -> np.ndarray[Any, Any]:
        """Return a record for the kernels, shape (1,), dtype `OPERATOR`."""

    @property
    def knots_s(self) -> tuple[float, ...]:
        """Times at which the force has a kink: a step of an integrator should not straddle them."""
        return ()

    def listen(self, listening: Callable[[], AbstractContextManager[None]]) -> None:  # noqa: B027
        """Call the operator's own code inside of this context from now on; it may print."""

    def raise_pending(self) -> None:  # noqa: B027  (only an operator in Python can have failed)
        """Raise what went wrong in the operator's own code since the last call."""


@final
@dataclass(frozen=True)
class NoOperator(Operator):
    """A free fingertip."""

    def pack(self) -> np.ndarray[Any, Any]:
        """Return a record for the kernels, shape (1,), dtype `OPERATOR`."""
        return np.zeros(1, OPERATOR)


@final
@dataclass(frozen=True, kw_only=True)
class PointMass(Operator):
    """A mass fixed to the fingertip (the paper's Fig. 12); the linkage's gravity pulls it."""

    mass_kg: float

    def __post_init__(self) -> None:
        check = Checker()
        check.number("mass_kg", self.mass_kg, least=0.0)
        check.done()

    def pack(self) -> np.ndarray[Any, Any]:
        """Return a record for the kernels, shape (1,), dtype `OPERATOR`."""
        record = np.zeros(1, OPERATOR)
        record["kind"], record["mass"], record["falls"] = OperatorKind.MASS, self.mass_kg, 1.0
        return record


@final
@dataclass(frozen=True, kw_only=True)
class Hand(Operator):
    """A hand as mass, damper and spring about an intended path, with an intended force.

    Force on the device: k (r_i(t) - r) + b (r_i'(t) - r') + f_i(t) - m r''. The arm carries its own
    weight. Default values: a published fit of a human arm.

    Parameters
    ----------
    mass_kg, damping_n_s_per_m, stiffness_n_per_m
        Of the arm at the fingertip.
    waypoints_s_m
        Rows (t, x, y), at most 256: intended points, minimum jerk between them, at rest in each. The
        hand waits in the first before its time, and in the last after it. Needed with a stiffness.
    force_s_n
        Rows (t, fx, fy), at most 256: intended force, linear between rows, constant beyond.

    Raises
    ------
    ParameterError
        With every refused parameter.
    """

    mass_kg: float = 0.554
    damping_n_s_per_m: float = 6.45
    stiffness_n_per_m: float = 135.0
    waypoints_s_m: Rows = ()
    force_s_n: Rows = ()

    def __post_init__(self) -> None:
        check = Checker()
        for name in ("mass_kg", "damping_n_s_per_m", "stiffness_n_per_m"):
            check.number(name, getattr(self, name), least=0.0)
        for name, columns in (("waypoints_s_m", "t, x, y"), ("force_s_n", "t, fx, fy")):
            object.__setattr__(self, name, check.table(name, getattr(self, name), columns, KNOTS))
        check.done()
        if self.stiffness_n_per_m > 0.0 and not self.waypoints_s_m:
            check.refuse("waypoints_s_m", [], "at least one row (t, x, y) for the hand's spring to pull to")
        check.done()

    @property
    def knots_s(self) -> tuple[float, ...]:
        """Times of the tables' rows [s]: the force is smooth between them."""
        return tuple(sorted({row[0] for row in (*self.waypoints_s_m, *self.force_s_n)}))

    def pack(self) -> np.ndarray[Any, Any]:
        """Return a record for the kernels, shape (1,), dtype `OPERATOR`."""
        record = np.zeros(1, OPERATOR)
        op = record[0]
        op["kind"] = OperatorKind.HAND
        op["mass"], op["damping"] = self.mass_kg, self.damping_n_s_per_m
        op["stiffness"] = self.stiffness_n_per_m
        for rows, table, count in (
            (self.waypoints_s_m, "path", "paths"),
            (self.force_s_n, "force", "forces"),
        ):
            op[count] = len(rows)
            if rows:
                op[table][: len(rows)] = rows
        return record


_PROTOTYPE = ctypes.CFUNCTYPE(None, *[ctypes.c_double] * 5, ctypes.POINTER(ctypes.c_double))


@final
class UserOperator(Operator):
    """A user's object with ``force(t, r, v) -> (fx, fy)`` [N], called back from the kernels.

    `force` gets time [s], fingertip position [m] and velocity [m/s] as arrays of shape (2,), and is also
    asked at trial times that are later rejected, so it must depend on its arguments only. An attribute
    `mass_kg` adds a mass to the fingertip. An exception, or a result that is not two finite numbers, turns
    the kernels' results into NaN and is raised by `raise_pending`.

    Parameters
    ----------
    target
        The user's object.
    name
        How errors call it.

    Notes
    -----
    The packed record holds the address of a callback that lives as long as this object.
    """

    compiled = False

    def __init__(self, target: Any, name: str) -> None:
        self.name = name
        self._target = target
        self._error: BaseException | None = None
        self._listening: Callable[[], AbstractContextManager[None]] = nullcontext
        check = Checker()
        self.mass_kg = check.number(f"{name}: mass_kg", getattr(target, "mass_kg", 0.0), least=0.0)
        check.done()
        self._callback = _PROTOTYPE(self._called)

    def pack(self) -> np.ndarray[Any, Any]:
        """Return a record for the kernels, shape (1,), dtype `OPERATOR`."""
        record = np.zeros(1, OPERATOR)
        record["kind"], record["mass"] = OperatorKind.USER, self.mass_kg
        record["callback"] = address_of(self._callback)
        return record

    def listen(self, listening: Callable[[], AbstractContextManager[None]]) -> None:
        """Call the user's code inside of this context from now on; it may print."""
        self._listening = listening

    def raise_pending(self) -> None:
        """Raise what went wrong in the user's code since the last call."""
        error, self._error = self._error, None
        if error is not None:
            raise error

    def _called(self, t: float, x: float, y: float, vx: float, vy: float, force: Any) -> None:
        # An exception must not cross the C frames above: ctypes would print and lose it.
        force[0] = force[1] = float("nan")
        if self._error is not None:
            return
        where = f"{self.name}.force(t={t:.9g}, r=({x:.6g}, {y:.6g}), v=({vx:.6g}, {vy:.6g}))"
        try:
            with self._listening():
                answer = self._target.force(t, np.array((x, y)), np.array((vx, vy)))
        except Exception as error:
            self._error = RuntimeError(f"{where} raised {type(error).__name__}: {error}")
            self._error.__cause__ = error
            return
        except BaseException as error:  # Ctrl-C
            self._error = error
            return
        try:
            fx, fy = (float(item) for item in answer)
            if not (np.isfinite(fx) and np.isfinite(fy)):
                raise ValueError
        except (TypeError, ValueError):
            self._error = ParameterError([Refusal(where, answer, "two finite numbers (fx, fy) in N")])
            return
        force[0], force[1] = fx, fy


def load_user(spec: str, folder: str | Path = ".") -> UserOperator:
    """Load a user's operator class from a file and make one.

    Parameters
    ----------
    spec
        ``"file.py:Class"``; the class is called without arguments.
    folder
        That a relative path starts from.

    Raises
    ------
    ParameterError
        No such file, class or method, or the file or the class's start raises; the message says which.
    """

    def refused(allowed: str, cause: BaseException | None = None) -> ParameterError:
        error = ParameterError([Refusal("operator file", spec, allowed)])
        error.__cause__ = cause
        return error

    file, colon, name = spec.rpartition(":")
    if not (colon and file and name.isidentifier()):
        raise refused("of the form 'file.py:Class'")
    path = (Path(folder) / file).resolve()
    if not path.is_file():
        raise refused(f"an existing file; there is no {path}")
    if path.suffix != ".py":
        raise refused("a Python file, '.py'")
    try:
        module = load_file(path)
    except (Exception, SystemExit) as error:
        raise refused(f"loadable; it raised {type(error).__name__}: {error}", error) from error
    kind: Any = getattr(module, name, None)
    if not isinstance(kind, type):
        classes = [
            k for k, v in vars(module).items() if inspect.isclass(v) and v.__module__ == module.__name__
        ]
        raise refused(f"the name of a class in that file; it has {', '.join(classes) or 'none'}")
    if not callable(getattr(kind, "force", None)):
        raise refused("a class with a method force(self, t, r, v) -> (fx, fy)")
    try:
        target: Any = kind()
    except (Exception, SystemExit) as error:
        raise refused(f"a class that starts without arguments; {name}() raised {error!r}", error) from error
    try:
        inspect.signature(target.force).bind(0.0, None, None)
    except TypeError as error:
        raise refused(f"a class with a method force(self, t, r, v); {error}", error) from error
    return UserOperator(target, f"{path.name}:{name}")
