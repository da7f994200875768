"""Which pins of the board a scene drives. Imports no compiler: a plan is made without one."""

from __future__ import annotations

from cosim.circuits.decks import Drive
from cosim.scene import CommandPath, Method, MotorLevel, Scene


def channels(n: int) -> list[str]:
    """Names of the DAC channels of an n-joint board, in the order of the volts array."""
    joints = range(1, n + 1)
    pairs = [f"{i}{j}" for i in joints for j in joints]
    return (
        [f"u{j}" for j in joints]
        + [f"ksp{ij}" for ij in pairs]
        + [f"ksd{ij}" for ij in pairs]
        + [f"cmd{i}" for i in joints]
    )


def is_geometric(scene: Scene) -> bool:
    """Whether the control law adds the geometric stiffness: it bends with the links, and needs springs."""
    springs = scene.computer.method in (Method.CONTINUOUS, Method.COMBINED)
    built_in = scene.computer.law is None
    return scene.effects.geometric_stiffness and springs and built_in and not scene.is_slider


def drive(scene: Scene) -> Drive:
    """Pins that this scene moves; all others are held at 0 V."""
    computer, n = scene.computer, scene.joints
    analog = computer.method is not Method.DISCRETE
    discrete = computer.discrete_stiffness_n_per_m > 0 or computer.discrete_damping_n_s_per_m > 0
    own = computer.method is Method.JOINT_PD and any(computer.joint_damping_n_m_s_per_rad)
    damped = analog and (computer.analog_damping_n_s_per_m > 0 or own)
    by_cmd = discrete and (
        computer.command_path is CommandPath.CMD or computer.method in (Method.DISCRETE, Method.JOINT_PD)
    )
    user = computer.law is not None
    noisy = scene.effects.component_noise
    chosen = []
    for name in channels(n):
        diagonal = name[-1] == name[-2]
        if name.startswith("ksp"):
            used = analog and (computer.method is not Method.JOINT_PD or diagonal)
        elif name.startswith("ksd"):
            used = damped and (computer.method is not Method.JOINT_PD or diagonal)
        elif name.startswith("cmd"):
            # what comes behind the multipliers makes noise that is referred to these pins
            asked = by_cmd and computer.method is not Method.CONTINUOUS
            used = asked or noisy or is_geometric(scene)
        else:
            used = True
        if used or user:
            chosen.append(name)
    speeds = scene.effects.motor is not MotorLevel.IDEAL
    return Drive(joints=n, speeds=speeds, channels=tuple(chosen))
