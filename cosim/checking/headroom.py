"""How near every amplifier comes to its limit when the board does what it is made for."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

from cosim.checking.probed_board import ProbedBoard
from cosim.checking.signal_paths import LOW_HZ
from cosim.circuits.design_constants import DesignConstants
from cosim.circuits.extraction.swing import Swing as MeasuredSwing
from cosim.circuits.extraction.swing import SwingFrom
from cosim.errors import CosimError

SOFT_N_PER_M = 100.0
"""The softer of the two stiffnesses at which rated torque must leave headroom (the paper's k_dp)."""


@dataclass(frozen=True)
class Case:
    """A way to reach rated torque.

    Attributes
    ----------
    name : in words
    deflection_rad : of the joint against its equilibrium; ``None`` if the gain would pass full scale
    current_a : least current that it makes in a motor
    """

    name: str
    deflection_rad: float | None
    current_a: float | None


@dataclass(frozen=True)
class Swing:
    """The largest output of one amplifier over all cases.

    Attributes
    ----------
    path, part, node : the amplifier and its output
    limit_v : output limit that its part states, or that was measured of it; ``None`` where it is not known
    limit_from : which of both (`SwingFrom`); empty where it is not known
    peak_v : largest magnitude
    case : in which it occurs
    """

    path: str
    part: str
    node: str
    limit_v: float | None
    peak_v: float
    case: str
    limit_from: str = ""

    @property
    def headroom_percent(self) -> float | None:
        """How much of the limit is left [%]."""
        return None if self.limit_v is None else 100.0 * (1.0 - self.peak_v / self.limit_v)


@dataclass(frozen=True)
class Speed:
    """Joint speed at which the first amplifier clips with the damper at full scale."""

    joint: int
    speed_rad_per_s: float
    path: str


@dataclass(frozen=True)
class Headroom:
    """All of it; `limits_a` are the motors' currents with everything driven as far as the DACs go."""

    cases: tuple[Case, ...]
    swings: tuple[Swing, ...]
    speeds: tuple[Speed, ...]
    limits_a: tuple[float | None, ...]


def measure_headroom(
    bench: ProbedBoard, constants: DesignConstants, measured: Mapping[str, MeasuredSwing]
) -> Headroom:
    """Deflect one joint at a time, both ways, through one spring at a time, to rated torque.

    `measured` are the limits of amplifiers whose parts state none, by instance path.
    """
    known = _known(bench, measured)
    k_soft = SOFT_N_PER_M * constants.r_tip**2
    rated = constants.i_rated * constants.kt * constants.gear
    reach = constants.dac_v / constants.v_rad
    middle, end = "", " at the end of the DAC's range"
    plans = [(f"k_fs{end if at else middle}", constants.k_fs, at) for at in (0.0, reach)]
    plans.insert(1, (f"{SOFT_N_PER_M:g} N/m", k_soft, 0.0))
    cases, peaks = [], dict[str, tuple[float, str]]()
    for name, k, at in plans:
        if k > constants.k_fs:
            cases.append(Case(name, None, None))
            continue
        least = float("inf")
        for i, j, sign in _ways(bench.joints):
            bench.hold_only(
                {
                    f"ksp{i}{j}": constants.v_fs * k / constants.k_fs,
                    f"u{j}": sign * at * constants.v_rad,
                    f"pot{j}": sign * (at - rated / k),
                }
            )
            point = bench.operating_point()
            least = min(least, sign * point[f"imot{i}"])
            for node in bench.nodes:
                if abs(point[node]) > peaks.get(node, (-1.0, ""))[0]:
                    peaks[node] = abs(point[node]), name
        cases.append(Case(name, rated / k, least))
    bench.hold_only({})
    return Headroom(
        tuple(cases),
        _swings(bench, peaks, known),
        _speeds(bench, constants, known),
        _limits(bench, constants),
    )


def _ways(joints: int) -> Iterator[tuple[int, int, float]]:
    each = range(1, joints + 1)
    return ((i, j, sign) for i in each for j in each for sign in (1.0, -1.0))


def _known(bench: ProbedBoard, measured: Mapping[str, MeasuredSwing]) -> dict[str, MeasuredSwing]:
    """Return the output limits that are known, stated ones first, by instance path."""
    swings = dict(measured)
    for a in bench.board.amplifiers:
        limit = bench.constant(a.swing_param) if a.swing_param else None
        if limit is not None:
            swings[a.path] = MeasuredSwing(limit, SwingFrom.STATED)
    return swings


def _speeds(
    bench: ProbedBoard, constants: DesignConstants, known: Mapping[str, MeasuredSwing]
) -> tuple[Speed, ...]:
    """Scale each amplifier's answer to a slow ramp, the quadrature part as w -> 0, up to its limit."""
    speeds = []
    limits = {a.path: (a.out_node, known[a.path].limit_v) for a in bench.board.amplifiers if a.path in known}
    for j in range(1, bench.joints + 1):
        bench.hold_only({f"ksd{j}{j}": constants.v_fs})
        answer = bench.response(f"pot{j}", f"lin 1 {LOW_HZ!r} {LOW_HZ!r}")
        reached = [
            Speed(j, limit * 2 * math.pi * LOW_HZ / abs(answer[node][0].imag), path)
            for path, (node, limit) in limits.items()
            if answer[node][0].imag != 0.0
        ]
        if reached:
            speeds.append(min(reached, key=lambda speed: speed.speed_rad_per_s))
    bench.hold_only({})
    return tuple(speeds)


def _swings(
    bench: ProbedBoard, peaks: dict[str, tuple[float, str]], known: Mapping[str, MeasuredSwing]
) -> tuple[Swing, ...]:
    swings = []
    for a in bench.board.amplifiers:
        limit, source = (known[a.path].limit_v, known[a.path].source) if a.path in known else (None, "")
        swings.append(Swing(a.path, a.part, a.out_node, limit, *peaks[a.out_node], str(source)))
    return tuple(swings)


def _limits(bench: ProbedBoard, constants: DesignConstants) -> tuple[float | None, ...]:
    """Return each motor's current with command and spring at the end of the DACs' range."""
    limits: list[float | None] = []
    for i in range(1, bench.joints + 1):
        full = constants.dac_v
        bench.hold_only({f"cmd{i}": full, f"ksp{i}{i}": constants.v_fs, f"u{i}": full})
        try:
            limits.append(bench.operating_point()[f"imot{i}"])
        except CosimError:  # a clipped board need not have an operating point that Newton finds
            limits.append(None)
    bench.hold_only({})
    return tuple(limits)
