"""The one block of memory that ngspice hands back to every compiled callback.

ngspice knows one user pointer; behind it lies a `STATE` record: mechanics, computer, DAC channels, events,
step control and counters of one lockstep run.
"""

from __future__ import annotations

import numpy as np

from cosim.circuits.decks import MOST_NODES
from cosim.loop.computer import COMPUTER, SAMPLE
from mech.records import LINKAGE, NMAX, OPERATOR, WORK

#: DAC channels of the largest board: u, ksp, ksd, cmd.
CHANNELS = 2 * NMAX + 2 * NMAX * NMAX
#: Multipliers of the largest board.
MULTIPLIERS = 2 * NMAX * NMAX
#: Samples that may be under way between the computer and the DACs (delay of several periods).
QUEUE = 16
#: An attempt may take so many times the Newton iterations that are predicted; the shipped scenes at every
#: level take less than a third of it (a test holds this).
PATIENCE = 30.0
#: V that no board has: rails of 100 V times the highest open-loop gains, 140 dB, are three decades below. In
#: ngspice a division by zero gives some 1e32, with which a loose tolerance can go on.
NO_VOLTAGE = 1e12

#: What is on its way from the computer to the DACs: a ring of samples.
_QUEUED = np.dtype(
    [
        ("volts", "f8", (QUEUE, CHANNELS)),
        ("time", "f8", QUEUE),  # s, when the gains change
        ("put", "i8"),  # samples ever put in
        ("taken", "i8", 2),  # and taken out, by group of channels (`dac_start`)
    ],
    align=True,
)
#: The X probes inside the board, which component noise acts through.
_PROBES = np.dtype(
    [
        ("count", "i8"),
        ("name", "i8", MULTIPLIERS),  # its hash, see `name_hash`
        ("input", "i8", MULTIPLIERS),
        ("sign", "f8", MULTIPLIERS),
    ],
    align=True,
)
#: Nodes that are watched or recorded: where ngspice keeps their values, and what became of them.
_NODES = np.dtype(
    [
        ("index", "i8", MOST_NODES),
        ("volts", "f8", MOST_NODES),  # at the last accepted point
        ("peak", "f8", MOST_NODES),
        ("limit", "f8", MOST_NODES),  # V, where an amplifier's output clips; inf where that is not known
        ("clipped", "f8", MOST_NODES),  # s spent there, by the accepted points
    ],
    align=True,
)
#: Outputs that hang at their limit while the device stands still (see spice/watch.py).
_HANGING = np.dtype(
    [
        ("limit", "f8", MOST_NODES),
        ("start", "f8", MOST_NODES),  # s, since when without a break
        ("volts", "f8", MOST_NODES),  # at the first moment that was long enough; 0 for none
        ("since", "f8", MOST_NODES),
        ("pins", "f8", (MOST_NODES, 2 * NMAX + CHANNELS)),
        ("wait", "f8"),
        ("quiet", "f8"),
    ],
    align=True,
)
#: Rows of results in memory, until they are drained.
_MEMORY = np.dtype([("address", "i8"), ("capacity", "i8"), ("used", "i8")], align=True)
#: Calls for the sources' values, and how many of them count as a crawl.
_CALLS = np.dtype(
    [
        ("count", "i8"),
        ("start", "i8"),  # before the first point: an operating point takes what it takes
        ("free", "f8"),  # allowed at once, a second, and a jump or knot
        ("per_s", "f8"),
        ("per_event", "f8"),
    ],
    align=True,
)
#: DAC channels: each ramps from `before` to `target` [V] over `settle` from `start`.
_DAC = np.dtype(
    [
        ("count", "i8"),
        ("first", "i8"),  # place of the first one in `STATE.out`
        ("channel", "i8", CHANNELS),
        ("before", "f8", CHANNELS),
        ("target", "f8", CHANNELS),
        ("start", "f8", 2),  # s; group 0: gains; group 1: equilibria and commands
        ("settle", "f8"),  # s
        ("skew", "f8"),  # s
        ("ramping", "i8"),
    ],
    align=True,
)
#: When the computer samples, and how late its values are.
_CLOCK = np.dtype(
    [
        ("jitter", "i8"),  # address of what is added to the instant of each tick [s], 0 without
        ("delay_ticks", "i8"),
        ("delay_s", "f8"),
        ("tick", "i8"),
        ("last_tick", "i8"),
    ],
    align=True,
)
#: Potentiometer noise: linear between grid ticks.
_NOISE = np.dtype(
    [
        ("address", "i8"),  # of the samples [ticks, n], 0 without noise
        ("rows", "i8"),
        ("dt", "f8"),
        ("tick", "i8"),
    ],
    align=True,
)
#: Potentiometer noise that belongs to the angle.
_POSITION_NOISE = np.dtype(
    [
        ("address", "i8"),  # of a table over one turn [points, n], 0 without
        ("points", "i8"),
        ("lo", "f8"),
        ("step", "f8"),
    ],
    align=True,
)
#: Component noise: linear between grid ticks, at the different X and at the pins cmd.
_COMPONENT = np.dtype(
    [
        ("address", "i8"),  # of the samples [ticks, X + n], 0 without noise
        ("rows", "i8"),
        ("dt", "f8"),
        ("tick", "i8"),
        ("inputs", "i8"),  # number of different X
        ("now", "f8", MULTIPLIERS + NMAX),  # values at the trial point
    ],
    align=True,
)
#: Instants at which the operator's force has a kink.
_KNOTS = np.dtype([("address", "i8"), ("count", "i8"), ("next", "i8")], align=True)
#: Step control.
_STEPS = np.dtype(
    [
        ("longest", "f8"),  # s
        ("first", "f8"),  # s, behind an event
        ("fresh", "f8"),  # s behind a jump over which rows show how the circuit settles; 0 without rows
        ("couple", "f8"),  # s, what the coupling's error allows
        ("pole", "f8"),  # s, what the mechanics' poles allow
        ("least", "f8"),  # s
        ("tol", "f8"),
        ("trapezoids", "i8"),  # whether ngspice integrates by them, and the linkage with it
        ("most", "i8"),  # points in one sampling period, before it counts as endless cutting of steps
    ],
    align=True,
)
#: Joints below `speed` [rad/s] at the samples for `time` [s] end the linear loop; 0: never.
_REST = np.dtype([("speed", "f8"), ("time", "f8"), ("moved", "f8"), ("rested", "i8")], align=True)

STATE = np.dtype(
    [
        ("running", "i8"),  # first word: 0 tells `accepted` that the values are of another analysis
        # mechanics at the last accepted point
        ("p", LINKAGE),
        ("known", LINKAGE),  # as the computer knows it
        ("op", OPERATOR),
        ("w", WORK),
        ("n", "i8"),
        ("coordinates", "i8"),  # n, or 2 n with shafts: q, v and a are then of joints and motors
        ("motor", "i8"),  # first coordinate of the motors, which encoders and the pins vel see: 0 or n
        ("t", "f8"),
        ("q", "f8", NMAX),
        ("v", "f8", NMAX),
        ("a", "f8", NMAX),
        ("a_old", "f8", NMAX),
        ("a_trial", "f8", NMAX),
        ("h_old", "f8"),
        ("history", "i8"),  # accelerations on the present smooth piece, 0 to 2 (see adams.py)
        ("used", "i8"),  # history behind the last step: which rule took it
        ("hold", "f8", NMAX),  # N m, what holds the joints at rest at the last accepted point, `spice`
        ("hold_old", "f8", NMAX),  # and at the one before
        ("tau", "f8", NMAX),
        ("tau_old", "f8", (2, NMAX)),  # at the last accepted point and the one before; with shafts only
        ("work", "f8", 6),  # J by worker, where the lockstep keeps account itself (shafts)
        ("torque_per_amp", "f8", NMAX),  # by joint
        ("gear", "f8"),
        # the trial point that ngspice is solving
        ("t_trial", "f8"),
        ("q_trial", "f8", NMAX),
        ("v_trial", "f8", NMAX),
        # EXTERNAL sources: first the potentiometers, then the speeds (if any), then the driven DAC channels
        ("out", "f8", 2 * NMAX + CHANNELS),
        ("speeds", "i8"),
        ("dac", _DAC),
        # the computer
        ("c", COMPUTER),
        ("x", SAMPLE),
        ("law_address", "i8"),  # a user's Python law, 0 for the built-in one
        ("clock", _CLOCK),
        ("queue", _QUEUED),
        ("noise", _NOISE),
        ("position_noise", _POSITION_NOISE),
        ("component", _COMPONENT),
        ("probe", _PROBES),
        ("knots", _KNOTS),
        # step control
        ("steps", _STEPS),
        ("b_emf", "f8", (NMAX, NMAX)),  # N m s/rad at the joints: what the motors' back-EMF brakes with
        ("column", "f8", NMAX),
        ("t_event", "f8"),
        ("announced", "i8"),
        ("t_end", "f8"),
        ("rest", _REST),
        # where ngspice's accepted values are
        ("time_index", "i8"),
        ("current_index", "i8", NMAX),
        ("nodes", "i8"),
        ("node", _NODES),
        ("hang", _HANGING),
        # rows of results
        ("rows", _MEMORY),
        ("columns", "i8"),
        ("nodes_recorded", "i8"),
        ("samples", _MEMORY),
        # Python called from compiled code
        ("drain_address", "i8"),
        ("breakpoint_address", "i8"),
        # counters and verdict
        ("points", "i8"),
        ("points_before", "i8"),  # up to the last sample
        ("rejected", "i8"),
        ("calls", _CALLS),
        ("discontinuities", "i8"),
        ("defect", "f8"),
        ("defect_max", "f8"),
        ("defect_sum", "f8"),
        ("fault", "i8"),
    ],
    align=True,
)


class Fault:
    """Why compiled code stopped the run (`STATE.fault`)."""

    NONE = 0
    NOT_FINITE = 1
    DIVERGED = 2
    STEP_COLLAPSED = 3
    SAMPLE_LOST = 4
    RAN_AWAY = 5
    STOPPED = 6
    CRAWLS = 7
