"""The effects ledger: each effect switched on alone and off alone, on the same seed.

Two baselines are run, one with every effect in its null form and one with every effect in force; then each
effect is switched on alone from the first and off alone from the second. The difference in a measure is what
the effect is worth there, the difference in processor time what it costs. Two runs a row and two baselines.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from cosim.effects import EFFECTS, Effect
from cosim.ngspice.child import Child
from cosim.plan import resolve
from cosim.run import run
from cosim.scene import Scene, load_scene

Measures = Mapping[str, Mapping[str, Any]]


@dataclass(frozen=True)
class Row:
    """One effect at one value.

    Attributes
    ----------
    effect, value : name in `[effects]` and what it was set to
    on : what it adds to every measure when it is switched on alone
    off : what it adds to every measure where all others are in force (they are kept while it is off)
    on_s, off_s : what it costs in seconds of processor time, alone and on top of all others
    """

    effect: str
    value: str
    on: dict[str, float]
    off: dict[str, float]
    on_s: float
    off_s: float


@dataclass(frozen=True)
class EffectsLedger:
    """The measured ledger of a scene.

    Attributes
    ----------
    null, full : measures of the two baselines
    null_s, full_s : their processor time [s]
    rows : one an effect and value
    runs : how many co-simulations were run
    """

    null: Measures
    full: Measures
    null_s: float
    full_s: float
    rows: tuple[Row, ...]
    runs: int


def effects_ledger(
    path: str | Path,
    overrides: tuple[str, ...] = (),
    *,
    child: Child | None = None,
    on_progress: Callable[[int, int, str], None] | None = None,
) -> EffectsLedger:
    """Measure what each effect changes and costs in a scene.

    Parameters
    ----------
    path, overrides
        The scene, as for `load_scene`. Where the scene has an effect in force, its value counts as 'on'.
    child
        A simulation process to use for all runs.
    on_progress
        Called with (runs done, runs in all, name) before every run.
    """
    scene = load_scene(path, overrides)
    on = {effect.name: _on(effect, scene) for effect in EFFECTS}
    nothing = {effect.name: effect.null for effect in EFFECTS}
    total = 2 + 2 * sum(len(_values(effect, on[effect.name])) for effect in EFFECTS)
    done = 0

    def measure(settings: Mapping[str, Any], name: str) -> tuple[Measures, float]:
        nonlocal done
        if on_progress is not None:
            on_progress(done, total, name)
        done += 1
        changed = [f"effects.{key}={_toml(value)}" for key, value in settings.items()]
        with TemporaryDirectory(prefix="cosim-effects-") as folder:
            result = run(
                resolve(load_scene(path, [*overrides, *changed])),
                Path(folder) / "run",
                formats=(),
                child=child,
            )
            return dict(result.measures), float(result.stats["cpu_s"])

    null, null_s = measure(nothing, "every effect in its null form")
    full, full_s = measure(on, "every effect in force")
    rows = []
    for effect in EFFECTS:
        without, without_s = measure({**on, effect.name: effect.null}, f"all but {effect.name}")
        for value in _values(effect, on[effect.name]):
            alone, alone_s = measure({**nothing, effect.name: value}, f"{effect.name} = {value} alone")
            among, among_s = full, full_s
            if value != on[effect.name]:
                among, among_s = measure({**on, effect.name: value}, f"all, {effect.name} = {value}")
            rows.append(
                Row(
                    effect.name,
                    str(value),
                    on=_difference(alone, null),
                    off=_difference(among, without),
                    on_s=alone_s - null_s,
                    off_s=among_s - without_s,
                )
            )
    return EffectsLedger(null, full, null_s, full_s, tuple(rows), done)


def _on(effect: Effect, scene: Scene) -> Any:
    value = effect.value(scene)
    return value if value != effect.null else effect.on[0]


def _values(effect: Effect, in_force: Any) -> list[Any]:
    return [in_force, *(value for value in effect.on if value != in_force)]


def _toml(value: Any) -> str:
    return str(value).lower() if isinstance(value, bool) else f'"{value}"'


def _difference(first: Measures, second: Measures) -> dict[str, float]:
    return {
        name: float(first[name]["value"]) - float(second[name]["value"]) for name in first if name in second
    }
