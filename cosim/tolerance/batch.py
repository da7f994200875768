"""Measures of many devices that differ in the values of their components.

The circuit models of a batch come from one process that knows the board as designed (`Draws`); `ideal` and
`linear` runs stay there as well. A run of the model `spice`, and one with the user's Python or the noise of
components, has a deck of its own and the ordinary way.
"""

from __future__ import annotations

import gc
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from cosim.catalogue import MEASURES, Need
from cosim.caution import collected
from cosim.circuits.design_constants import Stated
from cosim.circuits.draws.models import Draws
from cosim.circuits.fitting.rational_fit import FitError
from cosim.comparisons.board_measures import BoardMeasures, Lacking
from cosim.comparisons.measure_values import all_measures, check_measures
from cosim.errors import CosimError, InputError, SimulationError, fail
from cosim.loop.linear.held_run import HeldRuns, is_compiled
from cosim.ngspice.child import Child
from cosim.ngspice.placed_values import Placed
from cosim.plan import Plan
from cosim.runner import run
from cosim.scene import Scene
from cosim.storage.staging import scratch_folder
from cosim.tolerance.applied_draw import motors, nominal, of_board, with_motors, with_numbers
from cosim.tolerance.calibration import calibrated
from cosim.types import Array
from mech.library_files import ready

__all__ = ["Batch"]

Report = Callable[[dict[str, Any]], None]

#: Samples that one call of ngspice's process answers: its time limit is that of so many runs.
_TOGETHER = 256
#: A sample that took longer than this belongs to a process that hangs [s].
_HANGS_S = 60.0
#: Words of the reason of a failed sample that are kept.
_MOST_WORDS = 300


class Batch:
    """Devices that differ in the values of their components.

    Parameters
    ----------
    plan
        The device as designed.
    keys
        Components: ``xdiff1.r11``, ``xdiff1.xop:tl072_gbw``, ``scene:device.chain.masses_kg[0]``.
    measures
        Names of the catalogue.
    model
        Circuit model of the runs; the plan's own by default. What needs no run is taken from the model
        `linear` where this is `spice`.
    designed
        The components' values as designed, SI; read from plan and board by default.

    Attributes
    ----------
    failures
        Sample of the last call -> why it has no measures.

    Raises
    ------
    InputError
        For unknown components and measures.
    """

    def __init__(
        self,
        plan: Plan,
        keys: Sequence[str],
        measures: Sequence[str],
        model: str | None = None,
        designed: Sequence[float] | None = None,
    ) -> None:
        check_measures(measures)
        own = [name for name in measures if ":" in name]
        if own:
            fail("a measure in Python is none of a batch", key="--measure", value=own[0])
        model = model or plan.model
        watched = plan.watched if model == "spice" else ()
        self._plan = replace(plan, model=model, watched=watched, recorded=())
        self.keys, self.names = tuple(keys), tuple(measures)
        self._nominal = [float(v) for v in designed] if designed is not None else nominal(plan, keys)
        self._child: Child | None = None
        self.failures: dict[int, str] = {}
        with_numbers(plan.scene, keys, self._nominal)
        self._motors = motors(plan, keys)
        self._placed = Placed.of(plan.board, [keys[k] for k in of_board(keys)])
        self._runs = [name for name in self.names if MEASURES[name].needs is Need.RUN]

    def measures(self, values: Array) -> Array:
        """Return the measures of samples.

        Parameters
        ----------
        values
            (n, components), SI, in the order of the keys.

        Returns
        -------
        ndarray
            (n, measures); NaN where a sample has failed, `failures` tells why, or lacks the measure.
        """
        self.failures = {}
        table = np.full((len(values), len(self.names)), np.nan)
        for start in range(0, len(values), _TOGETHER):
            self._some(start, np.asarray(values[start : start + _TOGETHER], float), table)
        return table

    def _some(self, start: int, values: Array, table: Array) -> None:
        alone = bool(self._runs) and (self._plan.model == "spice" or not is_compiled(self._plan.scene))
        names = tuple(name for name in self.names if not (alone and name in self._runs))
        payload = {
            "plan": self._plan, "keys": self.keys, "nominal": self._nominal, "names": names, "values": values,
        }  # fmt: skip
        columns = [self.names.index(name) for name in names]
        try:
            rows, failed = self._call("cosim.tolerance.batch:measured", payload, len(values))
        except SimulationError as reason:
            if len(values) == 1:
                self.failures[start] = _words(reason)
                return
            for k in range(len(values)):  # one of them has taken the process with it
                self._some(start + k, values[k : k + 1], table)
            return
        table[start : start + len(values), columns] = rows
        self.failures |= {start + k: why for k, why in failed.items()}
        if alone:
            for k in range(len(values)):
                if k not in failed:
                    self._run(start + k, values[k], table)

    def _run(self, sample: int, values: Array, table: Array) -> None:
        """Run one sample the ordinary way; a crash or a hang is given a second chance."""
        plan = self.plan_of(values)
        for chance in (False, True):
            try:
                with scratch_folder("sample") as folder, collected(forward=False):
                    result = run(all_measures(plan), folder / "run", formats=(), child=self._alive())
            except InputError as reason:
                self.failures[sample] = _words(reason)
                return
            except SimulationError as reason:
                if chance:
                    self.failures[sample] = _words(reason)
                    table[sample] = np.nan
            else:
                for name in self._runs:
                    row = result.measures.get(name)
                    table[sample, self.names.index(name)] = np.nan if row is None else float(row["value"])
                return

    def plan_of(self, values: Sequence[float] | Array) -> Plan:
        """Return the plan of one sample."""
        board = self._placed.deck([float(values[k]) for k in of_board(self.keys)])
        scene = with_numbers(self._plan.scene, self.keys, [float(value) for value in values])
        # its design is the plan's, but for the motors
        stated = with_motors(self._plan.stated(self._alive()), self._motors, values, scene.joints)
        return replace(self._plan, board=board, scene=scene, _asked={"stated": stated})

    def _call(self, target: str, payload: dict[str, Any], count: int) -> Any:
        limit = self._plan.scene.solver.time_limit_s * count
        ready()
        child = self._alive()
        self._plan.stated(child)  # the process itself asks no other
        return child.call(
            target, payload, time_limit_s=limit, stall_limit_s=_HANGS_S, deck=str(self._plan.board.path)
        )

    def _alive(self) -> Child:
        if self._child is None or not self._child.alive:
            self._child = Child(("numpy", "cosim.tolerance.batch"))
        return self._child

    def close(self) -> None:
        """End the process."""
        if self._child is not None:
            self._child.close()
            self._child = None

    def __enter__(self) -> Batch:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def _words(reason: Exception) -> str:
    return " ".join(str(reason).split())[:_MOST_WORDS]


class _Here(Child):
    """Calls answered in this very process: ngspice's own, which starts no other."""

    def __init__(self) -> None:
        self._reads = ()

    @property
    def alive(self) -> bool:
        return True

    def reads_all(self, folders: Sequence[Path]) -> bool:
        return True

    def call(self, target: str, payload: object, **_: Any) -> Any:
        from importlib import import_module

        module, _colon, name = target.partition(":")
        return getattr(import_module(module), name)(payload, lambda _: None)


@dataclass(frozen=True)
class _Known:
    """The board as designed, as a process holds it between calls."""

    name: tuple[object, ...]
    draws: Draws


_known: list[_Known] = []
#: Samples after which their garbage is taken away: a process of ours looks for it seldom (`collect_seldom`).
#: Runs leave none; measures of the board leave netlists that refer to themselves.
_COLLECTED = 8


def measured(payload: Mapping[str, Any], report: Report) -> tuple[Array, dict[int, str]]:
    """Measure samples in ngspice's child process.

    Parameters
    ----------
    payload
        'plan': the device as designed; 'keys', 'nominal': its components; 'names': measures; 'values'
        (n, components)
    report
        called after each sample

    Returns
    -------
    tuple
        measures (n, measures), and sample -> why it failed
    """
    values, device = payload["values"], _Device(payload)
    report({"time_s": 0.0})
    table = np.full((len(values), len(payload["names"])), np.nan)
    failed: dict[int, str] = {}
    for k, row in enumerate(values):
        try:
            table[k] = device.measured(row.tolist())
        except FitError as reason:
            failed[k] = _words(SimulationError(f"no `linear` model: {reason}"))
        except CosimError as reason:
            failed[k] = _words(reason)
        if k % _COLLECTED == 0:
            gc.collect(1)
        report({"time_s": float(k + 1)})
    return table, failed


def _draws(plan: Plan, keys: Sequence[str], nominal: Sequence[float]) -> Draws:
    """Return what is known of the board as designed; the process keeps the last one."""
    places = of_board(keys)
    model = "ideal" if plan.model == "ideal" else "linear"
    name = (plan.board.text, tuple(keys), tuple(nominal), model)
    if not _known or _known[0].name != name:
        board_keys, at = [keys[k] for k in places], [nominal[k] for k in places]
        _known[:] = [_Known(name, Draws(plan.board, board_keys, at, model))]
    return _known[0].draws


class _Device:
    """The device as designed, and what does not change from sample to sample; see `measured`."""

    def __init__(self, payload: Mapping[str, Any]) -> None:
        plan: Plan = payload["plan"]
        self._plan, self._keys, self._names = plan, payload["keys"], payload["names"]
        self._draws = _draws(plan, self._keys, payload["nominal"])
        self._board, self._motors = of_board(self._keys), motors(plan, self._keys)
        self._ran = [name for name in self._names if MEASURES[name].needs is Need.RUN]
        self._known: HeldRuns | None = None

    def measured(self, values: Sequence[float]) -> list[float]:
        """Return the measures of one sample."""
        plan, draws = self._plan, self._draws
        scene = with_numbers(plan.scene, self._keys, values)
        on_board = [values[k] for k in self._board]
        gains, still = scene.tolerance.calibration == "gains", len(self._ran) < len(self._names)
        # of a run on `spice` too: who is unstable is told; a run here has its own, smaller one
        circuit = draws.at(on_board) if gains or still or not self._ran else None
        constants = with_motors(plan.stated(), self._motors, values, scene.joints)
        if gains:
            assert circuit is not None
            constants = calibrated(constants, circuit)
        values_of: dict[str, float] = {}
        if self._ran:
            from cosim.measures import standard

            small = draws.at(on_board, scene.solver.band_hz, scene.solver.reduction_tolerance)
            result = self._runs(scene, constants).run(small)
            rows = standard(scene, constants, result.signals, result.samples, [], result.ledger, self._ran)
            values_of |= {name: float(row["value"]) for name, row in rows.items()}
        if still:
            # what is asked of the plan is the board's design, but for its motors
            drawn = replace(plan, scene=scene, board=draws.deck(on_board), _asked={"stated": constants})
            of = BoardMeasures(drawn, _Here(), circuit)
            for name in self._names:
                if name not in self._ran:
                    try:
                        values_of[name] = float(of.row(name)["value"])
                    except Lacking:
                        values_of[name] = np.nan
        return [values_of.get(name, np.nan) for name in self._names]

    def _runs(self, scene: Scene, constants: Stated) -> HeldRuns:
        """Return the runs of a scene; those of the sample before where it is the same."""
        if self._known is None or self._known.scene is not scene or self._known.constants is not constants:
            self._known = HeldRuns(scene, constants)
        return self._known
