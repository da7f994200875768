"""Drop test (Figs 12 to 14): the stiffest floor on which a mass that is dropped comes to rest.

For each sampling period the discrete stiffness is scanned geometrically from below; at each stiffness the
mass falls once for every phase of the samples against the impact. The answer is the first stiffness at which
fewer than a stated share of the phases comes to rest; the share need not fall monotonically, so its band is
reported too. The exact limit of the held contact (`cosim.analysis.stability`) stands beside it: a bouncing
mass may give up a little below it.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from functools import partial
from typing import Annotated, Any

import numpy as np

from cosim.analysis.extracted import circuit_of
from cosim.analysis.held_contact import HeldContact
from cosim.analysis.impedance import impedance
from cosim.analysis.stiffness_limits import limits as limits_of
from cosim.analysis.stiffness_map import pencil
from cosim.circuits.design_constants import DesignConstants
from cosim.circuits.linear_circuit import LinearCircuit
from cosim.effects import without_dynamics
from cosim.errors import CosimError, fail
from cosim.loop.linear.run_linear import Propagation, prepare
from cosim.loop.setup import shift_samples
from cosim.loop.state import Fault
from cosim.plan import resolve
from cosim.scene import Scene
from cosim.scene.mechanism import mechanism, start
from cosim.scene.parameters import Field, Parameters, Unit
from cosim.scene.quantities import Period
from cosim.storage.checkpoint import Points
from cosim.studies import table_columns as col
from cosim.studies.drop_curves import REFINED, Family, Limits, compared, curve, verdicts
from cosim.studies.grid import milli
from cosim.studies.study import Study, StudyFile, StudyResult, Table
from cosim.types import Array

__all__ = ["STUDY", "Dropped", "Falls", "Job", "Rest", "drop", "limit", "scan"]


#: The displayed stiffness is that of a motion this slow: inertia then adds some 1e-5 N/m.
_SLOW_HZ = 1e-3
#: A scan ends after this many stiffnesses in a row at which no phase rests.
_HOPELESS = 2
#: ... and at this multiple of the exact limit at the latest; where few rest at its beginning it goes down to
#: this share of it.
_FAR, _NEAR = 4.0, 0.02


class DropParameters(Parameters):
    """``[parameters]`` of the drop test. A family's own periods and phases win."""

    families: tuple[Family, ...] = Field(min_length=1)
    periods_s: tuple[Period, ...] = Field(min_length=1)
    phases: int = Field(default=32, ge=1, le=1024)
    window_s: Annotated[float, Field(gt=0, le=1e4), Unit("s")] = 30.0
    rest_speed_m_per_s: Annotated[float, Field(gt=0, le=1), Unit("m/s")] = 1e-3
    rest_time_s: Annotated[float, Field(gt=0, le=100), Unit("s")] = 1.0
    rest_share: Annotated[float, Field(gt=0, le=1)] = 0.95
    from_share: Annotated[float, Field(gt=0, lt=1)] = 0.6
    ratio: Annotated[float, Field(gt=1, le=2)] = 1.05


@dataclass(frozen=True)
class Rest:
    """What counts as rest: tip speeds below `speed_m_per_s` at the samples over `time_s`, within a window."""

    window_s: float
    speed_m_per_s: float
    time_s: float
    share: float
    phases: int
    from_share: float
    ratio: float


@dataclass(frozen=True)
class Job:
    """One point of a curve: a scene at one sampling period, with its circuit."""

    scene: Scene
    constants: DesignConstants
    circuit: LinearCircuit
    rest: Rest

    def contact(self) -> HeldContact:
        """Return the contact that the mass falls to, held at the wall."""
        return HeldContact.at_wall(self.scene, self.constants, self.circuit)


@dataclass(frozen=True)
class Dropped:
    """The floor's limits at one sampling period.

    Attributes
    ----------
    exact_n_per_m : limit of the held contact, from the eigenvalues of one period; infinite or 0 without one
    first_n_per_m : first stiffness at which fewer than the stated share of the phases rest; NaN where they
        do so at no stiffness
    all_n_per_m, none_n_per_m : largest stiffness scanned below which every phase rests; smallest above which
        none does
    stiffness_n_per_m, share : all that was tried, in rising order
    runs, samples : drops simulated, and sampling periods in all of them
    """

    exact_n_per_m: float
    first_n_per_m: float
    all_n_per_m: float
    none_n_per_m: float
    stiffness_n_per_m: list[float]
    share: list[float]
    runs: int
    samples: int


def limit(contact: HeldContact) -> float:
    """Return the largest stable discrete stiffness of the held contact [N/m]; see `stability.border`."""
    return pencil(contact).first(1.0, 1e5)


def passive_limit(job: Job) -> float | None:
    """Return the largest passive discrete stiffness [N/m]; None where the analog part alone is active."""
    return limits_of(job.contact()).passive_n_per_m


class Falls:
    """Drops of one scene: packed once, its maps kept, only stiffness and phase change.

    Parameters
    ----------
    job
        The scene with its circuit, and what counts as rest.
    gain
        Field of the computer that `share` changes: ``kp``, the discrete stiffness, or ``k_dp``, the analog.
    """

    def __init__(self, job: Job, gain: str = "kp") -> None:
        scene = job.scene
        self._packed: Propagation = prepare(
            scene, job.constants, job.circuit, record=False,
            sample_capacity=math.ceil(scene.duration_s / scene.computer.period_s) + 8,
        )  # fmt: skip
        memory = self._packed.memory
        state = memory.state[0]
        state["rest"]["speed"] = job.rest.speed_m_per_s / _reach(scene)
        state["rest"]["time"] = job.rest.time_s
        self._fresh = memory.state.copy()
        self._phases, self._gain = job.rest.phases, gain
        self._linear = int(self._packed.exact.on[0])
        self.runs = self.samples = 0

    def share(self, stiffness: float) -> float:
        """Return the share of the phases that come to rest."""
        return sum(rested for rested, _ in self.each(stiffness)) / self._phases

    def each(self, stiffness: float) -> Iterator[tuple[int, Array]]:
        """Drop at every phase; yield whether it came to rest, and its samples (`sample_columns`)."""
        if self._gain == "k_dp":  # other gains: kept maps do not fit them
            self._packed.exact.made[:], self._packed.exact.on[0] = 0, self._linear
        for phase in range(self._phases):
            memory = self._packed.memory
            memory.state[:] = self._fresh
            state = memory.state[0]
            state["c"][self._gain] = stiffness
            shift_samples(memory, phase / self._phases)
            self._packed.run()
            if state["fault"] not in (Fault.NONE, Fault.RAN_AWAY):
                raise CosimError(f"a drop at {stiffness:.6g} N/m ended with fault {state['fault']}")
            self.runs += 1
            self.samples += int(state["clock"]["tick"])
            yield int(state["rest"]["rested"]), memory.samples[: int(state["samples"]["used"])]


def _reach(scene: Scene) -> float:
    """Tip speed for a joint speed [m]."""
    if scene.device.slider is None:
        fail("the drop test needs the slider of Fig. 12", file=scene.file_name, key="device.linkage")
    return scene.device.slider.radius_m


def friction_balance(job: Job) -> float:
    """Return the stiffness [N/m] at which sampling feeds a fall as much energy as Coulomb friction takes.

    A held spring gives a swing of amplitude speed v the energy of a viscosity -k T/2, friction takes that of
    4 f_c/(pi v): k T v = 8 f_c/pi. Zero without friction.
    """
    scene, slider = job.scene, job.scene.device.slider
    wall, linkage = scene.wall, mechanism(scene, job.constants.gear)
    assert wall is not None
    assert slider is not None  # `Falls` needs one
    q, v = start(scene, linkage)
    normal = np.array(wall.normal)
    height = float(normal @ (linkage.forward(q) - np.array(wall.point_m)))
    falling = -float(normal @ np.array(linkage.gravity_m_per_s2))
    speed = math.sqrt(max(2.0 * falling * height, 0.0) + float(normal @ linkage.jacobian(q) @ v) ** 2)
    friction = slider.coulomb_n_m / slider.radius_m if scene.effects.coulomb else 0.0
    return 8.0 * friction / (math.pi * scene.computer.period_s * speed) if speed > 0.0 else 0.0


def scan(job: Job) -> Dropped:
    """Find the limits of one scene; see the module.

    Where linear theory knows none (a device without viscosity) the scan is about `friction_balance`, and
    where there is no friction either, nothing is scanned.
    """
    exact = limit(job.contact())
    about = exact if 0.0 < exact < math.inf else friction_balance(job)
    if not about > 0.0:
        return Dropped(exact, math.nan, math.nan, math.nan, [], [], 0, 0)
    falls, rest = Falls(job), job.rest
    shares: dict[float, float] = {}
    stiffness, hopeless = rest.from_share * about, 0
    lower = stiffness
    while (shares.setdefault(lower, falls.share(lower)) < rest.share) and lower > _NEAR * about:
        lower /= rest.ratio
    while hopeless < _HOPELESS and stiffness < _FAR * about:
        if stiffness not in shares:
            shares[stiffness] = falls.share(stiffness)
        hopeless = hopeless + 1 if shares[stiffness] == 0.0 else 0
        stiffness *= rest.ratio
    tried = sorted(shares)
    below = next((k for k in tried if shares[k] < rest.share), math.nan)
    if below == tried[0]:  # a mass that hops for ever, whatever the floor
        below = math.nan
    if math.isfinite(below):
        low, high = tried[tried.index(below) - 1], below
        for _ in range(REFINED):
            middle = math.sqrt(low * high)
            shares[middle] = falls.share(middle)
            low, high = (low, middle) if shares[middle] < rest.share else (middle, high)
        below = high
    tried = sorted(shares)
    partial = next((i for i, k in enumerate(tried) if shares[k] < 1.0), len(tried))
    some = max((i for i, k in enumerate(tried) if shares[k] > 0.0), default=-1)
    return Dropped(
        exact_n_per_m=exact,
        first_n_per_m=below,
        all_n_per_m=tried[partial - 1] if partial else math.nan,
        none_n_per_m=tried[some + 1] if some + 1 < len(tried) else math.nan,
        stiffness_n_per_m=tried,
        share=[shares[k] for k in tried],
        runs=falls.runs,
        samples=falls.samples,
    )


def drop(job: Job) -> dict[str, Any]:
    """Run `scan` and return its result JSON-ready; infinite and missing limits as None."""
    return {
        k: None if isinstance(v, float) and not (math.isfinite(v) and v > 0.0) else v
        for k, v in asdict(scan(job)).items()
    }


def jobs(spec: StudyFile, family: Family) -> dict[float, Job]:
    """Return the jobs of one curve by period; the circuit is extracted once for all of them."""
    given: DropParameters = spec.parameters
    rest = Rest(
        given.window_s, given.rest_speed_m_per_s, given.rest_time_s, given.rest_share,
        family.phases or given.phases, given.from_share, given.ratio,
    )  # fmt: skip
    changes = (*family.set, f"duration_s={given.window_s!r}")
    plan = resolve(spec.scene(*changes))
    if plan.model == "spice":
        fail(
            "thousands of drops need the circuit model ideal or linear",
            file=str(spec.file), key=f"parameters.families.{family.name}", value="spice",
        )  # fmt: skip
    circuit, constants = circuit_of(plan, reduced=True)
    return {
        period: Job(spec.scene(*changes, f"computer.period_s={period!r}"), constants, circuit, rest)
        for period in family.periods_s or given.periods_s
    }


def analyse(spec: StudyFile, points: Points) -> StudyResult:
    """Scan every curve at every period; verdicts on the rows of the paper that its curves allow."""
    given: DropParameters = spec.parameters
    asked: dict[str, Job] = {}
    names: list[tuple[str, float]] = []
    scenes: dict[str, Scene] = {}
    for family in given.families:
        for period, job in jobs(spec, family).items():
            scenes[family.name] = job.scene
            asked[_point(family.name, period)] = job
            names.append((family.name, period))
    drops = dict(zip(names, points.map(drop, asked), strict=True))
    kinds = {family.name: family.kind for family in given.families}
    first = given.families[0].name
    passive = points.map(
        passive_limit,
        {
            f"passivity at {1e3 * period:.4g} ms": asked[_point(name, period)]
            for name, period in names
            if name == first
        },
    )
    line = Table(
        "passive",
        f"Passive up to: {first}",
        {
            col.PERIOD: [milli(period) for name, period in names if name == first],
            col.STIFFNESS: passive,
        },
        "Colgate and Schenkel's condition for the device's own damping, its circuit included.",
    )
    keys = ("exact_n_per_m", "first_n_per_m", "all_n_per_m", "none_n_per_m", "runs", "samples")
    limits = Table(
        "limits",
        "Largest discrete stiffness",
        {
            "curve": [name for name, _ in drops],
            col.PERIOD: [milli(period) for _, period in drops],
            "exact, contact held [N/m]": [row[keys[0]] for row in drops.values()],
            f"first below {100 * given.rest_share:g} % at rest [N/m]": [
                row[keys[1]] for row in drops.values()
            ],
            "all rest below [N/m]": [row[keys[2]] for row in drops.values()],
            "none rests above [N/m]": [row[keys[3]] for row in drops.values()],
            "kind": [kinds[name] for name, _ in drops],
            "drops": [row[keys[4]] for row in drops.values()],
            "samples": [row[keys[5]] for row in drops.values()],
        },
        f"Rest: below {1e3 * given.rest_speed_m_per_s:g} mm/s for {given.rest_time_s:g} s within "
        f"{given.window_s:g} s; {given.phases} phases of the samples against the impact.",
    )
    shares = Table(
        "shares",
        "Share of the phases at rest",
        {
            "curve": [name for (name, _), row in drops.items() for _ in row["share"]],
            col.PERIOD: [milli(period) for (_, period), row in drops.items() for _ in row["share"]],
            col.STIFFNESS: [k for row in drops.values() for k in row["stiffness_n_per_m"]],
            "share": [share for row in drops.values() for share in row["share"]],
        },
    )
    ideal = {
        family.name: points.get(f"{family.name}, circuit ideal", partial(_ideal_gain, spec, family, drops))
        for family in given.families
        if family.kind == "curve"
        and scenes[family.name].computer.analog_damping_n_s_per_m
        and compared(drops, first, family.name)
    }
    shown = {
        name: {period: displayed(asked[_point(name, period)], k) for period, k in curve(drops, name).items()}
        for name, scene in scenes.items()
        if kinds[name] == "curve" and scene.computer.analog_stiffness_n_per_m
    }
    judged = verdicts(drops, given.families, scenes, ideal, shown, given.ratio)
    return spec.result(limits, shares, line, verdicts=judged)


def _point(name: str, period: float) -> str:
    return f"{name} at {1e3 * period:.4g} ms"


def displayed(job: Job, stiffness: float) -> float:
    """Return the stiffness [N/m] that computer and circuit together show at rest, the discrete one given.

    From the law and the circuit's response to a slow motion of the tip, not as a sum of stated stiffnesses.
    """
    contact = job.contact().with_computer(discrete_stiffness_n_per_m=stiffness)
    force_over_speed = impedance(contact, np.array([_SLOW_HZ]))[0]
    return float((2j * np.pi * _SLOW_HZ * force_over_speed).real)


def _ideal_gain(spec: StudyFile, family: Family, drops: Limits) -> float:
    """Return what a curve adds to the first one's exact limit at the shortest period, both circuits ideal."""
    first = spec.parameters.families[0]
    period = compared(drops, first.name, family.name)[0]
    ends = []
    for one in (family, first):
        changes = (*one.set, f"computer.period_s={period!r}")
        plan = resolve(spec.scene(*changes, *without_dynamics(spec.scene(*changes))))
        ends.append(limit(HeldContact.of(plan)))
    return ends[0] - ends[1]


STUDY = Study(
    "drop",
    "drop test: largest discrete stiffness over the sampling period",
    DropParameters,
    analyse,
    no_tolerance="it asks of each run whether it comes to rest, which is yes or no",
)
