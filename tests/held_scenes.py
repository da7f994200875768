"""Scenes in held contact, and the circuits that the exact map of a period is made with."""

from linear_runs import CONSTANTS, ideal, lagging
from support import scene_of, slider

from cosim.analysis.held_contact import HeldContact
from cosim.circuits.linear_circuit import LinearCircuit
from cosim.scene import Scene

RADIUS = 0.1333


def at_wall(scene: Scene, circuit: LinearCircuit) -> HeldContact:
    """Return the contact at the wall's point of a scene with the constants of the tests' board."""
    return HeldContact.at_wall(scene, CONSTANTS, circuit)


HELD = {
    "seed": 3,
    "computer": {
        "period_s": 0.01, "method": "combined", "analog_stiffness_n_per_m": 100.0,
        "discrete_stiffness_n_per_m": 80.0, "analog_damping_n_s_per_m": 1.0,
    },
    "device": {
        "slider": {"mass_kg": 0.1, "viscous_n_m_s": 5e-4},
        "start": {"q_rad": [-0.05]},
        "potentiometer": {"noise_rad": 0.003, "noise_bandwidth_hz": 150.0},
    },
    "operator": {
        "type": "hand", "mass_kg": 0.3, "damping_n_s_per_m": 6.0, "stiffness_n_per_m": 100.0,
        "waypoints_s_m": [[0.0, 0.0, -0.02]],
    },
    "effects": {"viscous": True, "motor": "emf", "pot_noise": "white", "operator_dynamics": True},
    "solver": {"model": "ideal"},
}  # fmt: skip


LATE = {
    "effects": {"delay": True, "dac_settling": True, "dac_skew": True},
    "computer": {
        "discrete_damping_n_s_per_m": 0.5, "delay_periods": 1, "delay_fraction": 0.3,
        "dac": {"bits": 32, "settling_s": 1e-3, "skew_s": 5e-4},
    },
}  # fmt: skip


SLOW = {
    "effects": {"delay": True, "dac_settling": True, "dac_skew": True},
    "computer": {"delay_fraction": 0.8, "dac": {"bits": 32, "settling_s": 13e-3, "skew_s": 5e-3}},
    "device": {"potentiometer": {"noise_bandwidth_hz": 20.0}},
}


def circuit_of_kind(kind):
    return ideal(1) if kind == "ideal" else lagging(ideal(1), 2e3, 3e3)


def carriage(folder, period, mass, viscous, **computer):
    """A carriage against a wall, all damping in its bearings."""
    tables = slider(
        computer={
            "period_s": period, "method": "discrete", "analog_stiffness_n_per_m": 0.0,
            "discrete_stiffness_n_per_m": 1.0, **computer,
        },
        device={"slider": {"mass_kg": mass, "viscous_n_m_s": viscous * RADIUS**2}},
        effects={"viscous": viscous > 0.0, "delay": True},
    )  # fmt: skip
    return scene_of(folder, tables)
