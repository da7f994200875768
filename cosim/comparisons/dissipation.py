"""What a run heats: the motors' windings and the drivers' output stages."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cosim.circuits.decks import SUPPLY_V
from cosim.circuits.design_constants import Stated
from cosim.measures import time_mean
from cosim.results import Run


@dataclass(frozen=True)
class Dissipation:
    """Heat of one motor and of its driver over a run [W]: mean over time and largest."""

    joint: int
    motor_mean_w: float
    motor_peak_w: float
    driver_mean_w: float
    driver_peak_w: float


def dissipation(run: Run, stated: Stated) -> list[Dissipation]:
    """Return the heat in every motor and driver; nothing where the motor states no resistance.

    The winding makes I^2 R. The driver's output stands at V = R I + kt gear w, the voltage of the winding
    and of its back-EMF, and passes I from the supply of its sign: (V_supply - V) I, with both signs reversed
    for a negative current. What the inductance stores comes back and is left out; a driver at rest makes
    its quiescent heat besides, which belongs to no run.
    """
    resistance = stated.of("motor", "r")
    if not resistance:
        return []
    ohm = max(resistance)
    t = np.asarray(run.signals["time"])
    per_amp = stated.torques_per_amp(run.scene.joints)
    dissipations = []
    for joint in range(1, run.scene.joints + 1):
        current = np.asarray(run.signals[f"imot{joint}"])
        volts = ohm * current + per_amp[joint - 1] * np.asarray(run.signals[f"v{joint}"])
        motor = ohm * current**2
        driver = np.abs(current) * (SUPPLY_V - volts * np.sign(current))
        dissipations.append(
            Dissipation(
                joint,
                time_mean(t, motor),
                float(motor.max()),
                time_mean(t, driver),
                float(driver.max()),
            )
        )
    return dissipations
