"""Columns of the studies' tables that pictures look up: each heading is written here, once."""

from __future__ import annotations

from typing import Self

__all__ = ["Column"]


class Column(str):
    """The heading of a column, ``period [ms]``, which knows its key, label and unit.

    A table's columns go by their headings, in memory and on disk: a column is its heading.

    Examples
    --------
    >>> PERIOD.key, PERIOD.label, PERIOD.unit, PERIOD == "period [ms]"
    ('period', 'period', 'ms', True)
    """

    __slots__ = ("key", "label", "unit")
    key: str
    label: str
    unit: str

    def __new__(cls, key: str, label: str, unit: str = "") -> Self:
        """Return the column; of a number without a unit, and of words, the heading is the label."""
        column = super().__new__(cls, f"{label} [{unit}]" if unit else label)
        column.key, column.label, column.unit = key, label, unit
        return column

    def __reduce__(self) -> tuple[type[Column], tuple[str, str, str]]:
        """Return what pickle makes it from."""
        return Column, (self.key, self.label, self.unit)


ABBOTT_OKAMURA = Column("abbott_okamura", "Abbott, Okamura", "N/m")
ACCELERATION = Column("acceleration", "acceleration", "m/s^2")
ALL_OF = Column("all_of", "more effects, of")
ALONG_THE_WALL = Column("along_the_wall", "along the wall", "mm")
ANALOG_STIFFNESS = Column("analog_stiffness", "analog stiffness", "N/m")
AS_A_RULE = Column("as_a_rule", "as a rule", "%")
AT_BEST = Column("at_best", "at best", "%")
CIRCLE_ENERGY = Column("circle_energy", "circle", "uJ")
COMPENSATED_WORST_DIRECTION = Column("compensated_worst_direction", "compensated, worst direction", "%")
CONTINUOUS_FORCE = Column("continuous_force", "force, continuous", "N")
CORNER = Column("corner", "corner", "Hz")
CURL = Column("curl", "curl", "N/m")
DAMPING_C = Column("damping_c", "c", "N s/m")
DAMPING_SHARE = Column("damping_share", "B/c of the damper")
DAMPING_SHARE_OF_BOTH = Column("damping_share_of_both", "B/c of both")
DELAY = Column("delay", "delay", "us")
DEPTH = Column("depth", "depth", "mm")
DISPLAYED = Column("displayed", "displayed", "N/m")
DIOLAITI_BETA_1_2 = Column("diolaiti_beta_1_2", "Diolaiti, beta = 1/2", "N/m")
DIOLAITI_LARGE_CYCLE = Column("diolaiti_large_cycle", "Diolaiti, large cycle", "N/m")
DIOLAITI_SIGMA_1_2 = Column("diolaiti_sigma_1_2", "Diolaiti, sigma = 1/2", "N/m")
DRAG_OF_JOINT_PD = Column("drag_of_joint_pd", "joint PD, F_t/F_n")
DRAG_OF_MISMATCH = Column("drag_of_mismatch", "mismatch, F_t/F_n")
DRIVER_BANDWIDTH = Column("driver_bandwidth", "driver's gain-bandwidth", "Hz")
ENERGY_CLOSED_FORM = Column("energy_closed_form", "k (v T)^2 / 2", "mJ")
CONTACT_ENERGY = Column("contact_energy", "energy of the whole contact, mean", "mJ")
ERROR_FORCE = Column("error_force", "error", "N")
ERROR_HALF_WAY = Column("error_half_way", "J half way, error", "%")
ERROR_OF_THE_POSE = Column("error_of_the_pose", "J of the pose, error", "%")
ERROR_OVER_LIMIT = Column("error_over_limit", "error / limit")
ERROR_PERCENT = Column("error_percent", "error", "%")
ETA_OVER_LIMIT = Column("eta_over_limit", "eta / limit")
EXACT_BORDER = Column("exact_border", "exact border", "N/m")
FORCE_IN_THE_LOOP_RMS = Column("force_in_the_loop_rms", "force in the loop, rms", "N")
FORCE_RMS = Column("force_rms", "force", "N rms")
FREE_AIR = Column("free_air", "free air", "N s/m")
FREQUENCY = Column("frequency", "frequency", "Hz")
FREQUENCY_F = Column("frequency_f", "f", "Hz")
FREQUENCY_OVER_PI_T = Column("frequency_over_pi_t", "frequency over pi/T")
FULL_SCALE_STIFFNESS = Column("full_scale_stiffness", "full-scale stiffness, any direction", "N/m")
GIL_HULIN = Column("gil_hulin", "Gil, Hulin", "N/m")
HELD_NOISE = Column("held_noise", "white, contact held", "N rms")
IDEAL_OF = Column("ideal_of", "circuit ideal, of")
ONSET_JUMP = Column("onset_jump", "jump at the onset, mean", "N")
JUMP_CLOSED_FORM = Column("jump_closed_form", "k v T", "N")
LARGEST_JUMP = Column("largest_jump", "largest jump of the contact, mean", "N")
LEAST_EIGENVALUE = Column("least_eigenvalue", "least eigenvalue", "mN m/rad")
LIMIT_BY_SUM = Column("limit_by_sum", "practical limit b/sum", "N/m")
LIMIT_BY_TAU = Column("limit_by_tau", "practical limit k = b/tau", "N/m")
NEEDED_OVER_CLOSED_FORM = Column("needed_over_closed_form", "needed over closed form")
NORMAL_FORCE = Column("normal_force", "normal force", "N")
ONSET_CLOSED_FORM = Column("onset_closed_form", "its closed form", "mJ")
PASSIVE = Column("passive", "passive (Colgate, Schenkel)", "N/m")
PASSIVE_STIFFNESS = Column("passive_stiffness", "passive stiffness", "N/m")
PERIOD = Column("period", "period", "ms")
PHASES_THAT_REST = Column("phases_that_rest", "phases that rest")
PRELOAD = Column("preload", "preload", "N")
Q1 = Column("q1", "q1", "rad")
Q2 = Column("q2", "q2", "rad")
REACH = Column("reach", "reach", "m")
SAMPLING_PERIOD = Column("sampling_period", "T", "ms")
SHARE_AT_REST = Column("share_at_rest", "share at rest")
SHARE_OF_VISCOSITY = Column("share_of_viscosity", "of b over poses")
SHIFT_WORST_DIRECTION = Column("shift_worst_direction", "shift, worst direction", "%")
SPRING_ENERGY = Column("spring_energy", "-k x(0)^2/2", "mJ")
STABLE_SPRING_UP_TO = Column("stable_spring_up_to", "stable spring up to", "N/m")
STIFFNESS = Column("stiffness", "stiffness", "N/m")
STIFFNESS_K = Column("stiffness_k", "k", "N/m")
STIFFNESS_SHARE = Column("stiffness_share", "K/k of the spring")
STIFFNESS_SHARE_OF_BOTH = Column("stiffness_share_of_both", "K/k of both")
SUM_OF_DELAYS = Column("sum_of_delays", "sum of delays", "us")
SUM_OF_TIME_CONSTANTS = Column("sum_of_time_constants", "sum(tau)", "us")
TAKEN_UP = Column("taken_up", "taken up", "mJ")
TANGENTIAL_FORCE = Column("tangential_force", "tangential force", "N")
TIME = Column("time", "time", "s")
VISCOSITY = Column("viscosity", "viscosity b", "N s/m")
VISCOSITY_AT_THE_WALL = Column("viscosity_at_the_wall", "b at the wall's pose", "N s/m")
VISCOSITY_B = Column("viscosity_b", "b", "N s/m")
WALL_IMPEDANCE = Column("wall_impedance", "wall", "N s/m")
WIDTH = Column("width", "width", "dB")
X = Column("x", "x", "m")
Y = Column("y", "y", "m")
