"""What is needed to repeat a run: versions, seed, command, date, digests."""

import functools
import hashlib
import json
import os
import platform
import re
import sys
import time
from collections.abc import Sequence
from datetime import UTC, datetime
from typing import Any

import cosim
from cosim.scene import Scene

__all__ = ["effects_digest", "packages", "provenance", "run_date"]


def provenance(
    scene: Scene, *, command: Sequence[str] | None = None, ngspice: str | None = None, **more: Any
) -> dict[str, Any]:
    """Return what is needed to repeat a run: versions, seed, command, scene file and its digest.

    Parameters
    ----------
    scene
        The scene that ran.
    command
        Command line; by default that of this process.
    ngspice
        Version of the library, as it states it.
    more
        Further entries, for example the digest of the netlist.
    """
    return {
        "versions": {
            "cosim": cosim.__version__,
            "python": platform.python_version(),
            "ngspice": ngspice,
            **packages(),
        },
        "platform": platform.platform(),
        "date": datetime.fromtimestamp(run_date(), UTC).isoformat(timespec="seconds"),
        "command": list(sys.argv if command is None else command),
        "seed": scene.seed,
        "scene_file": scene.file_name,
        "scene_digest": scene.digest(),
        "effects_digest": effects_digest(scene),
        **more,
    }


@functools.cache
def packages() -> dict[str, str | None]:
    """Return the versions of the packages that matter to a result."""
    names = ("numpy", "scipy", "numba", "PySpice", "pydantic")
    return {name: _version(name) for name in names}


def run_date() -> float:
    """Return the time [s since 1970], or SOURCE_DATE_EPOCH where it is set, for reproducible bytes."""
    fixed = os.environ.get("SOURCE_DATE_EPOCH", "")
    return float(fixed) if fixed.isdigit() else time.time()


def effects_digest(scene: Scene) -> str:
    """Return the SHA-256 of the list of effects, set ones and unset ones."""
    settings = scene.effects.model_dump(mode="json")
    return hashlib.sha256(json.dumps(settings, sort_keys=True).encode()).hexdigest()


def _version(package: str) -> str | None:
    from importlib.metadata import PackageNotFoundError, distribution  # a run has time for it while it waits

    try:
        found = distribution(package)
    except PackageNotFoundError:
        return None
    text = found.read_text("METADATA") or found.read_text("PKG-INFO") or ""
    # the file is a mail with licences and a whole README in it: one line of its head is asked for
    stated = re.search(r"^Version:[ \t]*(\S+)", text.partition("\n\n")[0], re.MULTILINE)
    return stated[1] if stated else None
