"""Hard cases, and the runner of their scenes."""

from __future__ import annotations

import json
import math
import shutil
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from cosim.accuracy.estimate import estimator
from cosim.assets import netlists_folder
from cosim.caution import collected
from cosim.errors import CosimError
from cosim.ngspice.child import Child, call, start_early
from cosim.plan import resolve
from cosim.runner import run
from cosim.scene import load_scene
from cosim.storage.staging import scratch_folder
from cosim.types import Array
from mech.library_files import ready

__all__ = [
    "ALL",
    "OWN",
    "RADIUS",
    "CaseRunner",
    "HardCase",
    "Outcome",
    "Ran",
    "board",
    "crossings",
    "merge",
    "slider",
]

Tables = Mapping[str, Any]

#: Circuit models: every one, and those of our own loop.
ALL, OWN = ("ideal", "linear", "spice"), ("ideal", "linear")
#: Radius of the carriage's drum [m].
RADIUS = 0.1333


#: Longest call of a case [s]: those marked slow take minutes on a busy machine.
_LIMIT_S = 600.0


@dataclass(frozen=True)
class HardCase:
    """A scene whose answer theory knows.

    Attributes
    ----------
    name : of the case; several cases of one kind differ behind the comma
    row : number in the project's list of hard cases
    what : quantity that is computed, with its unit
    expected : from theory, in that unit
    bound : model -> largest difference from it, in that unit; the models it runs on
    reason : where the bound comes from
    find : computes it, by a runner, on a model
    slow : whether it takes more than some seconds
    broken : a change of the program that made it miss when it was tried
    """

    name: str
    row: int
    what: str
    expected: float
    bound: Mapping[str, float]
    reason: str
    find: Callable[[CaseRunner, str], float]
    slow: bool = False
    broken: str = ""


@dataclass(frozen=True)
class Outcome:
    """Outcome of a case on one model.

    Attributes
    ----------
    case, model : what ran
    got : value computed; None where it failed
    failed : the error, in words
    seconds : wall time
    """

    case: HardCase
    model: str
    got: float | None
    failed: str
    seconds: float

    @property
    def number(self) -> bool:
        """Whether the value computed is a number."""
        return self.got is not None and math.isfinite(self.got)

    @property
    def held(self) -> bool:
        """Whether the answer is right; NaN is wrong."""
        return self.got is not None and abs(self.got - self.case.expected) <= self.case.bound[self.model]

    def written(self, value: float) -> str:
        """Return a value, expected or got, to the digit of the bound, to nine digits at least."""
        bound = self.case.bound[self.model]
        apart = abs(self.case.expected) / bound if bound else 0.0
        return f"{value:.{min(max(9, math.ceil(math.log10(apart)) + 1 if apart else 0), 15)}g}"


@dataclass(frozen=True)
class Ran:
    """Results of a run: signals and samples by name; measures and stats as in `cosim.results.Run`.

    `warnings` are those of the run, as (code, text).
    """

    signals: Mapping[str, Array]
    samples: Mapping[str, Array]
    measures: Mapping[str, Mapping[str, Any]]
    stats: Mapping[str, Any]
    warnings: tuple[tuple[str, str], ...] = ()


class CaseRunner:
    """Runs scenes in a process of its own, which may read the folder of their laws; nothing is kept."""

    def __init__(self) -> None:
        self._place = scratch_folder("hard-cases")
        self._folder = self._place.__enter__()
        self._child = self._started()

    def _started(self) -> Child:
        return start_early("cosim.loop.early_imports", reads=[self._folder])

    def __enter__(self) -> CaseRunner:
        return self

    def __exit__(self, *_: object) -> None:
        self._child.close()
        self._place.__exit__(None, None, None)

    def outcome(self, case: HardCase, model: str) -> Outcome:
        """Run a case on one model."""
        begun = time.perf_counter()
        try:
            got, failed = float(case.find(self, model)), ""
        except CosimError as error:
            got, failed = None, error.in_brief
        return Outcome(case, model, got, failed, time.perf_counter() - begun)

    def ask(self, target: str, payload: object) -> Any:
        """Call a function of (payload, report) in the process, as `cosim.ngspice.child.call`."""
        ready()
        return call(target, payload, time_limit_s=_LIMIT_S, child=self._child)

    def deck(self, text: str, command: str, *names: str) -> list[Array]:
        """Run an analysis of a deck in ngspice; returns its vectors of these names."""
        asked = {"deck": text, "command": command, "names": names}
        vectors: list[Array] = self.ask("cosim.accuracy.hard_cases.hard_case:analysed", asked)
        return vectors

    def refusal(self, ask: Callable[[], object], *words: str) -> float:
        """Return 1 where a call ends in a clear error with these words, 0 where it does not."""
        try:
            ask()
        except CosimError as error:
            return float(all(word in str(error) for word in words))
        return 0.0

    def netlists(self, edits: Mapping[str, Callable[[str], str]]) -> Path:
        """Return a folder with the shipped netlists, some files (``blocks/diffamp.cir``) edited."""
        place = self._folder / "netlists"
        shutil.rmtree(place, ignore_errors=True)
        shutil.copytree(netlists_folder(), place)
        for name, edit in edits.items():
            file = place / name
            before = file.read_text(encoding="utf-8")
            after = edit(before)
            assert after != before, f"nothing was edited in {name}"
            file.write_text(after, encoding="utf-8")
        return place

    def run(self, tables: Tables, model: str, law: str = "", *, estimate: bool = False) -> Ran:
        """Run a scene given as tables, its law as the text of ``law.py``; measures with errors if asked."""
        if not self._child.alive:
            self._child = self._started()
        file, out = self._folder / "scene.toml", self._folder / "run"
        (self._folder / "law.py").write_text(law, encoding="utf-8")
        file.write_text(toml(merge(tables, {"solver": {"model": model}})), encoding="utf-8")
        with collected(forward=False):
            plan = resolve(load_scene(file))
            errors = estimator(plan, self._child) if estimate else None
            result = run(plan, out, formats=(), child=self._child, errors=errors)
        signals = {name: np.array(result.signals[name]) for name in result.signals}
        cautions = tuple((each.code, each.text) for each in result.warnings)
        return Ran(signals, dict(result.samples), dict(result.measures), dict(result.stats), cautions)


def analysed(payload: dict[str, Any], report: Any) -> list[Array]:
    """Run an analysis in ngspice's process."""
    from cosim.ngspice.simulator import Simulator

    simulator = Simulator(on_time=lambda reached: report({"time_s": reached}))
    simulator.load(payload["deck"])
    simulator.command(payload["command"])
    return [np.array(simulator.vector(name)) for name in payload["names"]]


def toml(tables: Tables) -> str:
    """Return tables as the text of a TOML file: JSON's numbers, words, truth values and lists are TOML's."""
    lines: list[str] = []

    def write(table: Tables, path: tuple[str, ...]) -> None:
        if path:
            lines.append(f"[{'.'.join(path)}]")
        lines.extend(f"{k} = {_toml(v)}" for k, v in table.items() if not isinstance(v, Mapping))
        for key, value in table.items():
            if isinstance(value, Mapping):
                write(value, (*path, key))

    write(tables, ())
    return "\n".join(lines) + "\n"


def _toml(value: Any) -> str:
    """Return a value as TOML writes it: JSON has no word for NaN and infinity."""
    return repr(value) if isinstance(value, float) else json.dumps(value)


def merge(base: Tables, top: Tables) -> dict[str, Any]:
    """Return tables of `top` over those of `base`; None takes a key away."""
    out = dict(base)
    for key, value in top.items():
        if value is None:
            out.pop(key, None)
        elif isinstance(value, Mapping):
            out[key] = merge(out.get(key, {}), value)
        else:
            out[key] = value
    return out


def board(joints: int) -> str:
    """Return the path of a board that comes with the program."""
    return str(Path(netlists_folder()) / f"board{joints}.cir")


def slider(**top: Any) -> dict[str, Any]:
    """Return a carriage of 0.2 kg in free space, every effect off, tolerances tight; `top` over it."""
    base: dict[str, Any] = {
        "title": "hard case",
        "duration_s": 0.5,
        "device": {
            "board": board(1),
            "linkage": "slider",
            "slider": {"radius_m": RADIUS, "mass_kg": 0.2, "direction": [0.0, 1.0], "origin_m": [0.0, 0.0]},
            "start": {"q_rad": [0.0]},
        },
        "computer": {"period_s": 0.1, "method": "continuous", "analog_stiffness_n_per_m": 100.0},
        "solver": {"coupling_tolerance_rad": 1e-12},
    }
    return merge(base, top)


def crossings(t: Array, q: Array, v: Array, level: float) -> Array:
    """Return the instants at which a motion passes a level, of the cubic between its rows."""
    times = []
    for k in np.flatnonzero((q[:-1] - level) * (q[1:] - level) < 0.0):
        h = t[k + 1] - t[k]
        rise = (q[k + 1] - q[k]) / h
        cubic = [
            (v[k] + v[k + 1] - 2 * rise) / h**2,
            (3 * rise - 2 * v[k] - v[k + 1]) / h,
            v[k],
            q[k] - level,
        ]
        inside = [x.real for x in np.roots(cubic) if abs(x.imag) < 1e-9 * h and -1e-9 * h <= x.real <= h]
        times += [t[k] + x for x in inside[:1]]
    return np.array(times)
