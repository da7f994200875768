"""Noise of every component of a board: what it does before each multiplier, and at each motor.

ngspice's `.noise` gives powers only: it is silent about what waits before a multiplier of zero gain, and it
loses that a device shared by several joints makes one noise. So each device's transfer is measured as a
complex number, by a current into its own terminals, to X of every multiplier and to every motor; `.noise`
supplies how much noise the device makes. At any gains the motors' noise is then

    I_i(f) = sum over d of [ T_id(f) + sum over c of P_ic(f) gain_c Y_c X_cd(f) ] xi_d(f)

with independent xi_d of one-sided density 1: one random stream a device, through the multipliers.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from cosim.circuits.cache import VERSION, load_arrays, store_arrays
from cosim.circuits.extraction.noise_analysis import left_out
from cosim.circuits.extraction.path_measurement import Session
from cosim.circuits.linear_circuit import channel_names
from cosim.errors import CosimError
from cosim.ngspice.deck import Deck
from cosim.ngspice.noise_deck import ROOM_C, SOURCE, Element, elements, noisy
from cosim.types import Array, Complex, Report

__all__ = ["BAND_HZ", "ComponentNoise", "Share", "component_noise", "extract_noise"]


#: Where noise is measured [Hz]: beyond what a finger or a motor follows, on both sides.
BAND_HZ = (0.1, 1e5)
_POINTS = 20
#: A device below this share of the density [V/sqrt(Hz)] of every output is not worth a random number.
_NONE = 1e-5
#: `.noise` and `.ac` agree on a device to rounding; by more than this they do not see the same paths.
_SAME = 1e-3
#: A path below this share of a device's strongest is rounding and supplies.
_FAINT = 1e-6
#: ngspice's name of the current that shot noise belongs to.
_CURRENT = {"d": "id", "q": "ic"}
#: As the share of a density.
_UNHEARD = 1e-5


@dataclass(frozen=True)
class Share:
    """What one device contributes over a band.

    Attributes
    ----------
    device
        Its instance path: ``xdiff1.xop``, ``xdiff1.r11``.
    current_a
        [n] rms current of each motor.
    """

    device: str
    current_a: Array


@dataclass(frozen=True)
class ComponentNoise:
    """Noise of the components of a board of n joints with m = 2 n^2 multipliers.

    Attributes
    ----------
    hz
        [F].
    devices
        D names.
    x
        [F, D, m] V/sqrt(Hz) behind the X probe of each multiplier, in the order of `channel_names`. A board
        without probes: its share of the current of the multiplier's motor at a gain of `v_fs` [A/sqrt(Hz)].
    motor
        [F, D, n] A/sqrt(Hz) with all gains zero.
    gain
        [m] 1/V.
    through
        [F, n, m] A per volt of a multiplier's product.
    command
        [F, n, n] A per volt at the pins cmd.
    groups
        Multipliers that see one and the same X, such as all springs of a joint.
    probes
        For each multiplier the source in series with X, and +1 or -1: the sign with which its voltage adds to
        X. Empty for a board without probes.
    v_fs
        Full scale of the gain pins [V].
    notes
        What is not as it should be, in words.
    """

    hz: Array
    devices: tuple[str, ...]
    x: Complex
    motor: Complex
    gain: Array
    through: Complex
    command: Complex
    groups: tuple[tuple[int, ...], ...]
    probes: tuple[tuple[str, float], ...]
    v_fs: float
    notes: tuple[str, ...]

    @property
    def joints(self) -> int:
        """Number of joints."""
        return int(self.motor.shape[2])

    def currents(self, control_v: Array) -> Complex:
        """Return [F, D, n] A/sqrt(Hz) with the gain pins at `control_v` [m] V."""
        out: Complex = self.motor + np.einsum(
            "fdc,c,fic->fdi", self.x, self.gain * np.asarray(control_v), self.through
        )
        return out

    def spectrum(self, control_v: Array) -> Complex:
        """Return the one-sided cross spectral densities of the motors' currents [F, n, n] A^2/Hz."""
        each = self.currents(control_v)
        out: Complex = np.einsum("fdi,fdj->fij", each, each.conj())
        return out

    def rms(self, control_v: Array, band_hz: tuple[float, float] = BAND_HZ) -> Array:
        """Return the rms current of each motor over a band [n] A."""
        power = np.real(np.einsum("fii->fi", self.spectrum(control_v)))
        return np.asarray(np.sqrt(_integral(self.hz, power, band_hz)), np.float64)

    def budget(self, control_v: Array, band_hz: tuple[float, float] = BAND_HZ) -> list[Share]:
        """Return what each device contributes over a band, the largest first."""
        power = np.abs(self.currents(control_v)) ** 2
        rms = np.sqrt(_integral(self.hz, power, band_hz))
        # rounded, so that equal joints keep the order of their names
        order = sorted(range(len(rms)), key=lambda d: (-float(f"{rms[d].max():.6g}"), self.devices[d]))
        return [Share(self.devices[d], rms[d]) for d in order]

    def springs(self, share: float = 1.0) -> Array:
        """Return gains [m] V with every joint's own spring at this share of full scale, all others zero."""
        names = channel_names(self.joints)
        return np.array([share * self.v_fs if n.startswith("ksp") and n[-1] == n[-2] else 0.0 for n in names])


def _integral(hz: Array, density: Array, band_hz: tuple[float, float]) -> Array:
    """Integrate a density [F, ...] over a band, by Simpson's rule on the logarithm of the frequency."""
    from scipy.interpolate import CubicSpline

    low, high = max(band_hz[0], hz[0]), min(band_hz[1], hz[-1])
    spline = CubicSpline(np.log(hz), density * hz.reshape(-1, *(1,) * (density.ndim - 1)), axis=0)
    return np.asarray(np.maximum(spline.integrate(np.log(low), np.log(high)), 0.0), np.float64)


def component_noise(payload: dict[str, Any], report: Report) -> ComponentNoise:
    """Measure the noise of a board's components, or take it from the cache; runs in ngspice's process.

    Parameters
    ----------
    payload
        'board': Deck, without noise in its parts.
    report
        called as the measurement goes on
    """
    board: Deck = payload["board"]
    name = hashlib.sha256(f"noise 3 {VERSION} {_POINTS} {BAND_HZ}\n{noisy(board).text}".encode()).hexdigest()
    known = load_arrays(name)
    if known is not None:
        about, arrays = known
        return ComponentNoise(
            **arrays,
            devices=tuple(about["devices"]),
            groups=tuple(map(tuple, about["groups"])),
            probes=tuple((source, sign) for source, sign in about["probes"]),
            v_fs=about["v_fs"],
            notes=tuple(about["notes"]),
        )
    noise = extract_noise(board, report)
    kept = {field.name: getattr(noise, field.name) for field in fields(noise)}
    arrays = {key: value for key, value in kept.items() if isinstance(value, np.ndarray)}
    store_arrays(name, {key: value for key, value in kept.items() if key not in arrays}, arrays)
    return noise


def extract_noise(board: Deck, report: Report | None = None) -> ComponentNoise:
    """Measure the noise of a board's components with `.noise` and `.ac` (see the module's text)."""
    deck = noisy(board)
    makers = elements(deck)
    injections = [f"inoise{k} {e.nodes[0]} {e.nodes[1]} dc 0 ac 0" for k, e in enumerate(makers)]
    session = Session(deck, injections)
    sweep = f"dec {_POINTS} {BAND_HZ[0]} {BAND_HZ[1]}"
    n, m = session.joints, len(session.channels)
    paths = session.measure(sweep)
    hz = paths.hz
    inside = [part.x_node for part in session.multipliers]
    motors = [f"imot{i}" for i in range(1, n + 1)]
    nodes = [*dict.fromkeys(inside), *motors]
    if not inside:  # what waits before the multipliers is heard through them only
        session.hold(dict.fromkeys(session.channels, session.v_fs))
    heard = {node: session.noise(node, sweep) for node in nodes}
    silent = np.zeros(len(hz))
    total = {node: np.sqrt(sum((d**2 for d in parts.values()), silent)) for node, parts in heard.items()}
    sizes: list[Array] = []
    kept: list[tuple[int, Element, Array]] = []
    responses: list[Complex] = []
    notes: list[str] = []
    lost: list[str] = []
    for k, maker in enumerate(makers):
        if maker.name in session.mute:
            continue
        response = session.respond(f"inoise{k}", sweep, nodes)
        if report is not None:
            report({"stage": "noise"})
        try:
            size, unheard = _density(session, maker, response, [heard[node] for node in nodes])
        except CosimError:  # ngspice does not tell its operating point
            session.mute.add(maker.name)
            continue
        if unheard:
            lost.append(maker.device)
        share = max(
            float(np.max(np.abs(response[:, i]) * size / np.maximum(total[node], 1e-300)))
            for i, node in enumerate(nodes)
        )
        if share > _NONE:
            kept.append((k, maker, size))
            sizes.append(size)
            responses.append(response)
    if lost:
        named = ", ".join(dict.fromkeys(lost))
        notes.append(
            f".noise does not pass a POLY or XSPICE device behind {named}: what they make is taken from "
            "their operating point, thermal and shot noise only"
        )
    notes += _left_out(makers, heard, total)
    if session.mute:
        notes.append(left_out(sorted(session.mute)))
    at = {node: i for i, node in enumerate(nodes)}
    scaled = [response * size[:, None] for response, size in zip(responses, sizes, strict=True)]
    table: Complex = np.stack(scaled, axis=1) if scaled else np.zeros((len(hz), 0, len(nodes)), complex)
    motor = table[:, :, [at[node] for node in motors]]
    if session.multipliers:
        x = table[:, :, [at[node] for node in inside]]
        groups = _grouped([session.before(part) for part in session.multipliers])
        probes = tuple((part.x, session.sign(part)) for part in session.multipliers)
    else:
        session.hold(dict.fromkeys(session.channels, 0.0))
        still = [session.respond(f"inoise{k}", sweep, motors) * size[:, None] for k, _, size in kept]
        motor = np.stack(still, axis=1) if still else motor
        x = _lumped(session, sweep, [(k, size) for k, _, size in kept], motors, motor)
        groups, probes = tuple((c,) for c in range(m)), ()
    return ComponentNoise(
        hz=hz, devices=_named([maker for _, maker, _ in kept]), x=x, motor=motor, gain=paths.gain,
        through=paths.post[:, :, :m], command=paths.post[:, :, m : m + n], groups=groups, probes=probes,
        v_fs=session.v_fs, notes=tuple(notes),
    )  # fmt: skip


def _density(
    session: Session, maker: Element, response: Complex, heard: Sequence[dict[str, Array]]
) -> tuple[Array, bool]:
    """Return the device's noise current [F] A/sqrt(Hz), and whether `.noise` failed to give it."""
    reach = np.abs(response)
    if maker.warmed:  # what `.noise` makes of it depends on the version
        return np.full(len(reach), _at_operating_point(session, maker)), False
    density = np.stack([one.get(maker.name, np.zeros(len(reach))) for one in heard], axis=1)
    if maker.from_data_sheet:  # `.noise` has it at the circuit's temperature, the data sheet at its own
        density *= math.sqrt(_kelvin(ROOM_C) / _kelvin(session.reading(maker.name, "temp")))
    best = np.argmax(density / (np.max(density, axis=0) + 1e-300) * (reach > 0.0), axis=1)
    row = np.arange(len(reach))
    size = density[row, best] / np.maximum(reach[row, best], 1e-300)
    expected = reach * size[:, None]
    worst = np.abs(expected - density).max(axis=0) > _SAME * np.maximum(
        expected.max(axis=0), density.max(axis=0)
    )
    audible = np.maximum(expected, density).max(axis=0) > 0.0
    if reach.max() == 0.0:
        return size, False
    try:
        least = _at_operating_point(session, maker)
    except CosimError:  # not known to ngspice: trust a density that is the same at every output
        if (worst & audible).any():
            raise
        return size, False
    # what passes in part would look right at the only output that hears it
    loud = reach > _FAINT * reach.max()
    short = (loud & (density < (1.0 - _SAME) * least * reach)).any()
    if short or (worst & audible).any():
        return np.full(len(reach), least), True
    return size, False


def _kelvin(celsius: float) -> float:
    return celsius + 273.15


def _at_operating_point(session: Session, maker: Element) -> float:
    """Return an element's thermal or shot noise A/sqrt(Hz), by the formulas of ngspice's own models."""
    from scipy.constants import Boltzmann, elementary_charge  # 30 ms that a run has no need of

    element, letter = maker.name, maker.name[0]
    if letter == "r":
        kelvin = _kelvin(ROOM_C if maker.from_data_sheet else session.reading(element, "temp"))
        return math.sqrt(4.0 * Boltzmann * kelvin / abs(session.reading(element, "resistance")))
    if letter in "jm":  # a channel in saturation
        return math.sqrt(4.0 * Boltzmann * _kelvin(ROOM_C) * abs(session.reading(element, "gm")) * 2.0 / 3.0)
    return math.sqrt(2.0 * elementary_charge * abs(session.reading(element, _CURRENT[letter])))


def _left_out(
    makers: list[Element], heard: dict[str, dict[str, Array]], total: dict[str, Array]
) -> list[str]:
    """Name what `.noise` hears of elements whose terminals are not known."""
    known = {maker.name for maker in makers}
    # of a part that states its noise, what else its model makes is none of the component's
    stated = tuple(m.name.partition(".")[2].removesuffix(SOURCE) for m in makers if m.from_data_sheet)
    return [
        f"{name} makes noise that is left out: its terminals are not known"
        for name in sorted({name for parts in heard.values() for name in parts} - known)
        if not name.partition(".")[2].startswith(stated)
        and max(float(np.max(parts.get(name, np.zeros(1)) / total[node])) for node, parts in heard.items())
        > _UNHEARD
    ]


def _lumped(
    session: Session, sweep: str, kept: list[tuple[int, Array]], motors: list[str], motor: Complex
) -> Complex:
    """Measure each device's share that passes a multiplier without probes, at full gain."""
    n = session.joints
    x = np.zeros((len(motor), len(kept), len(session.channels)), complex)
    for c, pin in enumerate(session.channels):
        i = c // n % n
        session.hold({pin: session.v_fs})
        for d, (k, size) in enumerate(kept):
            response = session.respond(f"inoise{k}", sweep, [motors[i]])[:, 0] * size
            x[:, d, c] = response - motor[:, d, i]
        session.hold({pin: 0.0})
    return x


def _grouped(nodes: list[str]) -> tuple[tuple[int, ...], ...]:
    groups: dict[str, list[int]] = {}
    for c, node in enumerate(nodes):
        groups.setdefault(node, []).append(c)
    return tuple(tuple(group) for group in groups.values())


def _named(makers: list[Element]) -> tuple[str, ...]:
    """Name each source of noise by its device; by the element where a device holds several."""
    devices = [maker.device for maker in makers]
    return tuple(
        maker.device
        if devices.count(maker.device) == 1
        else maker.name.partition(".")[2].removeprefix("xboard.")
        for maker in makers
    )
