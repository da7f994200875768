"""Sizes of the single effects of amplifiers, multipliers, differentiator, driver and temperature."""

from __future__ import annotations

import math
from collections.abc import Callable

from cosim.circuits.design_constants import Stated
from cosim.effects.effect import Cost, Size
from cosim.effects.scale import Scale, scale
from cosim.ngspice.deck import NOMINAL_C
from cosim.scene import Drive, Scene
from cosim.units import quantity


def gain_before(constants: Stated) -> float:
    """Return the voltage gain from the potentiometer to a multiplier's input, from the design constants.

    At full-scale gain, rated torque needs the angle i_rated kt gear / k_fs; the multiplier then gives
    w_rated, and with its control at full scale its input is that same voltage.
    """
    angle = constants.i_rated * constants.kt * constants.gear / constants.k_fs
    return constants.w_rated / (constants.v_rad * angle)


def driver_gain(constants: Stated) -> float:
    """Return the voltage gain of a driver: rated current through the winding at the rated input."""
    return constants.i_rated * max(constants.of("motor", "r"), default=0.0) / constants.w_rated


def newton_per_volt(constants: Stated, at: Scale) -> float:
    """Return the force per volt at a multiplier's output, from the design constants [N/V]."""
    return constants.i_rated * constants.kt * constants.gear / at.reach_m / constants.w_rated


def unstated(at: Scale, quantity: str) -> Size:
    """Return the size of what a vendor's model does not state: all that the motors can do."""
    return Size(at.limit_n, "N", at.limit_n, f"at the driver's limit: the part states no {quantity}", "bound")


def bent(role: str) -> Callable[[Scene, Stated], Cost]:
    """Return the cost of a bend in the characteristic of every part of a role: its elements', no points."""

    def cost(scene: Scene, constants: Stated) -> Cost:
        count = constants.count.get(role, 0)
        return Cost(0.0, 0, f"a bend in each of {count}")

    return cost


def slew(scene: Scene, constants: Stated) -> Size:
    """Return the delay of a stage that has to cross its full scale."""
    at, rate = scale(scene, constants), constants.of("opamp", "sr")
    if not rate:
        return unstated(at, "slew rate")
    late = constants.v_fs / min(rate)
    return Size(min(rate), "V/s", at.of_delay(late), "of slew rate", "k v tau, tau = v_fs / SR")


def saturation(scene: Scene, constants: Stated) -> Size:
    """Return the force that is missing where a multiplier's input exceeds what an op-amp can drive."""
    at, swing = scale(scene, constants), constants.of("opamp", "swing")
    if not swing:
        return unstated(at, "output swing")
    volts = gain_before(constants) * constants.v_rad * at.depth_m / at.reach_m
    lost = max(0.0, 1.0 - min(swing) / volts) if volts > 0.0 else 0.0
    force = at.capped(at.analog_n_per_m * at.depth_m * lost)
    return Size(
        min(swing),
        "V",
        force,
        f"of swing, {quantity(volts, 'V')} wanted",
        "k x (1 - swing / (G v_rad x / r))",
    )


def offset(scene: Scene, constants: Stated) -> Size:
    """Return what shifts: the equilibrium by follower and difference amplifier, the torque by the summer."""
    at, volts = scale(scene, constants), constants.of("opamp", "vos")
    if not volts:
        return unstated(at, "offset")
    vos = max(abs(each) for each in volts)
    angle = vos * (2.0 + 1.0 / gain_before(constants)) / constants.v_rad
    # the noise gain of the summing amplifier is below that of its multipliers' inputs, one each
    summed = vos * (1.0 + 2.0 * scene.joints) * newton_per_volt(constants, at)
    behind = driver_offset(scene, constants).force_n
    force = at.capped(at.analog_n_per_m * at.reach_m * angle + summed + behind)
    return Size(
        vos, "V", force, "of offset voltage",
        "k r V_os (2 + 1/G) / v_rad, and that of summing amplifier and driver",
    )  # fmt: skip


def driver_offset(scene: Scene, constants: Stated) -> Size:
    """Return what the driver's own offset drives through the winding."""
    at, volts, ohms = scale(scene, constants), constants.of("driver", "vos"), constants.of("motor", "r")
    if not volts or not ohms:
        return unstated(at, "offset")
    vos = max(abs(each) for each in volts)
    amperes = vos * (1.0 + driver_gain(constants)) / min(ohms)
    # its bias current makes less of it: 100 nA in some kOhm
    force = at.capped(2.0 * at.joints * amperes * constants.kt * constants.gear / at.reach_m)
    return Size(vos, "V", force, "of offset voltage", "V_os (1 + gain) / R, and as much for the bias current")


def vca_gain(scene: Scene, constants: Stated) -> Size:
    """Return a share of the analog wall's force."""
    at, share = scale(scene, constants), constants.of("vca", "scale")
    if not share:
        return unstated(at, "scale error")
    wall = at.analog_n_per_m * at.depth_m + at.analog_n_s_per_m * at.speed_m_per_s
    force = at.capped(wall * max(share) / 100.0)
    return Size(max(share), "%", force, "of scale error", "data sheet: share of the analog force")


def vca_offset(scene: Scene, constants: Stated) -> Size:
    """Return every multiplier's output offset, and what the input offsets let through at full scale."""
    at = scale(scene, constants)
    inside, outside = constants.of("vca", "vosin"), constants.of("vca", "vosout")
    if not inside or not outside:
        return unstated(at, "offset")
    volts = max(outside) + 2.0 * max(inside)
    force = at.capped(volts * 2.0 * scene.joints * newton_per_volt(constants, at))
    return Size(volts, "V", force, "at each multiplier's output", "V_os,out + 2 V_os,in, 2 n of them")


def vca_nonlinearity(scene: Scene, constants: Stated) -> Size:
    """Peaks of the cubic errors of X and Y and the feedthrough, at full scale."""
    at = scale(scene, constants)
    errors = [constants.of("vca", name) for name in ("nlx", "nly", "ft")]
    if not all(errors):
        return unstated(at, "nonlinearity")
    share = sum(max(each) for each in errors)
    force = at.capped(share / 100.0 * constants.v_fs * newton_per_volt(constants, at))
    return Size(share, "% of full scale", force, "of nonlinearity and feedthrough", "data sheet")


def corner(scene: Scene, constants: Stated) -> Size:
    """Damping that comes late; at most all of it."""
    at, late = scale(scene, constants), constants.numbers.get("der_delay_s", 0.0)
    force = at.capped(at.analog_n_s_per_m * at.speed_m_per_s)
    return Size(late, "s", force, "of delay in the damping", "at most B v, beyond the corner")


def corner_cost(scene: Scene, constants: Stated) -> Cost:
    """Two capacitors a joint."""
    return Cost(0.0, 2 * scene.joints, "two states and an op-amp a joint")


def undamped(scene: Scene) -> str:
    """Say that the scene differentiates nothing."""
    damped = scene.computer.analog_damping_n_s_per_m > 0.0 or any(scene.computer.joint_damping_n_m_s_per_rad)
    return "" if damped or scene.computer.law is not None else "no analog damping"


def limit(scene: Scene, constants: Stated) -> Size:
    """Return what the wall would ask beyond the driver's limit."""
    at = scale(scene, constants)
    wall = at.stiffness_n_per_m * at.depth_m
    damper = (at.analog_n_s_per_m + at.discrete_n_s_per_m) * at.speed_m_per_s
    force = max(0.0, wall + damper - at.limit_n)
    return Size(constants.i_limit, "A", force, "of current limit", "k x + B v - i_limit kt gear / r")


def temperature(scene: Scene, constants: Stated) -> Size:
    """Less torque constant, and in voltage drive less current."""
    at, rise = scale(scene, constants), scene.device.temperature_c - NOMINAL_C
    winding = constants.numbers.get("motor_r_tc", 0.0) if scene.effects.driver is Drive.VOLTAGE else 0.0
    share = abs(rise) * (abs(winding) + abs(constants.numbers.get("motor_kt_tc", 0.0)))
    force = at.capped(share * at.force_n)
    return Size(rise, "K", force, "of temperature rise", "F dT (copper's and the magnet's coefficients)")


def nominal(scene: Scene) -> str:
    """Say that the scene states no other temperature."""
    near = math.isclose(scene.device.temperature_c, NOMINAL_C, abs_tol=1e-12)
    return f"device.temperature_c is the nominal {NOMINAL_C:g} C" if near else ""
