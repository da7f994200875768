"""Orders of magnitude of a scene, from which a-priori sizes are made before anything has run.

Upper estimates from what the scene and its board state: how stiff, how fast, how deep, how heavy. They rank
effects and predict nothing.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from cosim.circuits.design_constants import Stated
from cosim.scene import HandOperator, MassOperator, Method, Scene

#: Peak speed of a minimum-jerk move over its mean (Flash and Hogan 1985): 30 x^2 (1 - x)^2 at x = 1/2.
_MINIMUM_JERK_PEAK = 15.0 / 8.0
#: Least speed assumed of a scene [m/s]: a hand at rest still drifts by some mm/s.
_TREMBLE_M_PER_S = 0.01


@dataclass(frozen=True)
class Scale:
    """Orders of magnitude at the fingertip.

    Attributes
    ----------
    reach_m : from joint to tip
    device_kg, rotor_kg, person_kg : device without rotors, rotors behind their gears, operator's mass
    analog_n_per_m, discrete_n_per_m : wall rendered by the circuit, and by the computer
    analog_n_s_per_m, discrete_n_s_per_m : its dampers
    speed_m_per_s : fastest the tip is meant to go
    depth_m : deepest it is meant to sink into the wall
    limit_n : force of a motor at the driver's current limit
    period_s : sampling period
    joints : how many motors add up at the tip
    """

    reach_m: float
    device_kg: float
    rotor_kg: float
    person_kg: float
    analog_n_per_m: float
    discrete_n_per_m: float
    analog_n_s_per_m: float
    discrete_n_s_per_m: float
    speed_m_per_s: float
    depth_m: float
    limit_n: float
    period_s: float
    joints: int

    @property
    def stiffness_n_per_m(self) -> float:
        """Of the whole wall."""
        return self.analog_n_per_m + self.discrete_n_per_m

    @property
    def mass_kg(self) -> float:
        """All that moves, as seen at the tip."""
        return self.device_kg + self.rotor_kg + self.person_kg

    @property
    def force_n(self) -> float:
        """Of the wall at its deepest; no motor gives more than its limit."""
        damping = self.analog_n_s_per_m + self.discrete_n_s_per_m
        return min(self.stiffness_n_per_m * self.depth_m + damping * self.speed_m_per_s, self.limit_n)

    def capped(self, force_n: float) -> float:
        """Return a force of the motors [N], at most what they can give from one limit to the other."""
        return min(force_n, 2.0 * self.limit_n)

    def of_delay(self, delay_s: float) -> float:
        """Return the force [N] by which a wall seen late is wrong: its stiffness times the way meanwhile."""
        return self.capped(self.stiffness_n_per_m * self.speed_m_per_s * delay_s)


def scale(scene: Scene, constants: Stated) -> Scale:
    """Return the orders of magnitude of a scene on a board."""
    device, computer = scene.device, scene.computer
    reach = constants.r_tip
    if device.slider is not None:
        reach = device.slider.radius_m
        masses, rotors = [device.slider.mass_kg], [device.slider.rotor_inertia_kg_m2]
    else:
        assert device.chain is not None  # the scene's checks hold this
        masses, rotors = list(device.chain.masses_kg), list(device.chain.rotor_inertia_kg_m2)
    person = scene.operator
    held = person.mass_kg if isinstance(person, HandOperator | MassOperator) else 0.0
    analog = 0.0 if computer.method is Method.DISCRETE else computer.analog_stiffness_n_per_m
    if computer.method is Method.JOINT_PD and computer.joint_stiffness_n_m_per_rad:
        analog = max(computer.joint_stiffness_n_m_per_rad) / reach**2
    stiffness = analog + computer.discrete_stiffness_n_per_m
    mass = sum(masses) + held
    speed = _speed(scene, mass, reach)
    return Scale(
        reach_m=reach,
        device_kg=sum(masses),
        rotor_kg=sum(rotors) * constants.gear**2 / reach**2,
        person_kg=held,
        analog_n_per_m=analog,
        discrete_n_per_m=computer.discrete_stiffness_n_per_m,
        analog_n_s_per_m=computer.analog_damping_n_s_per_m,
        discrete_n_s_per_m=computer.discrete_damping_n_s_per_m,
        speed_m_per_s=speed,
        depth_m=_depth(scene, stiffness, mass, speed, _pull(scene)),
        limit_n=constants.i_limit * constants.kt * constants.gear / reach,
        period_s=computer.period_s,
        joints=scene.joints,
    )


def _pull(scene: Scene) -> float:
    """Acceleration of free fall [m/s^2]; zero where gravity is not in force."""
    table = scene.device.slider or scene.device.chain
    assert table is not None  # the scene's checks hold this
    return math.hypot(*table.gravity_m_per_s2) if scene.effects.gravity else 0.0


def _speed(scene: Scene, mass: float, reach: float) -> float:
    """Fastest that the tip is meant to go [m/s]: at the start, on the hand's path, at the end of a fall."""
    fastest = [_TREMBLE_M_PER_S, reach * max((abs(v) for v in scene.start_speed_rad_per_s), default=0.0)]
    person, pull = scene.operator, _pull(scene)
    if isinstance(person, HandOperator):
        for (t0, *start), (t1, *end) in pairwise(person.waypoints_s_m):
            fastest.append(_MINIMUM_JERK_PEAK * math.dist(start, end) / (t1 - t0))
        if person.stiffness_n_per_m > 0.0:  # let go from rest, held by the hand's spring
            fastest.append(pull * math.sqrt(mass / person.stiffness_n_per_m))
    else:
        fastest.append(math.sqrt(2.0 * pull * _above_wall(scene)))
    return max(fastest)


def _above_wall(scene: Scene) -> float:
    """Distance of the start from the wall [m]; none where one of them is not stated by its place."""
    if scene.wall is None:
        return 0.0
    start = scene.device.start
    tip = np.array(start.tip_m) if start.tip_m is not None else None
    if tip is None and scene.device.slider is not None and start.q_rad is not None:
        slider = scene.device.slider
        tip = np.array(slider.origin_m) + slider.radius_m * start.q_rad[0] * np.array(slider.direction)
    if tip is None:
        return 0.0
    return abs(float((tip - np.array(scene.wall.point_m)) @ np.array(scene.wall.normal)))


def _depth(scene: Scene, stiffness: float, mass: float, speed: float, pull: float) -> float:
    """Deepest that the tip sinks into the wall [m]: pushed by the hand, or caught at speed."""
    if scene.wall is None or stiffness <= 0.0:
        return 0.0
    sag = mass * pull / stiffness
    deepest = sag + math.hypot(sag, speed * math.sqrt(mass / stiffness))  # all its energy into the spring
    person = scene.operator
    if isinstance(person, HandOperator):
        push = max((math.hypot(fx, fy) for _, fx, fy in person.force_s_n), default=0.0)
        (px, py), (nx, ny) = scene.wall.point_m, scene.wall.normal
        meant = max((px - x) * nx + (py - y) * ny for _, x, y in person.waypoints_s_m)
        hold = person.stiffness_n_per_m
        deepest = max(deepest, (push + hold * max(meant, 0.0)) / (hold + stiffness))
    return deepest
