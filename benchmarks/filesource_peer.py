"""Plain ngspice with XSPICE's `filesource` for the DACs as a peer of `work_precision`: drawn, not gated.

The deck that `cosim export` writes, linkage included, given the DACs' voltages of a tight run; only how they
enter differs: a row of a file in place of a table in an expression. XSPICE's code models must be there.
"""

from __future__ import annotations

import itertools
import re
import tempfile
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.callback_peer import first_reference
from benchmarks.rig import bare_run, tight
from cosim.accuracy.pareto import Row
from cosim.accuracy.run_outcome import AXES, motion, trace_errors
from cosim.accuracy.solver_settings import Setting
from cosim.caution import collected
from cosim.circuits.decks import Tolerances
from cosim.errors import CosimError
from cosim.export.scene_deck import deck_lines
from cosim.ngspice.child import Child
from cosim.ngspice.simulator import Simulator
from cosim.plan import resolve
from cosim.runner import run
from cosim.scene import load_scene
from cosim.storage.staging import scratch_folder

SERIES = "ngspice alone, filesource"
METHODS, RELATIVE = ("trap", "gear"), (1e-2, 1e-3, 1e-4, 1e-5, 1e-6, 1e-7)
#: A DAC as the export writes it, in the deck's own words.
_TABLE = re.compile(r"B(\w+) \1 0 v=pwl\(time,(.*)\)")


def filesource_rows(path: Path, overrides: Sequence[str], folder: Path, repeats: int) -> list[Row]:
    """Run a scene's deck at all settings, errors against the reference that is in `folder`."""
    truth = first_reference(path, overrides, folder)
    with collected(forward=False), scratch_folder("filesource") as place, Child() as child:
        plan = resolve(load_scene(path, (*overrides, "solver.model=spice")))
        recorded = run(tight(plan), place / "run", formats=(), child=child)
        decks = {
            f"{method}, rtol {rtol:g}": deck_lines(
                replace(plan, tolerances=Tolerances(rtol, method, plan.tolerances.charge_c)), recorded
            )
            for method, rtol in itertools.product(METHODS, RELATIVE)
        }
    payload = {"decks": decks, "channels": plan.circuit.channels, "repeats": repeats}
    with Child() as child:
        made = child.call("benchmarks.filesource_peer:timed", {**payload, "times": np.array(truth["times"])})
    rows = []
    for label, got in made.items():
        setting = Setting("peer", SERIES, f"{SERIES}, {label}", ())
        if "failed" in got:
            rows.append(Row(setting, failed=got["failed"]))
            continue
        errors = trace_errors(got["motion"], truth["motion"])
        rows.append(Row(setting, got["wall_s"], got["cpu_s"], points=got["points"], errors=errors))
    return rows


def with_filesource(lines: Sequence[str], channels: Sequence[str], file: Path) -> list[str]:
    """Return an exported deck whose DACs come from `file`, which is written."""
    tables = {}
    for line in lines:
        found = _TABLE.fullmatch(line)
        if found and found[1] in channels:
            tables[found[1]] = np.array(found[2].split(","), float).reshape(-1, 2)
    rest = [line for line in lines if not ((found := _TABLE.fullmatch(line)) and found[1] in tables)]
    if not tables:
        return rest
    instants = np.unique(np.concatenate([[0.0], *(table[:, 0] for table in tables.values())]))
    volts = [np.interp(instants, *table.T) for table in tables.values()]
    instants[-1] += 1e6  # behind its last row a filesource is 0; the last corner is beyond the run
    np.savetxt(file, np.column_stack([instants[instants >= 0.0], *(v[instants >= 0.0] for v in volts)]))
    each = len(tables)
    source = [
        f"Adacs [{' '.join(f'%vd({name},0)' for name in tables)}] dacs",
        f'.model dacs filesource(file="{file}" amploffset=[{" ".join(["0"] * each)}] '
        f"amplscale=[{' '.join(['1'] * each)}] timeoffset=0 timescale=1 timerelative=false amplstep=false)",
    ]
    return [*rest[:-1], *source, rest[-1]]


def timed(payload: dict[str, Any], report: Any) -> dict[str, Any]:
    """Run the decks, in ngspice's process: label -> motion, times [s] and points, or why it failed."""
    begun, made = [0.0], {}

    def loaded(simulator: Simulator) -> None:
        begun[0] = time.process_time()

    with tempfile.TemporaryDirectory(prefix="cosim-bench-") as name:
        for label, deck in payload["decks"].items():
            lines = with_filesource(deck, payload["channels"], Path(name) / "dacs.txt")
            command = next(line for line in lines if line.startswith(".tran"))[1:]
            text = "\n".join(line for line in lines if not line.startswith((".tran", ".meas"))) + "\n"
            walls, cpu = [], []
            try:
                for _ in range(payload["repeats"]):
                    wall, simulator = bare_run(text, command, prepare=loaded, trusted=True)
                    walls.append(wall)
                    cpu.append(time.process_time() - begun[0])
            except CosimError as error:
                made[label] = {"failed": error.in_brief}
                continue
            names = ("time", *(axis for axis in AXES if axis in simulator.vector_names()))
            signals = {axis: np.real(simulator.vector(axis)) for axis in names}
            made[label] = {
                "motion": motion(signals, payload["times"]), "wall_s": tuple(walls), "cpu_s": tuple(cpu),
                "points": len(signals["time"]),
            }  # fmt: skip
            report({"time_s": float(len(made))})
    return made
