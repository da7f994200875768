"""Scenes of the random search for trouble (`benchmarks.trouble`): shipped ones, changed at random; twins."""

from __future__ import annotations

import json
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.rig import ROOT
from benchmarks.trouble_boards import Slip, slip
from cosim.scene import load_scene

#: Another form of the same experiment; joints in another order are another device in a chain of links.
TWINS = ("turned", "mirrored", "later", "units")
#: Share of the scenes whose board has a slip.
SLIPS = 0.08
#: Resistors of the shipped boards that are drawn within a factor of two either way.
_RESISTORS = {"r_sum_spring": 24.3e3, "r_sum_damper": 6.19e3, "r_diff_fb": 169e3}
_COMMON = ("gravity", "viscous", "encoder", "dac", "dac_settling", "rotor_inertia", "delay", "driver_limit",
           "pot_calibration", "opamp_offset")  # fmt: skip
#: Effects of few devices, each in a tenth of the scenes.
_RARE = ("coulomb", "end_stops", "shaft", "backlash", "component_noise", "dac_skew", "pot_linearity",
         "vca_gain_error", "vca_offset", "vca_nonlinearity", "opamp_slew", "opamp_saturation")  # fmt: skip
#: What a chain's motors see by the angle itself, which the twin changes; a slider's angle stays what it is.
_BY_ANGLE = {"encoder": False, "dac": False, "pot_linearity": False, "pot_calibration": False,
             "opamp_offset": False, "vca_offset": False, "end_stops": False, "pot_noise": "none",
             "vca_nonlinearity": False, "vca_gain_error": False,
             "component_noise": False, "opamp_saturation": False, "opamp_slew": False}  # fmt: skip
#: What keeps a device or its currents from resting until the hand moves, or is drawn by the sample's number.
_BY_TIME = {"gravity": False, "opamp_offset": False, "vca_offset": False, "pot_noise": "none",
            "component_noise": False, "period_jitter": "none", "pot_calibration": False,
            "pot_linearity": False, "vca_nonlinearity": False}  # fmt: skip
#: Keys that hold places and directions of the plane.
_PLANE = ("wall.point_m", "wall.normal", "device.start.tip_m", "device.chain.gravity_m_per_s2",
          "device.slider.direction", "device.slider.origin_m", "device.slider.gravity_m_per_s2",
          "operator.waypoints_s_m", "operator.force_s_n")  # fmt: skip

Changes = dict[str, Any]


@dataclass(frozen=True)
class Drawn:
    """A scene of the search: its file, what is changed in it, its twin, and what is wrong with its board."""

    file: Path
    changes: Changes
    twin: str
    slip: Slip | None = None

    def overrides(self, more: Changes) -> tuple[str, ...]:
        """Return the changes and `more` of them as `load_scene` takes them."""
        merged = self.changes | more
        return tuple(f"{key}={json.dumps(value)}" for key, value in merged.items())


def drawn(seed: int, number: int) -> Drawn:
    """Return the scene `number` of a seed."""
    rng = np.random.default_rng([seed, number])

    def power(low: float, high: float) -> float:
        return float(f"{10 ** rng.uniform(low, high):.4g}")

    def one_of(*words: str) -> str:
        return str(rng.choice(words))

    def rarely() -> bool:
        return bool(rng.random() < 0.1)

    name = one_of("drop", "press", "slope")
    twin = one_of(*(each for each in TWINS if name != "drop" or each != "later"))
    method = one_of("discrete", "continuous", "combined")
    period = min(power(-4, -0.7), 0.2)
    lowest = rng.random() < 0.3  # a circuit of ideal parts, for the model `ideal`
    changes: Changes = {
        "computer.period_s": period,
        "duration_s": float(f"{max(0.3, 4 * period):.4g}"),
        "computer.method": method,
        "computer.discrete_stiffness_n_per_m": 0.0 if method == "continuous" else power(0, 5),
        "computer.analog_stiffness_n_per_m": 0.0 if method == "discrete" else power(0, 2.3),
        "computer.analog_damping_n_s_per_m": 0.0 if method == "discrete" else power(-2, 0.5),
        "computer.dac.skew_s": power(-6, -4),
        "computer.jitter_share": power(-3, -1),
        "solver.time_limit_s": 60.0,
        "seed": int(rng.integers(1 << 30)),
    }
    level = "ideal" if lowest else None
    effects: Changes = {
        "opamp": level or one_of("ideal", "gbw", "full"),
        "vca": level or one_of("ideal", "gbw"),
        "driver_level": level or one_of("ideal", "gbw"),
        "motor": level or one_of("ideal", "emf", "full"),
        "differentiator": level or one_of("ideal", "corner"),
        "period_jitter": one_of("uniform", "normal") if rarely() else "none",
        "pot_noise": one_of("white", "peak_to_peak", "static", "position") if rarely() else "none",
    }
    effects |= {each: bool(rng.integers(2)) and not (lowest and each == "opamp_offset") for each in _COMMON}
    effects |= {each: rarely() and not (lowest and each[:3] in ("vca", "opa", "com")) for each in _RARE}
    changes |= {f"device.values.{key}": f"{v * 2 ** rng.uniform(-1, 1):.5g}" for key, v in _RESISTORS.items()}
    if rng.integers(2):
        changes["device.values.tl072_gbw"] = f"{power(4, 9):g}"
    changes |= _linkage(name, rng, power)
    arm = twin in ("turned", "mirrored") and name != "drop"
    if twin == "later" or arm:
        effects |= _BY_ANGLE if arm else _BY_TIME
        effects["opamp"] = effects["opamp"].replace("full", "gbw")  # `full` has offsets
    if arm and twin == "turned":  # what a follower loses and a rounded scale adds goes by the angle
        effects["opamp"] = "ideal"
        changes["device.values.v_rad"] = repr(20.0 / math.radians(340.0))
    for each in ("opamp_slew", "opamp_saturation"):
        effects[each] &= effects["opamp"] != "ideal"
    effects["rotor_inertia"] |= effects["shaft"]
    effects["backlash"] &= effects["shaft"]
    changes |= {f"effects.{key}": value for key, value in effects.items()}
    boards = np.random.default_rng([seed, number, 2])  # of its own: the other scenes stay as they were
    wrong = slip(boards) if boards.random() < SLIPS else None
    if arm and wrong is not None and wrong.uneven:
        twin = "units"
    return Drawn(ROOT / "scenes" / f"{name}.toml", changes, twin, wrong)


def _linkage(name: str, rng: np.random.Generator, power: Any) -> Changes:
    """Draw masses, friction, shafts and stops of a device, and its operator."""
    if name == "drop":
        low, high = float(f"{rng.uniform(-0.3, -0.05):.4g}"), float(f"{rng.uniform(0.01, 0.3):.4g}")
        return {
            "device.slider.mass_kg": power(-3, 1), "operator.mass_kg": power(-3, 1),
            "device.slider.coulomb_n_m": power(-4, -1), "device.slider.stops_rad": [[low, high]],
            "device.slider.shaft_stiffness_n_m_per_rad": power(1, 3),
            "device.slider.shaft_damping_n_m_s": power(-3, -1), "device.slider.backlash_rad": power(-4, -2),
        }  # fmt: skip
    masses = [power(-3, 0), power(-3, 0)]
    return {
        "operator.stiffness_n_per_m": power(0, 3), "operator.mass_kg": power(-3, 1),
        "device.chain.masses_kg": masses,
        "device.chain.inertias_kg_m2": [float(f"{m * 0.1**2 / 12:.4g}") for m in masses],
        "device.chain.coulomb_n_m": [power(-4, -1.5), power(-4, -1.5)],
        "device.chain.stops_rad": [[0.3, float(f"{rng.uniform(0.63, 0.8):.4g}")],
                                   [float(f"{rng.uniform(0.8, 1.05):.4g}"), 2.0]],
        "device.chain.shaft_stiffness_n_m_per_rad": [power(1, 3), power(1, 3)],
        "device.chain.shaft_damping_n_m_s": [power(-3, -1), power(-3, -1)],
        "device.chain.backlash_rad": [power(-4, -2), power(-4, -2)],
    }  # fmt: skip


def twin_changes(scene: Drawn, seed: int, number: int) -> Changes:
    """Return what turns the scene into its twin."""
    rng = np.random.default_rng([seed, number, 1])
    if scene.twin == "units":  # 24300 is 24.3k is 24300000m
        return {f"device.values.{key}": _in_other_units(scene.changes[f"device.values.{key}"], rng)
                for key in _RESISTORS}  # fmt: skip
    if scene.twin == "later":
        operator = load_scene(scene.file).operator
        later = int(rng.integers(1, 6)) * scene.changes["computer.period_s"]
        rows = {key: [[row[0] + later, *row[1:]] for row in getattr(operator, key)]
                for key in ("waypoints_s_m", "force_s_n")}  # fmt: skip
        return {f"operator.{key}": value for key, value in rows.items()} | {
            "duration_s": scene.changes["duration_s"] + later
        }
    angle = rng.uniform(-1.0, 1.0)
    cos, sin = math.cos(angle), math.sin(angle)
    if scene.twin == "turned":
        return _moved(scene, np.array([[cos, -sin], [sin, cos]]))
    # a mirrored arm bends the other way
    bent = {} if scene.file.stem == "drop" else {"device.start.elbow": -1}
    return _moved(scene, np.array([[1.0, 0.0], [0.0, -1.0]])) | bent


def _in_other_units(ohms: str, rng: np.random.Generator) -> str:
    suffix, power = (("k", -3), ("meg", -6), ("m", 3))[int(rng.integers(3))]
    mantissa, exponent = f"{float(ohms):e}".split("e")
    return f"{mantissa}e{int(exponent) + power}{suffix}"


def _moved(scene: Drawn, matrix: NDArray[np.float64]) -> Changes:
    """Return all places and directions of the scene under a linear map of the plane."""
    tables = load_scene(scene.file, scene.overrides({}))
    changes: Changes = {}
    for key in _PLANE:
        value: Any = tables
        for name in key.split("."):
            value = getattr(value, name, None)
        if value is not None:
            rows = np.array(value, float)
            rows[..., -2:] = rows[..., -2:] @ matrix.T
            changes[key] = rows.tolist()
    return changes
