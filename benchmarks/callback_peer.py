"""PySpice with its callbacks in Python as a peer of `work_precision`: a lockstep, slower by its language.

It closes the loop itself, as ours does, at tolerances from loose to tight; errors are against the same
reference as all others.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.rig import retold
from cosim.accuracy.pareto import Row
from cosim.accuracy.run_outcome import motion, trace_errors
from cosim.accuracy.solver_settings import Setting, reference
from cosim.accuracy.work_precision import POINTS
from cosim.caution import collected
from cosim.errors import CosimError
from cosim.ngspice.child import Child
from cosim.plan import resolve
from cosim.runner import request_of
from cosim.scene import load_scene

SERIES = "PySpice, callbacks in Python"
#: Relative tolerance, and tolerance of the coupling [rad].
SETTINGS = ((1e-2, 1e-7), (1e-4, 1e-7), (1e-5, 1e-9), (1e-6, 1e-10), (1e-7, 1e-11))


def first_reference(path: Path, overrides: Sequence[str], folder: Path) -> dict[str, Any]:
    """Return what `accuracy` kept in `folder` of the scene's first reference: 'times' [s] and 'motion'."""
    label = reference(load_scene(path, tuple(overrides))).label
    lines = (folder / POINTS).read_text(encoding="utf-8").splitlines()[1:]
    return next(point["value"] for point in map(json.loads, lines) if point["key"] == label)  # type: ignore[no-any-return]


def callback_rows(path: Path, overrides: Sequence[str], folder: Path, repeats: int) -> list[Row]:
    """Run a scene by PySpice at all settings, errors against the reference that is in `folder`."""
    truth = first_reference(path, overrides, folder)
    times = np.array(truth["times"])
    with collected(forward=False):
        plan = resolve(load_scene(path, (*overrides, "solver.model=spice")))
    constants = request_of(plan).constants
    rows = []
    with Child() as child:
        for rtol, coupling in SETTINGS:
            setting = Setting("peer", SERIES, f"{SERIES}, rtol {rtol:g}, coupling {coupling:g} rad", ())
            payload = {"plan": retold(plan, rtol=rtol, coupling_rad=coupling), "constants": constants}
            try:
                runs = [child.call("benchmarks.pyspice:run", payload) for _ in range(repeats)]
            except CosimError as error:
                rows.append(Row(setting, failed=error.in_brief))
                continue
            errors = trace_errors(motion(runs[0]["signals"], times), truth["motion"])
            wall, cpu = (tuple(float(run["stats"][clock]) for run in runs) for clock in ("wall_s", "cpu_s"))
            rows.append(Row(setting, wall, cpu, points=int(runs[0]["stats"]["points"]), errors=errors))
    return rows
