"""Messages from a child, treated as untrusted data: a pickle can call anything, so only known types pass.

A child that was taken over must not reach its parent, which is not in a sandbox.
"""

import io
import pickle
from enum import Enum
from typing import Any

from cosim.errors import SimulationError

__all__ = ["read", "written"]

_PACKAGES = ("cosim", "mech")
_PLAIN = frozenset(
    {("cosim.errors", "_rebuild")}  # how an error with keywords is made again
    | {("builtins", name) for name in ("set", "frozenset", "complex", "bytearray", "slice", "range")}
    | {("collections", name) for name in ("OrderedDict", "deque")}
    | {("pathlib", name) for name in ("Path", "PosixPath", "WindowsPath", "PurePosixPath")}
    | {("pathlib._local", name) for name in ("Path", "PosixPath", "WindowsPath")}
    | {("numpy", "ndarray"), ("numpy", "dtype"), ("types", "SimpleNamespace")}
    | {
        (f"numpy.{core}.{module}", name)
        for core in ("_core", "core")
        for module, name in (
            ("multiarray", "_reconstruct"),
            ("multiarray", "scalar"),
            ("numeric", "_frombuffer"),
        )
    }
)


class _Writer(pickle.Pickler):
    """Names a member of an enumeration by its value: some releases of Python 3.11 name it by `getattr`."""

    def reducer_override(self, obj: Any) -> Any:
        """Return how an object is made again."""
        return (type(obj), (obj.value,)) if isinstance(obj, Enum) else NotImplemented


def written(message: Any) -> bytes:
    """Return the bytes of a message.

    Raises
    ------
    pickle.PicklingError
        For anything but data, such as a function.
    """
    body = io.BytesIO()
    try:
        _Writer(body, protocol=5).dump(message)
    except (AttributeError, TypeError) as error:  # which of them differs between releases of Python
        raise pickle.PicklingError(f"it does not pickle: {error}") from error
    return body.getvalue()


class _Reader(pickle.Unpickler):
    """Makes classes of our packages, arrays and containers; nothing else."""

    def find_class(self, module: str, name: str) -> Any:
        """Return a type that a message may hold."""
        if (module, name) in _PLAIN:
            return super().find_class(module, name)
        if module.partition(".")[0] in _PACKAGES:
            kind = super().find_class(module, name)
            if isinstance(kind, type) and kind.__module__ == module and "." not in name:
                return kind
        raise pickle.UnpicklingError(f"{module}.{name}")


def read(body: bytes) -> Any:
    """Return a message.

    Raises
    ------
    SimulationError
        When it holds a type that no message has.
    """
    try:
        return _Reader(io.BytesIO(body)).load()
    except pickle.UnpicklingError as error:
        raise SimulationError(f"the child process sent what it may not send ({error})") from None
