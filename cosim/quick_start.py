"""What lets a process of ours begin sooner: modules load without what they never use."""

import gc
import importlib.util
import sys

__all__ = ["collect_seldom", "defer"]

#: Objects between two collections of garbage, and younger collections between older ones. Modules that load
#: make half a million objects that stay; Python's own 700 look through them again and again.
_THRESHOLDS = (100_000, 50, 50)
#: Parts of numpy that `import scipy` touches by name alone, as it copies numpy's: 80 ms of import.
_UNUSED = ("f2py", "testing")


def collect_seldom() -> None:
    """Look for garbage less often from now on; for processes that are the program's own."""
    gc.set_threshold(*_THRESHOLDS)


def defer() -> None:
    """Let parts of numpy load when something of them is used (`importlib.util.LazyLoader`)."""
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
