"""Memory layout shared by the compiled kernels, their Python interface and callers in C.

Every record is passed as ``arr[0]`` of a structured array with one element, so that a compiled
callback can rebuild it from a bare address. SI units throughout, angles in radians.
"""

from enum import IntEnum

import numpy as np

__all__ = ["KNOTS", "LINKAGE", "NMAX", "OPERATOR", "WORK", "OperatorKind", "Touch", "new_work"]

NMAX = 6
"""Most coordinates: joints of a chain, or joints and motors where shafts lie between them."""

KNOTS = 256
"""Most rows of an operator's waypoint table, and of its force table."""


class OperatorKind(IntEnum):
    """Who holds the fingertip."""

    NONE = 0
    MASS = 1
    HAND = 2
    USER = 3


class Touch(IntEnum):
    """What an end stop does to a joint, where contacts are located events; negative at the lower stop."""

    FREE = 0
    PUSHED = 1
    INSIDE = 2
    """In the stop, on the way out so fast that the stop does not push."""
    RESTING = 3
    """On a stop that does not give."""


# Chain: the links' absolute angles are phi_i = q_1 + ... + q_i. With d_ki = length_i for i < k and
# com_k for i = k,
#     couple_ij = sum_k mass_k d_ki d_kj (+ inertia_i on the diagonal)     [kg m^2]
#     moment_i  = sum_k mass_k d_ki                                        [kg m]
# hold all there is to know about the masses of a planar chain.
# Slider: one joint, a drum of radius length[0]; tip = origin + length[0] q direction.
LINKAGE = np.dtype(
    [
        ("n", np.int64),
        ("slider", np.int64),
        # Effects in force: 0 skips the work.
        ("coriolis", np.int64),
        ("heavy", np.int64),
        ("viscous_on", np.int64),
        ("coulomb_on", np.int64),
        ("stops_on", np.int64),
        ("shaft_on", np.int64),
        ("backlash_on", np.int64),
        ("origin", np.float64, (2,)),  # m
        ("direction", np.float64, (2,)),  # unit vector, slider only
        ("gravity", np.float64, (2,)),  # m/s^2, zero when off
        ("length", np.float64, (NMAX,)),  # m
        ("couple", np.float64, (NMAX, NMAX)),  # kg m^2
        ("moment", np.float64, (NMAX,)),  # kg m
        ("armature", np.float64, (NMAX,)),  # kg m^2 at the joint: rotor inertia times gear^2
        ("viscous", np.float64, (NMAX,)),  # N m s
        ("coulomb", np.float64, (NMAX,)),  # N m
        ("coulomb_speed", np.float64),  # rad/s, width of the tanh
        ("stop_low", np.float64, (NMAX,)),  # rad
        ("stop_high", np.float64, (NMAX,)),  # rad
        ("stop_stiffness", np.float64),  # N m/rad
        ("stop_damping", np.float64),  # N m s/rad^2: torque per depth and speed
        # Stops that do not give: speed after an impact over speed before; stiffness and damping are unused.
        ("rigid", np.int64),
        ("restitution", np.float64),
        # Motors behind shafts: coordinates n to 2 n; their inertia is then here and not in `armature`.
        ("rotor", np.float64, (NMAX,)),  # kg m^2 at the joint
        ("shaft_stiffness", np.float64, (NMAX,)),  # N m/rad
        ("shaft_damping", np.float64, (NMAX,)),  # N m s/rad
        ("half_gap", np.float64, (NMAX,)),  # rad
    ],
    align=True,
)

OPERATOR = np.dtype(
    [
        ("kind", np.int64),
        ("callback", np.int64),  # address of void f(t, x, y, vx, vy, double force[2]), kind USER
        ("paths", np.int64),  # rows in use of `path`
        ("forces", np.int64),  # rows in use of `force`
        ("mass", np.float64),  # kg, moves with the fingertip
        ("falls", np.float64),  # 1: gravity pulls the mass; 0: the arm carries its own weight
        ("damping", np.float64),  # N s/m
        ("stiffness", np.float64),  # N/m
        ("path", np.float64, (KNOTS, 3)),  # s, m, m
        ("force", np.float64, (KNOTS, 3)),  # s, N, N
    ],
    align=True,
)

# What a time loop locates as events. 0: `kernels.dynamics` decides by the state alone.
_MODE = np.dtype(
    [
        ("located", np.int64),  # friction; 0: a smooth step
        ("stops_located", np.int64),  # 0: a stop's torque is a function of the angle
        ("latched", np.int64),  # gears' flanks (`mech.shaft`)
    ],
    align=True,
)
# Discrete state of the gears.
_FLANK = np.dtype(
    [
        ("tooth", np.int64, (NMAX,)),  # flank that carries, -1, 0 or +1
        ("slack", np.float64, (NMAX,)),  # rad, twist of the shaft when its flank was left
        ("left", np.float64, (NMAX,)),  # s, then
    ],
    align=True,
)
# Discrete state of friction and stops, and what holds a held joint.
_CONTACT = np.dtype(
    [
        ("slide", np.int64, (NMAX,)),  # way a joint slips, +1 or -1; 0: held
        ("touch", np.int64, (NMAX,)),  # `Touch`, its sign the stop's: -1 the lower, +1 the upper
        ("holding", np.int64),  # number of joints held
        ("held", np.int64, (NMAX,)),
        ("hold", np.float64, (NMAX,)),  # N m, torque that holds a held joint
    ],
    align=True,
)
# Absolute angles and rates of the links.
_POSE = np.dtype(
    [
        ("cos", np.float64, (NMAX,)),
        ("sin", np.float64, (NMAX,)),
        ("rate", np.float64, (NMAX,)),  # rad/s
    ],
    align=True,
)
_SCRATCH = np.dtype([("factor", np.float64, (NMAX, NMAX)), ("reduced", np.float64, (NMAX, NMAX))], align=True)

# What `kernels.dynamics` leaves behind for the caller, and its scratch memory.
WORK = np.dtype(
    [
        ("r", np.float64, (2,)),  # m, fingertip
        ("rdot", np.float64, (2,)),  # m/s
        ("f_op", np.float64, (2,)),  # N, operator on device, with weight and inertia of its mass
        ("f_drive", np.float64, (2,)),  # N, the same without weight and inertia
        ("jac", np.float64, (2, NMAX)),  # m/rad
        ("tau_visc", np.float64, (NMAX,)),  # N m, on the joint: opposes motion
        ("tau_coul", np.float64, (NMAX,)),  # N m, on the joint
        ("tau_stop", np.float64, (NMAX,)),  # N m, on the joint
        ("tau_shaft", np.float64, (NMAX,)),  # N m, motor on joint
        ("tau_loss", np.float64, (NMAX,)),  # N m, the part of it that stores no energy
        ("mode", _MODE),
        ("flank", _FLANK),
        ("contact", _CONTACT),
        ("mass", np.float64, (NMAX, NMAX)),  # kg m^2, joint space, with rotors and operator's mass
        ("bias", np.float64, (NMAX,)),  # N m, Coriolis and gravity of the device, without operator's weight
        ("pose", _POSE),
        ("scratch", _SCRATCH),
    ],
    align=True,
)


def new_work() -> np.ndarray:
    """Return zeroed working memory for `kernels.dynamics`, shape (1,), dtype `WORK`."""
    return np.zeros(1, WORK)
