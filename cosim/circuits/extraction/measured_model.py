"""From a netlist to the `ideal` and `linear` circuit models: ngspice is asked, the answers are fitted."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from cosim.circuits import cache
from cosim.circuits.extraction import certificate
from cosim.circuits.extraction.ideal import DC_SWEEP, ideal
from cosim.circuits.extraction.large_signal import large_signal_error
from cosim.circuits.extraction.limits_and_offsets import ControlPath, control_path, current_limits, offsets
from cosim.circuits.extraction.path_measurement import Paths, Session
from cosim.circuits.fitting.networks import ROUNDING, Block, fit_block
from cosim.circuits.fitting.rational_fit import WORST, Modes
from cosim.circuits.linear_circuit import LinearCircuit, channel_names
from cosim.errors import CosimError, InputError, Problem, fail
from cosim.types import Array

__all__ = ["SWEEP", "extracted", "linear", "networks", "with_offsets", "without_rates"]


#: Two decades more than 0.1 Hz to 100 MHz below and one above, for the poles just outside.
SWEEP = "dec 20 1m 1g"
#: Largest relative change of H/s over the sweep for a pure differentiator.
_PURE = 1e-9
#: Band for what is stated of the control path where no band is given [Hz].
_USUAL_BAND_HZ = 1e3


def extracted(session: Session, asked: cache.Asked, paths: Paths | None = None) -> LinearCircuit:
    """Extract the board as it is in ngspice now; `paths` over `SWEEP` where they are known."""
    file = str(session.board.path)
    if asked.model == "ideal":
        circuit = _ideal(session, asked, file)
    else:
        circuit = _linear(session, asked, file, session.measure(SWEEP) if paths is None else paths)
    notes = {"ngspice": str(session.simulator.version)} | ({"aid": session.aid} if session.aid else {})
    return replace(circuit, certificate=circuit.certificate | notes)


def _ideal(session: Session, asked: cache.Asked, file: str) -> LinearCircuit:
    low = session.measure(DC_SWEEP)
    circuit = ideal(low, file)
    promise: dict[str, Any] = {"model": "ideal", "order": 0}
    if asked.band_hz > 0.0:
        paths = session.measure(SWEEP)
        static = (circuit.d_pre, np.pad(circuit.e_pre, ((0, 0), (0, circuit.joints))), circuit.d_post)
        try:
            pre, post = networks(without_rates(paths)[1], file)
            promise["footnote_1"] = certificate.footnote(pre, post, asked.band_hz, static)
            promise["delay_s"] = certificate.delays(pre, post)
        except CosimError as reason:  # gains have a meaning of their own, but then nobody vouches for them
            promise["footnote_1"] = {"sentence": f"nothing is certified: {reason}"}
    return _finished(session, asked, circuit, low, promise)


def _linear(session: Session, asked: cache.Asked, file: str, paths: Paths) -> LinearCircuit:
    rate, proper = without_rates(paths)
    pre, post = networks(proper, file, max(WORST, asked.tolerance))
    full = replace(linear(paths, pre.joined(), post.joined()), e_pre=rate)
    circuit, bounds = full, None
    promise: dict[str, Any] = {}
    if asked.band_hz > 0.0:
        promise["footnote_1"] = certificate.footnote(pre, post, asked.band_hz)
        if asked.tolerance > 0.0:
            omega = 2.0 * np.pi * asked.band_hz
            # each side gets half, and both together stay below the whole: a + b (1 + a) <= t
            half = np.sqrt(1.0 + asked.tolerance) - 1.0
            (small, before), (rest, after) = pre.reduced(omega, half), post.reduced(omega, half)
            circuit, bounds = linear(paths, small.joined(), rest.joined()), (before, after)
            circuit = replace(circuit, e_pre=rate)
    fit_error = max((part.worst for part in (*pre.parts, *post.parts)), default=0.0)
    promise |= certificate.linear_certificate(
        circuit, full.order, bounds, fit_error, asked.band_hz, asked.tolerance, paths
    )
    promise["delay_s"] = certificate.delays(pre, post)
    return _finished(session, asked, circuit, paths, promise)


def _finished(
    session: Session, asked: cache.Asked, circuit: LinearCircuit, paths: Paths, promise: dict[str, Any]
) -> LinearCircuit:
    """Add what does not depend on frequency."""
    control = control_path(session, asked.band_hz or _USUAL_BAND_HZ)
    if asked.model == "linear":
        _check_control(control, str(session.board.path))
    limit = current_limits(session)
    bent = large_signal_error(session, limit)
    if bent is not None:
        if asked.model == "linear":
            _check_large_signals(*bent, str(session.board.path))
        promise = promise | {"large_signal_error": bent[0], "large_signal_worst": bent[1]}
    circuit = replace(circuit, limit=limit, certificate=promise | certificate.statics(paths, control, limit))
    return with_offsets(session, circuit)


def with_offsets(session: Session, circuit: LinearCircuit) -> LinearCircuit:
    """Return the circuit with the offsets of the board as it is in ngspice."""
    shifts = offsets(session)
    return replace(
        circuit,
        offset=shifts.current,
        x_offset=shifts.x,
        y_offset=shifts.y,
        # measured at full scale, to which y adds
        gain=circuit.gain * session.v_fs / (session.v_fs + shifts.y),
        certificate=circuit.certificate
        | {"offset": {name: value.tolist() for name, value in vars(shifts).items()}},
    )


def _check_control(control: ControlPath, file: str) -> None:
    n = int(np.sqrt(len(control.nonlinearity) // 2))
    problems = [
        Problem(
            f"no `linear` model: the gain is off proportionality to its control voltage by "
            f"{100.0 * off:.3g} % of full scale, more than {100.0 * certificate.WORST_NONLINEARITY:g} %; "
            "a run can take the model `spice`",
            file=file,
            key=pin,
        )
        for pin, off in zip(channel_names(n), control.nonlinearity, strict=True)
        if off > certificate.WORST_NONLINEARITY
    ]
    if problems:
        raise InputError(problems)


def _check_large_signals(error: float, pin: str, file: str) -> None:
    if error > certificate.WORST_LARGE_SIGNAL:
        fail(
            "no `linear` model: on its way to rated current the board leaves the slope that it has at rest "
            f"by {100.0 * error:.3g} % of rated current, more than "
            f"{100.0 * certificate.WORST_LARGE_SIGNAL:g} %: "
            "an output stage without bias at rest, or an amplifier that saturates below rated torque; "
            "a run can take the model `spice`",
            file=file,
            key=pin,
        )


def networks(paths: Paths, file: str, worst: float = WORST) -> tuple[Block, Block]:
    """Fit what stands before and after the multipliers, each to an error of at most `worst`.

    Raises
    ------
    InputError
        For an unstable board, or one whose responses no rational function fits.
    """
    return (
        fit_block(paths.s, paths.x, "before the multipliers", file, worst),
        fit_block(paths.s, paths.post, "after the multipliers", file, worst),
    )


def without_rates(paths: Paths) -> tuple[Array, Paths]:
    """Take the pure differentiators out, which no state space holds: their slopes [m, n] s, and what is left.

    A path is one where H/s is the same at every frequency, to what the sweep's rounding leaves of it.
    """
    n = paths.post.shape[1]
    ratio = paths.x[:, :, :n] / paths.s[:, None, None]
    slope = ratio[-1]
    apart = np.abs(ratio - slope).max(axis=0)
    pure = (np.abs(slope) > 0.0) & (apart <= _PURE * np.abs(slope))
    x = paths.x.copy()
    peak = np.abs(x).max(axis=0)
    x[:, peak <= ROUNDING * peak.max(axis=1, keepdims=True)] = 0.0
    x[:, :, :n][:, pure] = 0.0
    return np.where(pure, slope.real, 0.0), replace(paths, x=x)


def linear(
    paths: Paths,
    pre: Modes,
    post: Modes,
    limit: Array | None = None,
    offset: Array | None = None,
    certificate: dict[str, Any] | None = None,
) -> LinearCircuit:
    """Put both networks together, by default without limits and offsets."""
    m, n = len(paths.gain), paths.post.shape[1]
    return LinearCircuit(
        joints=n,
        model="linear",
        a_pre=pre.a,
        b_pre=pre.b,
        c_pre=pre.c,
        d_pre=pre.d,
        e_pre=np.zeros((m, n)),
        gain=paths.gain,
        a_post=post.a,
        b_post=post.b,
        c_post=post.c,
        d_post=post.d,
        offset=np.zeros(n) if offset is None else offset,
        limit=np.tile([-np.inf, np.inf], (n, 1)) if limit is None else limit,
        certificate=certificate or {},
    )
