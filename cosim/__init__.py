"""Circuit-level co-simulation of haptic devices.

The names of the front door load what they need when they are first used: `load_scene`, `Scene`, `resolve`,
`Plan`, `run`, `Run`, `sweep`, `compare`, `monte_carlo`, `study`, `stability`, `noise`, `device`, `check`,
`Sample`, `Command`, and the errors.

Examples
--------
>>> import cosim
>>> from cosim.assets import scenes_folder
>>> scene = cosim.load_scene(scenes_folder() / "press.toml")
>>> cosim.stability(scene.with_values({"computer.period_s": 0.001})).stability.stable
True
"""

import importlib
from typing import Any

__version__ = "0.2.0"

#: Public names, and the module that each comes from; types stand in `__init__.pyi`.
_PUBLIC = {
    **dict.fromkeys(("run", "sweep", "compare"), "cosim.api.simulation"),
    **dict.fromkeys(("monte_carlo", "study"), "cosim.api.batches"),
    **dict.fromkeys(("stability", "noise", "device", "check"), "cosim.api.queries"),
    **dict.fromkeys(("Plan", "resolve"), "cosim.plan"),
    **dict.fromkeys(("Scene", "load_scene"), "cosim.scene"),
    **dict.fromkeys(("Command", "Sample"), "cosim.loop.userlaw"),
    **dict.fromkeys(("CosimError", "InputError", "SimulationError", "StorageError"), "cosim.errors"),
    "Run": "cosim.results",
}

__all__ = [
    "Command", "CosimError", "InputError", "Plan", "Run", "Sample", "Scene", "SimulationError",
    "StorageError", "check", "compare", "device", "errors", "load_scene", "monte_carlo", "noise",
    "resolve", "run", "stability", "study", "sweep",
]  # fmt: skip


def __getattr__(name: str) -> Any:
    """Load a public name on its first use."""
    if name == "errors":
        return importlib.import_module("cosim.errors")
    if name not in _PUBLIC:
        raise AttributeError(f"module 'cosim' has no attribute {name!r}")
    value = getattr(importlib.import_module(_PUBLIC[name]), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    """Return the names that are there, and those that would be loaded."""
    return sorted({*globals(), *__all__})
