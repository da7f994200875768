"""Faster start of our processes: modules load without parts that are never used."""

import gc
import importlib.util
import os
import sys

__all__ = ["FRUGAL", "collect_seldom", "defer", "frugal"]

#: What keeps libraries from preparing for what we do not do, in the environment from before they load:
#: OpenBLAS from threads, which spin while our small matrices use one, pydantic from a search for plug-ins.
FRUGAL = {"OPENBLAS_NUM_THREADS": "1", "PYDANTIC_DISABLE_PLUGINS": "__all__"}

#: Objects between two collections of garbage, and younger collections between older ones. Modules that load
#: make half a million objects that stay; Python's own 700 look through them again and again.
_THRESHOLDS = (100_000, 50, 50)
#: Parts of numpy that `import scipy` touches by name alone, as it copies numpy's: 80 ms of import.
_UNUSED = ("f2py", "testing")


def collect_seldom() -> None:
    """Collect garbage less often from now on; only for processes of our own."""
    gc.set_threshold(*_THRESHOLDS)


def frugal() -> None:
    """Put `FRUGAL` into the environment, where the user has not decided; only for processes of our own."""
    for name, value in FRUGAL.items():
        os.environ.setdefault(name, value)


def defer() -> None:
    """Load parts of numpy on first use (`importlib.util.LazyLoader`)."""
    import numpy as np

    for part in _UNUSED:
        name = f"numpy.{part}"
        spec = None if name in sys.modules else importlib.util.find_spec(name)
        if spec is None or spec.loader is None:
            continue
        spec.loader = importlib.util.LazyLoader(spec.loader)
        module = importlib.util.module_from_spec(spec)
        sys.modules[name] = module
        spec.loader.exec_module(module)
        setattr(np, part, module)
