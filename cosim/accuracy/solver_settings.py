"""The settings of the solver that a study of accuracy tries on a scene, and those of its references."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from cosim.effects import EFFECTS, lesser
from cosim.scene import Scene

__all__ = ["MODELS", "SHORTEST_S", "Setting", "carries", "grid", "reference", "second_reference"]

MODELS = ("ideal", "linear", "spice")

#: Series of a model's settings as the scene states them.
AS_STATED = "as the scene states it"
#: ngspice's relative tolerance, and the longest step over the scene's own.
_RTOL = (1e-2, 1e-3, 1e-4, 1e-5, 1e-6)
_STEP = (4.0, 2.0, 0.5, 0.25, 0.125)
_COUPLING = {"spice": (1e-5, 1e-6, 1e-8, 1e-9, 1e-10), "own": (1e-3, 1e-4, 1e-5, 1e-6, 1e-8, 1e-9, 1e-11)}
_CHARGE = (1e-10, 1e-12, 1e-14)
_ORDER = (1e-1, 1e-2, 1e-3, 1e-4, 1e-8)
#: Everything of `spice` at once: relative tolerance, step over the scene's own, coupling [rad], charge [C].
#: Coupling and circuit each put an error into the motion: it is cheapest to tighten them together.
_TOGETHER = (
    (1e-3, 2.0, 1e-6, 1e-9), (1e-5, 1.0, 1e-9, 1e-9), (1e-6, 1.0, 1e-10, 1e-9), (1e-7, 1.0, 1e-11, 1e-9),
)  # fmt: skip
#: The same by trapezoids, where linkage and circuit share the rule and steps alone decide how exact it is.
_TRAPEZOIDS = (
    (1e-3, 2.0, 1e-6, 1e-9), (1e-3, 0.5, 1e-7, 1e-9), (1e-5, 1.0, 1e-8, 1e-9), (1e-3, 0.125, 1e-7, 1e-9),
    (1e-6, 0.125, 1e-9, 1e-9),
)  # fmt: skip
#: The references: far tighter than any of these, and with steps that show every peak.
_TIGHT_STEP, _SECOND_STEP = 1.0 / 40.0, 1.0 / 25.0
SHORTEST_S, _LONGEST_S = 1e-9, 1.0


@dataclass(frozen=True)
class Setting:
    """One choice of solver.

    Attributes
    ----------
    model : circuit model
    series : what is varied, in words
    label : model and what differs from the scene, in words
    overrides : `KEY=VALUE` on top of the scene, as `load_scene` takes them
    """

    model: str
    series: str
    label: str
    overrides: tuple[str, ...]

    def lines(self) -> list[str]:
        """Return the lines to put in the scene, section by section."""
        sections: dict[str, list[str]] = {}
        for override in self.overrides:
            key, _, value = override.partition("=")
            section, _, name = key.rpartition(".")
            sections.setdefault(section, []).append(f"{name} = {_toml(value)}")
        return [line for section, keys in sections.items() for line in (f"[{section}]", *keys)]


def _toml(value: str) -> str:
    """Return a value as TOML writes it: words in quotes."""
    return value if value in ("true", "false") or value[:1] in '"[-.0123456789' else f'"{value}"'


def carries(scene: Scene, model: str) -> bool:
    """Whether a circuit model carries all that the scene asks of it."""
    return (model == "spice" or not scene.record.nodes) and all(
        model in effect.carriers(scene) for effect in EFFECTS
    )


def grid(scene: Scene, models: Iterable[str] = MODELS) -> list[Setting]:
    """Return the settings to try: the scene's own tolerances one at a time, in `spice` also together."""
    return [setting for model in models for setting in _of_model(scene, model)]


def _of_model(scene: Scene, model: str) -> list[Setting]:
    solver = scene.solver
    base = _base(scene, model)

    def made(series: str, method: str = "", **values: float) -> Setting:
        stated = tuple(f"solver.{name}={value!r}" for name, value in values.items())
        words = ", ".join(f"{name} {value:g}" for name, value in values.items())
        if method:
            stated, words = (f"solver.method={method}", *stated), f"{method}, {words}"
        return Setting(
            model, series, f"{model}, {words}" if words else f"{model} as stated", (*base, *stated)
        )

    def step(share: float) -> float:
        return float(f"{min(max(share * solver.max_step_s, SHORTEST_S), _LONGEST_S):.6g}")

    settings = [made(AS_STATED)]
    if model == "spice":
        settings += [made("relative tolerance", rtol=value) for value in _RTOL]
        settings += [made("charge tolerance", charge_tolerance_c=value) for value in _CHARGE]
        for series, method, several in (("all together", "", _TOGETHER), ("trapezoids", "trap", _TRAPEZOIDS)):
            settings += [
                made(series, method, rtol=rtol, max_step_s=step(share), coupling_tolerance_rad=coupling,
                     charge_tolerance_c=charge)
                for rtol, share, coupling, charge in several
            ]  # fmt: skip
    if model == "linear":
        settings += [made("order of the circuit", reduction_tolerance=value) for value in _ORDER]
    tolerances = _COUPLING["spice" if model == "spice" else "own"]
    settings += [made("coupling tolerance", coupling_tolerance_rad=value) for value in tolerances]
    return [*settings, *(made("longest step", max_step_s=step(share)) for share in _STEP)]


def _base(scene: Scene, model: str) -> tuple[str, ...]:
    return (*(lesser(scene, model)), f"solver.model={model}")


def reference(scene: Scene) -> Setting:
    """Return the first reference: `linear` where it carries the scene, for its circuit is solved exactly."""
    return _own_loop(scene) if carries(scene, "linear") else _lockstep(scene, _TIGHT_STEP, "gear", 1e-7)


def second_reference(scene: Scene) -> Setting:
    """Return one that shares no integrator with the first: ngspice, with another method if both are."""
    if carries(scene, "linear"):
        return _lockstep(scene, _TIGHT_STEP, "trap", 1e-7)
    return _lockstep(scene, _SECOND_STEP, "trap", 3e-7)


def _own_loop(scene: Scene) -> Setting:
    step = max(scene.solver.max_step_s / 8.0, SHORTEST_S)
    fine = (f"solver.max_step_s={step:.6g}", "solver.coupling_tolerance_rad=1e-13")
    more = ("solver.reduction_tolerance=1e-9", *fine)
    return Setting("linear", "reference", "linear, tight", ("solver.model=linear", *more))


def _lockstep(scene: Scene, share: float, method: str, rtol: float) -> Setting:
    step = max(scene.solver.max_step_s * share, SHORTEST_S)
    changes = (
        "solver.model=spice", f"solver.method={method}", f"solver.rtol={rtol!r}",
        f"solver.max_step_s={step:.6g}", "solver.coupling_tolerance_rad=1e-12",
        "solver.charge_tolerance_c=1e-13",
    )  # fmt: skip
    return Setting("spice", "reference", f"spice, tight, {method}", changes)
