"""Measures of many devices that differ in the values of their components.

The circuit models of a batch come from one process that knows the board as designed (`Draws`); `ideal` and
`linear` runs stay there as well. A run of the model `spice`, and one with the user's Python or the noise of
components, has a deck of its own and the ordinary way.
"""

from __future__ import annotations

import gc
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from cosim.catalogue import OF_A_RUN, Need, by_need
from cosim.caution import collected
from cosim.circuits.design_constants import Stated
from cosim.circuits.draws.models import Draws
from cosim.circuits.fitting.rational_fit import FitError
from cosim.circuits.linear_circuit import LinearCircuit
from cosim.comparisons.board_measures import BoardMeasures, Lacking
from cosim.comparisons.measure_values import all_measures, check_measures
from cosim.errors import CosimError, InputError, SimulationError, StorageError, fail
from cosim.loop.linear.held_run import HeldRuns, is_compiled
from cosim.measures import why_none
from cosim.ngspice.child import Child
from cosim.ngspice.placed_values import Placed
from cosim.plan import Plan
from cosim.runner import run
from cosim.scene import Scene
from cosim.storage.staging import scratch_folder
from cosim.tolerance.applied_draw import motors, nominal, of_board, with_motors, with_numbers
from cosim.tolerance.calibration import calibrated
from cosim.tolerance.missing import Reasons, words
from cosim.types import Array
from mech.library_files import ready

__all__ = ["Batch"]

Report = Callable[[dict[str, Any]], None]

#: Samples that one call of ngspice's process answers: its time limit is that of so many runs.
_TOGETHER = 256
#: A sample that took longer than this belongs to a process that hangs [s].
_HANGS_S = 60.0
#: How a measure is refused: the device has none, or what it is taken from has no solution.
_REFUSALS = (CosimError, Lacking, FitError, np.linalg.LinAlgError, ArithmeticError)


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
        Sample of the last call -> measure -> why it has none.

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
        self.failures: dict[int, Reasons] = {}
        with_numbers(plan.scene, keys, self._nominal)
        self._motors = motors(plan, keys)
        self._placed = Placed.of(plan.board, [keys[k] for k in of_board(keys)])
        self._runs = [name for name in self.names if name in OF_A_RUN]

    def measures(self, values: Array) -> Array:
        """Return the measures of samples.

        Parameters
        ----------
        values
            (n, components), SI, in the order of the keys.

        Returns
        -------
        ndarray
            (n, measures); NaN where a sample lacks the measure: `failures` tells why.
        """
        self.failures = {}
        table = np.full((len(values), len(self.names)), np.nan)
        for start in range(0, len(values), _TOGETHER):
            self._some(start, np.asarray(values[start : start + _TOGETHER], float), table)
        return table

    def _some(self, start: int, values: Array, table: Array) -> None:
        alone = bool(self._runs) and (self._plan.model == "spice" or not is_compiled(self._plan.scene))
        self._asked(start, values, self.names, alone, table)
        for k in range(len(values) if alone else 0):
            if self._runs[0] not in self.failures.get(start + k, {}):
                self._run(start + k, values[k], table)

    def _asked(self, start: int, values: Array, names: tuple[str, ...], alone: bool, table: Array) -> None:
        """Measure samples in ngspice's process; what takes it along is found, and the rest asked again."""
        payload = {
            "plan": self._plan, "keys": self.keys, "nominal": self._nominal, "names": names, "values": values,
            "alone": alone,
        }  # fmt: skip
        try:
            rows, missing = self._call("cosim.tolerance.batch:measured", payload, len(values))
        except SimulationError as reason:
            kinds = [some for some in by_need(names).values() if some]
            if len(values) > 1:
                for k in range(len(values)):
                    self._asked(start + k, values[k : k + 1], names, alone, table)
            elif len(kinds) > 1:
                for some in kinds:
                    self._asked(start, values, some, alone, table)
            else:
                self._lacks(start, dict.fromkeys(names, words(reason)))
            return
        table[start : start + len(values), [self.names.index(name) for name in names]] = rows
        for k, reasons in missing.items():
            self._lacks(start + k, reasons)

    def _lacks(self, sample: int, reasons: Reasons) -> None:
        self.failures[sample] = {**self.failures.get(sample, {}), **reasons}

    def _run(self, sample: int, values: Array, table: Array) -> None:
        """Run one sample the ordinary way; a crash or a hang is given a second chance."""
        for chance in (False, True):
            with scratch_folder("sample") as folder, collected(forward=False):
                try:
                    plan = self.plan_of(values)
                    result = run(all_measures(plan), folder / "run", formats=(), child=self._alive())
                except StorageError:  # no device's fault
                    raise
                except (InputError, SimulationError) as reason:
                    if chance or isinstance(reason, InputError):
                        # the folder's name is another one each time
                        self._lacks(sample, dict.fromkeys(self._runs, words(reason, without=f"{folder}/")))
                        return
                    continue
            values_of = {name: float(row["value"]) for name, row in result.measures.items()}
            row, reasons = _finite(self._runs, values_of, {}, partial(why_none, plan.scene, plan.model))
            table[sample, [self.names.index(name) for name in self._runs]] = row
            if reasons:
                self._lacks(sample, reasons)
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


def _finite(
    names: Sequence[str], values: Mapping[str, float], why: Reasons, none: Callable[[str], str]
) -> tuple[list[float], dict[str, str]]:
    """Return the measures in their order, NaN where there is none, and why: as known, or as `none` says."""
    row, reasons = [], {}
    for name in names:
        value = values.get(name, math.nan)
        if not math.isfinite(value):
            unknown = f"the device's is {value}, no number" if name in values else none(name)
            if reason := why.get(name) or unknown:
                reasons[name] = reason
            value = math.nan
        row.append(value)
    return row, reasons


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


@contextmanager
def _refused(names: Sequence[str], why: dict[str, str]) -> Iterator[None]:
    """Note what is refused within as the reason why these measures are missing."""
    try:
        yield
    except StorageError:  # no device's fault
        raise
    except _REFUSALS as reason:
        why |= dict.fromkeys(names, words(reason))


def measured(payload: Mapping[str, Any], report: Report) -> tuple[Array, dict[int, Reasons]]:
    """Measure samples in ngspice's child process.

    Parameters
    ----------
    payload
        'plan': the device as designed; 'keys', 'nominal': its components; 'names': measures; 'values'
        (n, components); 'alone': runs are not made here, but who is unstable is told
    report
        called after each sample

    Returns
    -------
    tuple
        measures (n, measures), and sample -> measure -> why it has none
    """
    values, device = payload["values"], _Device(payload)
    report({"time_s": 0.0})
    table = np.full((len(values), len(payload["names"])), np.nan)
    missing: dict[int, Reasons] = {}
    for k, row in enumerate(values):
        table[k], reasons = device.measured(row.tolist())
        if reasons:
            missing[k] = reasons
        if k % _COLLECTED == 0:
            gc.collect(1)
        report({"time_s": float(k + 1)})
    return table, missing


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
        self._alone: bool = payload["alone"]
        self._draws = _draws(plan, self._keys, payload["nominal"])
        self._board, self._motors = of_board(self._keys), motors(plan, self._keys)
        by = by_need(self._names)
        self._ran, self._of_contact = by[Need.RUN], by[Need.CONTACT]
        self._still = [name for name in self._names if name not in self._ran]
        self._known: HeldRuns | None = None

    def measured(self, values: Sequence[float]) -> tuple[list[float], dict[str, str]]:
        """Return the measures of one sample, and why it lacks some: what refuses one leaves the others."""
        plan, on_board = self._plan, [values[k] for k in self._board]
        got: dict[str, float] = {}
        why: dict[str, str] = {}
        constants: Stated | None = None
        circuit: LinearCircuit | None = None
        with _refused(self._names, why):
            scene = with_numbers(plan.scene, self._keys, values)
            constants = with_motors(plan.stated(), self._motors, values, scene.joints)
        if constants is None:
            return _finite(self._names, {}, why, str)
        gains = scene.tolerance.calibration == "gains"
        if gains or self._of_contact or (self._ran and self._alone):
            with _refused([*self._of_contact, *(self._ran if gains or self._alone else ())], why):
                circuit = self._draws.at(on_board)
                constants = calibrated(constants, circuit) if gains else constants
        if self._ran and not self._alone and self._ran[0] not in why:
            with _refused(self._ran, why):
                got |= self._run(scene, constants, on_board)
        if self._still:
            # what is asked of the plan is the board's design, but for its motors
            deck = self._draws.deck(on_board)
            of = BoardMeasures(
                replace(plan, scene=scene, board=deck, _asked={"stated": constants}), _Here(), circuit
            )
            for name in self._still:
                if name not in why:
                    with _refused([name], why):
                        got[name] = float(of.row(name)["value"])
        none = partial(why_none, scene, plan.model)
        return _finite(self._names, got, why, none if not self._alone else lambda _: "")

    def _run(self, scene: Scene, constants: Stated, on_board: Sequence[float]) -> dict[str, float]:
        """Return the measures of a run."""
        from cosim.measures import standard

        small = self._draws.at(on_board, scene.solver.band_hz, scene.solver.reduction_tolerance)
        result = self._runs(scene, constants).run(small)
        rows = standard(scene, constants, result.signals, result.samples, [], result.ledger, self._ran)
        return {name: float(row["value"]) for name, row in rows.items()}

    def _runs(self, scene: Scene, constants: Stated) -> HeldRuns:
        """Return the runs of a scene; those of the sample before where it is the same."""
        if self._known is None or self._known.scene is not scene or self._known.constants is not constants:
            self._known = HeldRuns(scene, constants)
        return self._known
