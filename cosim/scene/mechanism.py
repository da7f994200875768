"""Linkage, operator, start and encoder of a scene, as mechanics knows them."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cosim.errors import InputError, Problem
from cosim.scene import Scene, choices, device_tables, schema
from cosim.scene.numbers import with_number
from mech import Chain, Hand, NoOperator, Operator, ParameterError, PointMass, Slider, load_user

__all__ = ["encoder_step", "is_linear_between_events", "known_mechanism", "mechanism", "operator", "start"]


def mechanism(scene: Scene, gear: float) -> Chain | Slider:
    """Linkage of the scene with the effects that are off left out."""
    effects = scene.effects
    device = scene.device
    if device.chain is not None and device.linkage is choices.Linkage.CHAIN:
        chain = device.chain
        zeros = (0.0,) * len(chain.lengths_m)
        return Chain(
            lengths_m=chain.lengths_m,
            masses_kg=chain.masses_kg,
            coms_m=chain.coms_m,
            inertias_kg_m2=chain.inertias_kg_m2,
            rotor_inertia_kg_m2=chain.rotor_inertia_kg_m2 if effects.rotor_inertia else zeros,
            gear=gear,
            gravity_m_per_s2=chain.gravity_m_per_s2 if effects.gravity else (0.0, 0.0),
            coriolis=effects.coriolis,
            viscous_n_m_s=chain.viscous_n_m_s if effects.viscous else zeros,
            coulomb_n_m=chain.coulomb_n_m if effects.coulomb else zeros,
            coulomb_speed_rad_per_s=chain.coulomb_speed_rad_per_s,
            stops_rad=(chain.stops_rad or None) if effects.end_stops else None,
            stop_stiffness_n_m_per_rad=chain.stop_stiffness_n_m_per_rad,
            stop_damping_n_m_s=chain.stop_damping_n_m_s,
            stop_restitution=chain.stop_restitution if effects.end_stops else None,
            **_shafts(scene, chain),
        )
    slider = device.slider
    assert slider is not None  # the scene's checks hold this
    return Slider(
        radius_m=slider.radius_m,
        mass_kg=slider.mass_kg,
        rotor_inertia_kg_m2=slider.rotor_inertia_kg_m2 if effects.rotor_inertia else 0.0,
        gear=gear,
        direction=slider.direction,
        origin_m=slider.origin_m,
        gravity_m_per_s2=slider.gravity_m_per_s2 if effects.gravity else (0.0, 0.0),
        viscous_n_m_s=slider.viscous_n_m_s if effects.viscous else 0.0,
        coulomb_n_m=slider.coulomb_n_m if effects.coulomb else 0.0,
        coulomb_speed_rad_per_s=slider.coulomb_speed_rad_per_s,
        stops_rad=(slider.stops_rad or None) if effects.end_stops else None,
        stop_stiffness_n_m_per_rad=slider.stop_stiffness_n_m_per_rad,
        stop_damping_n_m_s=slider.stop_damping_n_m_s,
        stop_restitution=slider.stop_restitution if effects.end_stops else None,
        **_shafts(scene, slider),
    )


def known_mechanism(scene: Scene, gear: float) -> Chain | Slider:
    """Linkage that the computer reckons with: the device's own, but for numbers known of the design."""
    for key, value in scene.designed:
        scene = with_number(scene, key, value)
    return mechanism(scene, gear)


def is_linear_between_events(scene: Scene) -> bool:
    """Whether linkage, operator and potentiometers are linear from one event of a scene to the next.

    A slider without friction, stops and shaft, moved by nobody's own class, its potentiometer's error no
    function of the angle. The models `ideal` and `linear` then step from event to event exactly.
    """
    effects, slider, pot = scene.effects, scene.device.slider, scene.device.potentiometer
    if slider is None or not scene.is_slider:
        return False
    bent = (
        effects.pot_noise in (choices.PotNoise.STATIC, choices.PotNoise.POSITION)
        or (effects.pot_linearity and pot.linearity_rad > 0.0)
        or (effects.pot_calibration and (pot.gain_error != 0.0 or pot.zero_rad != 0.0))
    )
    friction = effects.coulomb and slider.coulomb_n_m > 0.0
    stops = effects.end_stops and bool(slider.stops_rad)
    own = isinstance(scene.operator, schema.PythonOperator)
    return not (bent or friction or stops or own or effects.shaft or effects.component_noise)


def _shafts(scene: Scene, table: device_tables.Chain | device_tables.Slider) -> dict[str, Any]:
    """Fields of a linkage whose motors sit behind shafts; none when the effect is off."""
    if not scene.effects.shaft:
        return {}
    return {
        "shaft_stiffness_n_m_per_rad": table.shaft_stiffness_n_m_per_rad,
        "shaft_damping_n_m_s": table.shaft_damping_n_m_s,
        "backlash_rad": table.backlash_rad if scene.effects.backlash else 0.0,
    }


def operator(scene: Scene) -> Operator:
    """Return the operator of the scene as mechanics knows it; a user's class is loaded from its file.

    Raises
    ------
    InputError
        When the user's file or class is not what it should be.
    """
    try:
        return _operator(scene)
    except ParameterError as error:
        file = scene.file_name
        raise InputError(Problem(str(error), file=file, key="operator")) from error


def _operator(scene: Scene) -> Operator:
    given, dynamic = scene.operator, scene.effects.operator_dynamics
    if isinstance(given, schema.MassOperator):
        return PointMass(mass_kg=given.mass_kg)
    if isinstance(given, schema.HandOperator):
        return Hand(
            mass_kg=given.mass_kg if dynamic else 0.0,
            damping_n_s_per_m=given.damping_n_s_per_m if dynamic else 0.0,
            stiffness_n_per_m=given.stiffness_n_per_m,
            waypoints_s_m=given.waypoints_s_m,
            force_s_n=given.force_s_n,
        )
    if isinstance(given, schema.PythonOperator):
        return load_user(given.file, scene.file.parent if scene.file else ".")
    return NoOperator()


def start(scene: Scene, linkage: Chain | Slider) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return initial angles [rad] and speeds [rad/s]; `InputError` when the tip is out of reach."""
    given = scene.device.start
    n = scene.joints
    if given.q_rad is not None:
        q = np.array(given.q_rad, dtype=float)
    else:
        assert given.tip_m is not None  # the scene's checks hold this
        try:
            q = np.asarray(linkage.inverse(np.array(given.tip_m), elbow=given.elbow), dtype=float)
        except ValueError as error:
            key = "device.start.tip_m"
            problem = Problem(str(error), file=scene.file_name, key=key, value=given.tip_m, unit="m")
            raise InputError(problem) from None
    v = np.array(given.v_rad_per_s, dtype=float) if given.v_rad_per_s else np.zeros(n)
    return q, v


def encoder_step(scene: Scene, gear: float) -> float:
    """Joint angle of one encoder count [rad]; 0 when the effect is off."""
    encoder = scene.computer.encoder
    if not scene.effects.encoder:
        return 0.0
    return 2 * math.pi / (encoder.pulses_per_rev * encoder.decoding * gear)
