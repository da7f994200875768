"""``cosim --version --verbose``: versions, and how far a child process is confined on this system."""

import platform
from collections.abc import Callable
from importlib.metadata import version
from typing import Any

__all__ = ["about", "seen_inside"]

_LIBRARIES = ("numpy", "scipy", "numba", "PySpice")


def about() -> str:
    """Return the text, from a child process started as for a run.

    Raises
    ------
    CosimError
        Where no child runs: no ngspice, for example.
    """
    from cosim import __version__
    from cosim.ngspice.child import call

    ngspice, sandbox = call("cosim.commands.version_info:seen_inside", None, time_limit_s=60.0)
    rows = {
        "cosim": __version__,
        "Python": f"{platform.python_version()} on {platform.platform()}",
        **{name: version(name) for name in _LIBRARIES},
        "ngspice": ngspice,
        "sandbox": sandbox,
    }
    return "\n".join(f"{name:<8} {value}" for name, value in rows.items())


def seen_inside(payload: None, report: Callable[[dict[str, Any]], None]) -> tuple[str, str]:
    """Return ngspice's version and the sandbox's state; runs in the child."""
    from cosim.ngspice.sandbox import applied
    from cosim.ngspice.simulator import Simulator

    return str(Simulator().version), str(applied())
