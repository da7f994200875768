"""A key of a scene whose effect is off is told; every key that an effect alone uses is known."""

from pathlib import Path
from typing import Any

import pytest
from support import SCENES, scene_of, slider

from cosim.effects import EFFECTS
from cosim.effects.idle_keys import forgotten, stated_in_vain
from cosim.plan import resolve
from cosim.scene import Scene, load_scene
from cosim.studies.study import is_study, load_study

SHIPPED = sorted([*SCENES.glob("*.toml"), *filter(is_study, SCENES.glob("paper/*.toml"))])
#: Effect, value in force, and a value for each of its keys that is not the default.
VALUES: dict[str, tuple[Any, dict[str, Any]]] = {
    "delay": (True, {"computer.delay_periods": 2, "computer.delay_fraction": 0.5}),
    "period_jitter": ("uniform", {"computer.jitter_share": 0.02}),
    "encoder": (True, {"computer.encoder.pulses_per_rev": 1000, "computer.encoder.decoding": 2}),
    "dac": (True, {"computer.dac.bits": 16, "computer.dac.range_v": 5.0}),
    "dac_settling": (True, {"computer.dac.settling_s": 1e-5}),
    "dac_skew": (True, {"computer.dac.skew_s": 1e-5}),
    "pot_noise": ("white", {"device.potentiometer.noise_rad": 0.01,
                            "device.potentiometer.noise_bandwidth_hz": 50.0,
                            "device.potentiometer.position_period_rad": 0.2}),
    "pot_linearity": (True, {"device.potentiometer.linearity_rad": 0.01,
                             "device.potentiometer.linearity_period_rad": 2.0}),
    "pot_calibration": (True, {"device.potentiometer.gain_error": 0.02,
                               "device.potentiometer.zero_rad": 0.01}),
    "component_noise": (True, {"device.component_noise_bandwidth_hz": 500.0}),
    "temperature": (True, {"device.temperature_c": 50.0}),
    "gravity": (True, {"device.slider.gravity_m_per_s2": [0.0, -1.62]}),
    "viscous": (True, {"device.slider.viscous_n_m_s": 1e-3}),
    "coulomb": (True, {"device.slider.coulomb_n_m": 0.01, "device.slider.coulomb_speed_rad_per_s": 0.02}),
    "rotor_inertia": (True, {"device.slider.rotor_inertia_kg_m2": 1e-6}),
    "end_stops": (True, {"device.slider.stops_rad": [[-1.0, 1.0]], "device.slider.stop_damping_n_m_s": 0.2,
                         "device.slider.stop_stiffness_n_m_per_rad": 50.0}),
    "shaft": (True, {"device.slider.shaft_stiffness_n_m_per_rad": 30.0,
                     "device.slider.shaft_damping_n_m_s": 1e-3}),
    "backlash": (True, {"device.slider.backlash_rad": 0.01}),
}  # fmt: skip


def scene(folder: Path, effect: str, value: Any, keys: dict[str, Any]) -> Scene:
    settings = [f"{key}={setting}" for key, setting in keys.items()]
    states = [f"effects.{effect}={str(value).lower()}"] if value is not None else []
    if effect == "shaft" and value:  # it needs a rotor
        states += ["device.slider.rotor_inertia_kg_m2=1e-6", "effects.rotor_inertia=true"]
    return scene_of(folder, slider(), *settings, *states)


@pytest.mark.parametrize("effect", VALUES)
def test_keys_are_reported_while_their_effect_is_off(tmp_path: Path, effect: str) -> None:
    value, keys = VALUES[effect]
    result = stated_in_vain(scene(tmp_path, effect, None, keys), EFFECTS)
    assert len(result) == len(keys)
    for key, each in zip(next(e.keys for e in EFFECTS if e.name == effect), result, strict=False):
        if not key.startswith("device.chain"):
            assert f"has no effect: effects.{effect} is off" in each
    assert {each.partition(" = ")[0] for each in result} == set(keys)
    assert stated_in_vain(scene(tmp_path, effect, value, keys), EFFECTS) == []


@pytest.mark.parametrize("effect", VALUES)
def test_a_scene_that_does_not_mention_the_effect_is_warned(tmp_path: Path, effect: str) -> None:
    """Wherever the key stands; a scene that says that the effect is off is only noted."""
    value, keys = VALUES[effect]
    assert len(forgotten(scene(tmp_path, effect, None, keys), EFFECTS)) == len(keys)
    off = "none" if isinstance(value, str) else False
    stated = scene(tmp_path, effect, off, keys)
    assert forgotten(stated, EFFECTS) == []
    assert len(stated_in_vain(stated, EFFECTS)) == len(keys)


@pytest.mark.few(6)
@pytest.mark.parametrize("file", SHIPPED, ids=lambda file: file.stem)
def test_no_shipped_scene_warns_before_it_runs(file: Path) -> None:
    assert resolve(load_study(file).scene() if is_study(file) else load_scene(file)).cautions == ()


def test_defaults_and_scenes_with_chosen_effects_say_nothing(tmp_path: Path) -> None:
    assert stated_in_vain(scene_of(tmp_path, slider(), "computer.delay_periods=0"), EFFECTS) == []
    auto = scene_of(
        tmp_path, slider(effects={"auto": True}), "computer.delay_periods=2", "tolerance.peak_force=0.1"
    )
    assert stated_in_vain(auto, EFFECTS) == []


def test_a_hand_without_dynamics(tmp_path: Path) -> None:
    hand = {"type": "hand", "waypoints_s_m": [[0.0, 0.0, 0.0]], "mass_kg": 0.3}
    result = stated_in_vain(scene_of(tmp_path, slider(operator=hand)), EFFECTS)
    assert result == ["operator.mass_kg = 0.3 has no effect: effects.operator_dynamics is off"]
    mass = {"type": "mass", "mass_kg": 0.3}
    assert stated_in_vain(scene_of(tmp_path, slider(operator=mass)), EFFECTS) == []


def test_every_key_is_one_of_the_schema() -> None:
    assert set(VALUES) | {"operator_dynamics"} == {effect.name for effect in EFFECTS if effect.keys}
    for effect in EFFECTS:
        for key in effect.keys:
            table: Any = Scene
            *path, name = key.split(".")
            for part in path:
                if part == "operator":
                    return  # one of several tables
                field = table.model_fields[part].annotation
                table = getattr(field, "__args__", (field,))[0]
            assert name in table.model_fields, key
