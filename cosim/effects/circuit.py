"""Effects of the circuit: the levels of its parts, and what makes up the highest of them."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable

from cosim.circuits.design_constants import Stated
from cosim.effects import amplifier_errors
from cosim.effects.amplifier_errors import driver_gain, gain_before, unstated
from cosim.effects.effect import ALL, DYNAMIC, SPICE, Cost, Effect, Size
from cosim.effects.scale import Scale, scale
from cosim.scene import Level, Scene
from cosim.units import quantity

#: Op-amps between potentiometer and summing point, and the summing amplifier.
_STAGES = 3


def _opamp(scene: Scene, constants: Stated) -> Size:
    at, rate, gain = scale(scene, constants), constants.of("opamp", "gbw"), constants.of("opamp", "aol")
    if not rate or not gain:
        return unstated(at, "aol" if rate else "gbw")
    noise_gain = _STAGES * (1.0 + gain_before(constants))
    delay = noise_gain / (2.0 * math.pi * min(rate))
    force, text = at.of_delay(delay) + noise_gain / min(gain) * at.force_n, "of delay"
    if scene.effects.opamp is Level.FULL:
        parts = (amplifier_errors.slew, amplifier_errors.saturation, amplifier_errors.offset)
        force, text = force + _sum(parts, scene, constants), "of delay; slew, saturation and offset"
    source = "k v tau + F n / A0, tau = n / (2 pi GBW), n the noise gains"
    return Size(delay, "s", at.capped(force), text, source)


def _sum(parts: Iterable[Callable[[Scene, Stated], Size]], scene: Scene, constants: Stated) -> float:
    """Return the force of the single effects that a level brings along [N]."""
    return sum(part(scene, constants).force_n for part in parts)


def _vca(scene: Scene, constants: Stated) -> Size:
    at, rate = scale(scene, constants), constants.of("vca", "bw")
    if not rate:
        return unstated(at, "bandwidth")
    delay = 1.0 / (2.0 * math.pi * min(rate))
    force, text = at.of_delay(delay), "of delay"
    if scene.effects.vca is Level.FULL:
        parts = (amplifier_errors.vca_gain, amplifier_errors.vca_offset, amplifier_errors.vca_nonlinearity)
        force += _sum(parts, scene, constants)
        text = "of delay; gain error, offset, nonlinearity"
    return Size(delay, "s", at.capped(force), text, "k v tau, tau = 1 / (2 pi f); data sheet")


def _driver_level(scene: Scene, constants: Stated) -> Size:
    at = scale(scene, constants)
    rate, open_loop = constants.of("driver", "gbw"), constants.of("driver", "aol")
    if not rate or not open_loop:
        return unstated(at, "aol" if rate else "gbw")
    noise_gain = 1.0 + driver_gain(constants)
    delay = noise_gain / (2.0 * math.pi * min(rate))
    force, text = at.of_delay(delay) + noise_gain / min(open_loop) * at.force_n, "of delay"
    if scene.effects.driver_level is Level.FULL:
        parts = (amplifier_errors.limit, amplifier_errors.driver_offset)
        force, text = force + _sum(parts, scene, constants), "of delay; limit and offset"
    source = "k v tau + F n / A0, tau = n / (2 pi GBW), n the noise gain"
    return Size(delay, "s", at.capped(force), text, source)


def back_emf(constants: Stated, at: Scale) -> float:
    """Return the viscosity [N s/m] that shorted motors give the tip: (kt gear / r)^2 / R each."""
    r = constants.of("motor", "r")
    return at.joints * (constants.kt * constants.gear / at.reach_m) ** 2 / min(r) if r else 0.0


def _motor(scene: Scene, constants: Stated) -> Size:
    at, r, coil = scale(scene, constants), constants.of("motor", "r"), constants.of("motor", "l")
    if not r:
        return unstated(at, "resistance")
    lag = max(coil, default=0.0) / min(r)
    b = back_emf(constants, at)
    force = at.capped(b * at.speed_m_per_s) + at.of_delay(lag)
    return Size(
        b,
        "N s/m",
        force,
        f"of back-EMF, and a lag of {quantity(lag, 's', 2)}",
        "(kt gear / r)^2 v / R + k v L/R",
    )


def _drive(scene: Scene, constants: Stated) -> Size:
    at = scale(scene, constants)
    b = back_emf(constants, at)
    return Size(
        b, "N s/m", at.capped(b * at.speed_m_per_s), "of back-EMF less at the tip", "(kt gear / r)^2 v / R"
    )


def _track(scene: Scene, constants: Stated) -> Size:
    at = scale(scene, constants)
    bias, track = constants.of("opamp", "ib"), constants.numbers.get("pot_r", 0.0)
    ohms = constants.numbers.get("pot_rw", 0.0) + track / 4.0
    rad = ohms * max((abs(each) for each in bias), default=0.0) / constants.v_rad
    force = at.capped(at.analog_n_per_m * at.reach_m * rad)
    return Size(ohms, "Ohm", force, "of track and wiper before a follower", "k r R i_b / v_rad")


def _states(role: str, gbw: int, full: int) -> Callable[[Scene, Stated], Cost]:
    """Return the cost of a level that adds so many states to each part of a role."""

    def cost(scene: Scene, constants: Stated) -> Cost:
        deep = getattr(scene.effects, "driver_level" if role == "driver" else role) is Level.FULL
        each = full if deep else gbw
        count = constants.count.get(role, 0)
        words = f"{each} state{'s' if each != 1 else ''} for each of {count}"
        return Cost(0.0, each * count, words)

    return cost


def _motor_cost(scene: Scene, constants: Stated) -> Cost:
    return Cost(0.0, scene.joints, "back-EMF couples speeds; one state a motor at full")


def _drive_cost(scene: Scene, constants: Stated) -> Cost:
    return Cost(0.0, scene.joints, "one state a joint for its compensation")


#: In the order in which a plan lists them.
CIRCUIT = (
    Effect("opamp", "ideal", ("gbw", "full"), "netlist", DYNAMIC, size=_opamp, cost=_states("opamp", 1, 3)),
    Effect(
        "opamp_slew", False, (True,), "netlist", SPICE, size=amplifier_errors.slew,
        cost=amplifier_errors.bent("opamp"), requires=("opamp",),
    ),
    Effect(
        "opamp_saturation", False, (True,), "netlist", SPICE, size=amplifier_errors.saturation,
        cost=amplifier_errors.bent("opamp"), requires=("opamp",),
    ),
    Effect("opamp_offset", False, (True,), "netlist", ALL, size=amplifier_errors.offset),
    Effect("vca", "ideal", ("gbw", "full"), "netlist", DYNAMIC, size=_vca, cost=_states("vca", 1, 1)),
    Effect("vca_gain_error", False, (True,), "netlist", ALL, size=amplifier_errors.vca_gain),
    Effect("vca_offset", False, (True,), "netlist", ALL, size=amplifier_errors.vca_offset),
    Effect("vca_nonlinearity", False, (True,), "netlist", SPICE, size=amplifier_errors.vca_nonlinearity),
    Effect(
        "differentiator", "ideal", ("corner",), "netlist", DYNAMIC,
        size=amplifier_errors.corner, cost=amplifier_errors.corner_cost, lacks=amplifier_errors.undamped,
    ),
    Effect(
        "driver_level", "ideal", ("gbw", "full"), "netlist", DYNAMIC,
        size=_driver_level, cost=_states("driver", 1, 2),
    ),
    Effect(
        "driver_limit", False, (True,), "netlist", ALL, size=amplifier_errors.limit,
        cost=amplifier_errors.bent("driver"),
    ),
    Effect(
        "motor", "ideal", ("full", "emf"), "netlist", ALL,
        size=_motor, cost=_motor_cost, at_full=DYNAMIC,
    ),
    Effect("driver", "voltage", ("current",), "netlist", ALL, size=_drive, cost=_drive_cost),
    Effect("potentiometer", "ideal", ("full",), "netlist", ALL, size=_track, at_full=ALL),
    Effect(
        "temperature", False, (True,), "netlist", ALL, size=amplifier_errors.temperature,
        lacks=amplifier_errors.nominal, keys=("device.temperature_c",),
    ),
)  # fmt: skip

#: Single effects that parts carry as a parameter of their name, and the roles whose parts must.
CARRIED = {
    "opamp_slew": ("opamp",),
    "opamp_saturation": ("opamp",),
    "opamp_offset": ("opamp", "driver"),
    "vca_gain_error": ("vca",),
    "vca_offset": ("vca",),
    "vca_nonlinearity": ("vca",),
    "driver_limit": ("driver",),
}
