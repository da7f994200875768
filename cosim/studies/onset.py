"""A spring that is switched on at samples: the jump at the onset of a contact, its energy, and remedies.

The analog wall works between the samples, but the computer sees a contact late, by up to a period. The spring
then begins with a force k x and with the energy k x^2 / 2, x being how deep the tip has got: at a speed v up
to k v T and k (v T)^2 / 2, on average over the phases half and a third of it. Energy that the
device does not dissipate keeps a dropped mass hopping, whatever the circuit's bandwidth.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import groupby, pairwise
from typing import Annotated, Any

import numpy as np
from scipy.optimize import brentq

from cosim.analysis.control_law import external_force
from cosim.analysis.device_passivity import device_of
from cosim.analysis.held_contact import HeldContact
from cosim.errors import fail
from cosim.loop.columns import sample_columns
from cosim.plan import resolve
from cosim.scene import Method, Scene
from cosim.scene.mechanism import operator, start
from cosim.scene.parameters import Field, Parameters, Unit
from cosim.scene.quantities import Period
from cosim.storage.checkpoint import Points
from cosim.studies import table_columns as col
from cosim.studies.drop_curves import Family
from cosim.studies.drop_test import Falls, Job, Rest
from cosim.studies.grid import milli
from cosim.studies.study import Study, StudyFile, StudyResult, Table, Verdict
from cosim.types import Array

__all__ = ["STUDY", "Contact", "Fall", "fall", "first_contact"]


_KEYS = ("share", "jump", "jump_max", "largest", "onset", "onset_max", "contact")
#: A spring too soft to matter [N/m].
_SOFT = 1e-6


class OnsetParameters(Parameters):
    """``[parameters]`` of the onset: ways to begin a contact, periods, analog stiffnesses, what rest is."""

    ways: tuple[Family, ...] = Field(min_length=1)
    periods_s: tuple[Period, ...] = Field(min_length=2)
    stiffness_n_per_m: tuple[Annotated[float, Field(gt=0, le=1e6), Unit("N/m")], ...] = Field(min_length=2)
    phases: int = Field(default=32, ge=2, le=1024)
    window_s: Annotated[float, Field(gt=0, le=1e4), Unit("s")] = 30.0
    rest_speed_m_per_s: Annotated[float, Field(gt=0, le=1), Unit("m/s")] = 1e-3
    rest_time_s: Annotated[float, Field(gt=0, le=100), Unit("s")] = 1.0
    rest_share: Annotated[float, Field(gt=0, le=1)] = 0.95
    show_s: Annotated[float, Field(gt=0, le=10), Unit("s")] = 0.025
    show_n_per_m: Annotated[float, Field(gt=0, le=1e6), Unit("N/m")] = 100.0


@dataclass(frozen=True)
class Fall:
    """Flight without a spring.

    Attributes
    ----------
    mass_kg, viscosity_n_s_per_m, push_n : of the tip with all that moves along
    touch_s, touch_m_per_s : time from the start to the touch, and speed there
    """

    mass_kg: float
    viscosity_n_s_per_m: float
    push_n: float
    touch_s: float
    touch_m_per_s: float

    def depth(self, t: float) -> float:
        """Return how deep [m] the tip is a time [s] after the touch, no spring being on."""
        tau = self.mass_kg / self.viscosity_n_s_per_m
        top = self.push_n / self.viscosity_n_s_per_m
        return top * t - (self.touch_m_per_s - top) * tau * math.expm1(-t / tau)

    def onset_j(self, stiffness: float, period: float, phases: int) -> float:
        """Return the energy [J] of the onset, k x^2 / 2 on average over the phases of the samples."""
        late = [(-self.touch_s / period - phase / phases) % 1.0 * period for phase in range(phases)]
        return 0.5 * stiffness * float(np.mean([self.depth(t) ** 2 for t in late]))


def fall(contact: HeldContact) -> Fall:
    """Return the free flight of a slider's drop to a contact, its circuit's braking included."""
    scene, linkage, q = contact.scene, contact.linkage, contact.q
    person = operator(scene)
    q0, _ = start(scene, linkage)
    reach = _reach(scene)
    mass = float(linkage.mass_matrix(q, person)[0, 0]) / reach**2
    jac = linkage.jacobian(q)
    weight = float((jac.T @ external_force(scene, linkage, q, 0.0) - linkage.bias(q, np.zeros(1)))[0])
    free = device_of(contact.with_computer(analog_stiffness_n_per_m=_SOFT))
    viscosity = 1.0 / float(free.mobility(np.array([1e-2]))[0])
    height = abs(float(q[0] - q0[0])) * reach
    still = Fall(mass, viscosity, abs(weight) / reach, 0.0, 0.0)
    longest = 10.0 * math.sqrt(2.0 * height * mass / still.push_n) + 10.0 * height * viscosity / still.push_n
    touch_s = float(brentq(lambda t: still.depth(t) - height, 0.0, longest))
    speed = still.push_n / viscosity * -math.expm1(-touch_s * viscosity / mass)
    return Fall(mass, viscosity, still.push_n, touch_s, speed)


@dataclass(frozen=True)
class Contact:
    """The first contact of a run.

    Attributes
    ----------
    jump_n : force that its first sample switches on
    largest_n : largest jump of the force at any of its samples
    onset_j : energy that its first sample puts into the spring
    contact_j : net energy of all samples of the contact, that taken out by a late release included
    """

    jump_n: float
    largest_n: float
    onset_j: float
    contact_j: float


def first_contact(samples: Array, reach: float) -> Contact | None:
    """Return the first contact of a slider's run with an analog spring, None without a whole one.

    Parameters
    ----------
    samples
        Rows of `columns.sample_columns`; encoders without steps.
    reach
        Tip motion for a joint motion [m].
    """
    columns = sample_columns(1)
    touch, q, u, k = (samples[:, columns.index(name)] for name in ("contact", "q_enc1", "u_rad1", "ksp11"))
    inside = np.flatnonzero(touch)
    if not len(inside):
        return None
    begin = int(inside[0])
    out = np.flatnonzero(touch[begin:] == 0.0)
    end = begin + int(out[0]) if len(out) else len(touch) - 1
    here = slice(begin, end + 1)
    before = slice(begin - 1, end)
    torque = k[here] * (u[here] - q[here]) - k[before] * (u[before] - q[here])
    energy = 0.5 * (k[here] * (u[here] - q[here]) ** 2 - k[before] * (u[before] - q[here]) ** 2)
    pressed = slice(0, max(1, end - begin))  # at the last it lets go
    return Contact(
        float(abs(torque[0])) / reach, float(np.abs(torque[pressed]).max()) / reach,
        float(energy[0]), float(energy.sum()),
    )  # fmt: skip


def _reach(scene: Scene) -> float:
    if scene.device.slider is None or scene.computer.method is not Method.CONTINUOUS or scene.effects.encoder:
        fail("the onset needs the slider of Fig. 12, the method continuous and encoders without steps",
             file=scene.file_name, key="device.linkage")  # fmt: skip
    return scene.device.slider.radius_m


@dataclass(frozen=True)
class _Work:
    """Drops at one period, for a worker."""

    job: Job
    stiffness: tuple[float, ...]


def sweep(work: _Work) -> list[dict[str, float]]:
    """Drop at every stiffness; return shares, jumps and energies, JSON-ready."""
    falls, reach = Falls(work.job, "k_dp"), _reach(work.job.scene)
    out = []
    for k in work.stiffness:
        rested, seen = 0, []
        for rest, samples in falls.each(k):
            rested += rest
            if (contact := first_contact(samples, reach)) is not None:
                seen.append((contact.jump_n, contact.largest_n, contact.onset_j, contact.contact_j))
        jumps = np.array(seen)
        mean, top = jumps.mean(axis=0), jumps.max(axis=0)
        row = (rested / work.job.rest.phases, mean[0], top[0], mean[1], mean[2], top[2], mean[3])
        out.append({name: float(value) for name, value in zip(_KEYS, row, strict=True)})
    return out


def analyse(spec: StudyFile, points: Points) -> StudyResult:
    """Drop a mass on an analog wall, over period and stiffness, for each way to begin a contact."""
    given: OnsetParameters = spec.parameters
    flight: Fall | None = None
    work: dict[str, _Work] = {}
    for way in given.ways:
        changes = (*way.set, f"duration_s={given.window_s!r}")
        plan = resolve(spec.scene(*changes))
        if plan.model == "spice":
            fail("thousands of drops need the circuit model ideal or linear", file=str(spec.file),
                 key=f"parameters.ways.{way.name}", value="spice")  # fmt: skip
        contact = HeldContact.of(plan, reduced=True)
        flight = flight or fall(contact)
        rest = Rest(given.window_s, given.rest_speed_m_per_s, given.rest_time_s, given.rest_share,
                    way.phases or given.phases, 0.5, 1.05)  # fmt: skip
        for period in way.periods_s or given.periods_s:
            scene = spec.scene(*changes, f"computer.period_s={period!r}")
            work[f"{way.name}, {1e3 * period:.4g} ms"] = _Work(
                Job(scene, contact.constants, contact.circuit, rest), given.stiffness_n_per_m
            )
    assert flight is not None
    sweeps = dict(zip(work, points.map(sweep, work), strict=True))
    rows = [
        (key.rpartition(", ")[0], work[key].job.scene.computer.period_s, k, row)
        for key, each in sweeps.items()
        for k, row in zip(given.stiffness_n_per_m, each, strict=True)
    ]
    v = flight.touch_m_per_s
    phases = {way.name: way.phases or given.phases for way in given.ways}
    table = Table(
        "onset", "Drops on an analog wall",
        {
            "way": [name for name, _, _, _ in rows],
            col.PERIOD: [milli(t) for _, t, _, _ in rows],
            col.ANALOG_STIFFNESS: [k for _, _, k, _ in rows],
            col.PHASES_THAT_REST: [row["share"] for *_, row in rows],
            col.ONSET_JUMP: [row["jump"] for *_, row in rows],
            "jump at the onset, largest [N]": [row["jump_max"] for *_, row in rows],
            col.JUMP_CLOSED_FORM: [k * v * t for _, t, k, _ in rows],
            col.LARGEST_JUMP: [row["largest"] for *_, row in rows],
            "energy at the onset, mean [mJ]": [1e3 * row["onset"] for *_, row in rows],
            col.ONSET_CLOSED_FORM: [1e3 * flight.onset_j(k, t, phases[name]) for name, t, k, _ in rows],
            "energy at the onset, largest [mJ]": [1e3 * row["onset_max"] for *_, row in rows],
            col.ENERGY_CLOSED_FORM: [5e2 * k * (v * t) ** 2 for _, t, k, _ in rows],
            col.CONTACT_ENERGY: [1e3 * row["contact"] for *_, row in rows],
        },
        f"Touch at {v:.4g} m/s, {flight.mass_kg:.3g} kg, {flight.viscosity_n_s_per_m:.3g} N s/m; rest: below "
        f"{1e3 * given.rest_speed_m_per_s:g} mm/s for {given.rest_time_s:g} s within {given.window_s:g} s; "
        f"{given.phases} phases. First contact of each drop.",
    )  # fmt: skip
    limits = _limits(rows, given)
    return spec.result(table, limits, verdicts=list(_verdicts(rows, given, flight)))


_Rows = list[tuple[str, float, float, Mapping[str, Any]]]


def _curves(rows: _Rows) -> Iterator[tuple[str, float, list[tuple[float, Mapping[str, Any]]]]]:
    for (name, period), each in groupby(rows, key=lambda row: row[:2]):
        yield name, period, [(k, row) for _, _, k, row in each]


def _limits(rows: _Rows, given: OnsetParameters) -> Table:
    columns: dict[str, list[Any]] = {
        name: [] for name in ("way", col.PERIOD, "rests up to [N/m]", "rests again above [N/m]")
    }
    for name, period, each in _curves(rows):
        shares = [row["share"] >= given.rest_share for _, row in each]
        first = shares.index(False) if False in shares else len(shares)
        again = next((each[i][0] for i in range(first, len(shares)) if shares[i]), None)
        values = (name, milli(period), each[first - 1][0] if first else None, again)
        for column, value in zip(columns.values(), values, strict=True):
            column.append(value)
    return Table(
        "limits", "Stiffest analog wall that a dropped mass rests on", columns,
        f"Of the stiffnesses tried, {given.stiffness_n_per_m[0]:g} to {given.stiffness_n_per_m[-1]:g} N/m; "
        f"rests: at {100 * given.rest_share:g} % of the phases.",
    )  # fmt: skip


def _verdicts(rows: _Rows, given: OnsetParameters, flight: Fall) -> Iterator[Verdict]:
    base = given.ways[0].name
    k = min(given.stiffness_n_per_m, key=lambda k: abs(k - given.show_n_per_m))
    shown = {(name, t): row for name, t, stiffness, row in rows if stiffness == k}
    periods = [t for name, t in shown if name == base]
    v = flight.touch_m_per_s
    phases = given.ways[0].phases or given.phases
    off = {t: shown[base, t]["onset"] / flight.onset_j(k, t, phases) - 1.0 for t in periods}
    text = ", ".join(f"{1e3 * shown[base, t]['onset_max']:.3g} mJ at {1e3 * t:.3g} ms" for t in periods)
    yield Verdict(
        "N4", f"energy of switching on at samples, {k:g} N/m",
        f"closed form of a fall within 1 %; at worst about that of the spring, pressed "
        f"at {v:.3g} m/s for a period",
        f"{100 * max(map(abs, off.values())):.2g} % off; largest {text}",
        max(map(abs, off.values())) <= 0.01, own=True,
    )  # fmt: skip
    text = ", ".join(
        f"{shown[base, t]['jump']:.2g} N (at worst {shown[base, t]['jump_max']:.2g}) at {1e3 * t:.3g} ms"
        for t in periods
    )
    yield Verdict(
        "N4", f"the 'rapid change' at the onset of a contact, {k:g} N/m",
        "up to the force of the depth that a period's fall reaches, half of it on average",
        text, all(shown[base, t]["jump_max"] <= 1.01 * k * flight.depth(t) for t in periods),
    )  # fmt: skip
    at = min(periods, key=lambda t: abs(t - given.show_s))
    for way in given.ways:
        rests = {t: [(stiff, row["share"]) for stiff, row in each]
                 for name, t, each in _curves(rows) if name == way.name}  # fmt: skip
        differences = []
        for t, each in rests.items():
            good = next((i for i, (_, share) in enumerate(each) if share < given.rest_share), len(each))
            limit = f"{each[good - 1][0]:.3g}" if good else f"below {each[0][0]:.3g}"
            differences.append(f"{limit + ' or more' if good == len(each) else limit} at {1e3 * t:.3g} ms")
        uneven = [1e3 * t for t, each in rests.items() if any(b > a for (_, a), (_, b) in pairwise(each))]
        text = f"rests up to [N/m] {', '.join(differences)}"
        if uneven:
            text += f"; not monotonic in the stiffness at {', '.join(f'{t:.3g}' for t in uneven)} ms"
        yield Verdict("N4", f"analog stiffness has 'no upper limit': {way.name}", "a question", text, None)
        if way.name != base and (way.name, at) in shown:
            one, other = shown[base, at], shown[way.name, at]
            yield Verdict(
                "N4", f"remedy: {way.name}", "largest jump and energy of a contact smaller",
                f"{k:g} N/m, {1e3 * at:.3g} ms: onset {one['jump']:.2g} -> {other['jump']:.2g} N, "
                f"largest jump {one['largest']:.2g} -> {other['largest']:.2g} N, contact "
                f"{1e3 * one['contact']:.3g} -> {1e3 * other['contact']:.3g} mJ",
                bool(other["largest"] < one["largest"] and other["contact"] <= max(one["contact"], 0.0)),
            )  # fmt: skip


STUDY = Study(
    "onset",
    "analog wall switched on at samples: jump, energy, rest, remedies",
    OnsetParameters,
    analyse,
    no_tolerance="it asks of each run whether it comes to rest, which is yes or no",
)
