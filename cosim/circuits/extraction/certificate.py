"""What an extracted model promises, in numbers and sentences."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from cosim.caution import Caution
from cosim.circuits.linear_circuit import GOOD, LinearCircuit, channel_names
from cosim.types import Array
from cosim.units import quantity

if TYPE_CHECKING:  # every run reads a certificate, few write one
    from cosim.circuits.extraction.limits_and_offsets import ControlPath
    from cosim.circuits.extraction.path_measurement import Paths
    from cosim.circuits.fitting.networks import Block
    from cosim.circuits.fitting.reduction import Bound

__all__ = [
    "BENT",
    "WORST_LARGE_SIGNAL",
    "WORST_NONLINEARITY",
    "cautions",
    "delays",
    "footnote",
    "linear_certificate",
    "statics",
]


#: Deviation of a gain from proportionality, as a share of full scale, at which `linear` is refused.
WORST_NONLINEARITY = 0.02
#: Difference between currents and their slope at rest, as a share of rated current, that is reported:
#: five times what the shipped board's multipliers bend (0.43 %).
BENT = 0.02
#: The same beyond which `linear` is refused: it is wrong over the working range.
WORST_LARGE_SIGNAL = 0.2


def footnote(
    pre: Block, post: Block, band_hz: float, static: tuple[Array, Array, Array] | None = None
) -> dict[str, Any]:
    """Certify the paper's footnote 1: how far the circuit is from its DC gains anywhere in the band.

    A damper is compared with s times its slope. A path through a multiplier may be off by what stands
    before it and what stands after it together. Errors are relative to the maximum of each path in the band.

    Parameters
    ----------
    static
        DC gains and slopes before, DC gains after the multipliers; the fit's own by default.
    """
    omega = 2.0 * np.pi * band_hz
    m, n = pre.shape[0], post.shape[0]
    if static is None:
        before = pre.joined().derivatives(2)
        damper = (np.arange(m) >= m // 2)[:, None]
        static = (
            np.where(damper, 0.0, before[0]),
            np.where(damper, before[1], 0.0),
            post.joined().derivatives(1)[0],
        )
    first = pre.static_error(omega, static[0], static[1]).upper.max(axis=1)
    second = post.static_error(omega, static[2], np.zeros(post.shape)).upper.max(axis=0)
    through = first + second[:m] * (1.0 + first)
    each = {
        "spring": float(through[: m // 2].max()),
        "damper": float(through[m // 2 :].max()),
        "command": float(second[m : m + n].max()),
        "back_emf": float(second[m + n :].max()),
    }
    worst = max(each, key=lambda name: each[name])
    others = ", ".join(
        f"{name.replace('_', '-')} {_share(value).removesuffix(' of')}" for name, value in each.items()
    )
    beyond = "; its damper no longer differentiates there" if each["damper"] > 1.0 else ""
    return {
        "band_hz": band_hz,
        "error": each,
        "sentence": f"up to {quantity(band_hz, 'Hz', 6)} the circuit differs from its DC gains "
        f"(dampers: from H(jw)/(jw) as w -> 0) by at most {_share(each[worst])} the most that the path "
        f"gives there ({others}){beyond}",
    }


def linear_certificate(circuit: LinearCircuit, full: int, bounds: tuple[Bound, Bound] | None,
                       fit_error: float, band_hz: float, tolerance: float, paths: Paths
                       ) -> dict[str, Any]:  # fmt: skip
    """State order, poles and errors of a `linear` model; `full` is the order before reduction.

    `fit_error` is what the fit leaves of any path at any frequency of the sweep, inside the band or not.
    """
    errors: dict[str, Any] = {
        "model": "linear",
        "order": circuit.order,
        "full_order": full,
        "poles_rad_per_s": sorted(
            ([float(p.real), float(p.imag)] for p in circuit.poles), key=lambda p: -p[0]
        ),
        "reduced": bounds is not None,
        "fit_error": fit_error,
    }
    if fit_error > GOOD:
        errors["note"] = (
            f"no rational function of reasonable order follows the board exactly: order {full} leaves "
            f"{fit_error:.1e} of the path's maximum"
        )
    if bounds is not None:
        first, second = (bound.worst for bound in bounds)
        total = first + second * (1.0 + first) + 2.0 * fit_error  # of what stands before and after
        errors |= {
            "band_hz": band_hz,
            "tolerance": tolerance,
            "error_before": first,
            "error_after": second,
            "error": total,
            "measured_error": _measured(circuit, paths, band_hz),
            "sentence": f"up to {quantity(band_hz, 'Hz', 6)} the model of order {circuit.order} "
            f"differs from the circuit "
            f"(order {full}) by at most {_percent(total)} of the path's maximum",
        }
    return errors


def cautions(certificate: Mapping[str, Any]) -> list[Caution]:
    """Return what a certificate gives reason to doubt: a rough fit, and gains that do nothing."""
    doubts = []
    if certificate.get("dead"):
        doubts.append(
            Caution(
                "dead-gain",
                f"nothing comes through to a motor at any gain of {', '.join(certificate['dead'])}",
                "look for an open connection, a resistor without an end or a value of zero in that path",
            )
        )
    bent = float(certificate.get("large_signal_error", 0.0))
    if bent > BENT:
        doubts.append(
            Caution(
                "not-linear",
                f"on its way to rated current the board leaves the slope that it has at rest: with "
                f"{certificate['large_signal_worst']} at full scale the current is off by up to "
                f"{100.0 * bent:.3g} % of rated current, which the models ideal and linear do not know",
                "run the model spice; look for an output stage without bias at rest, or an amplifier that "
                "saturates below rated torque",
            )
        )
    error, tolerance = float(certificate.get("fit_error", 0.0)), float(certificate.get("tolerance", 0.0))
    if not error > max(tolerance, GOOD):
        return doubts
    return [
        *doubts,
        Caution(
            "rough-fit",
            f"the linear model differs from the board by up to {error:.1e} of a path's maximum, over the "
            f"tolerance of {max(tolerance, GOOD):.1e}",
            "raise solver.reduction_tolerance to say that this is enough, or run the model spice beside it",
        ),
    ]


def _measured(circuit: LinearCircuit, paths: Paths, band_hz: float) -> float:
    """Return the largest error of pot, u -> imot at full scale against what ngspice gave inside the band."""
    inside = paths.hz <= band_hz
    n = circuit.joints
    volts = np.full(len(paths.gain), paths.v_fs)
    mine = circuit.response(paths.s[inside], volts)[:, :, : 2 * n] @ paths.driven
    scale = np.abs(paths.total[inside]).max(axis=0)
    scale = np.maximum(scale, 1e-4 * scale.max(axis=1, keepdims=True))
    return float((np.abs(mine - paths.total[inside]) / np.where(scale > 0.0, scale, 1.0)).max())


def statics(paths: Paths, control: ControlPath, limit: Array) -> dict[str, Any]:
    """State what does not depend on frequency, and what a gain step does."""
    m = len(paths.gain)
    channels = channel_names(limit.shape[0])
    through = paths.post[:, :, :m] @ ((paths.gain * paths.v_fs)[:, None] * paths.x) @ paths.driven
    size = np.abs(paths.total).max()
    alive = (np.abs(paths.x).max(axis=(0, 2)) > 0.0) & (np.abs(paths.post[:, :, :m]).max(axis=(0, 1)) > 0.0)
    facts: dict[str, Any] = {
        "control_nonlinearity": float(control.nonlinearity.max()),
        "control_nonlinearity_worst": channels[int(np.argmax(control.nonlinearity))],
        "not_through_multipliers": float(np.abs(through - paths.total).max() / size) if size else 0.0,
        "current_limited": bool(np.isfinite(limit).any()),
        "probes": not paths.lumped,
        "dead": [pin for pin, one in zip(channels, alive, strict=True) if not one],
    }
    if control.delay_s is not None and control.error is not None:
        facts["control_delay_s"] = float(np.abs(control.delay_s).max())
        facts["control_error"] = control.error
        facts["gain_step"] = (
            "a gain step passes through what stands after the multipliers only; in the band its own path "
            f"differs from that of X by at most {_percent(control.error)}"
        )
    else:
        late = _group_delay(paths)
        facts["gain_step_delay_s"] = late
        facts["gain_step"] = (
            "the multipliers have no probes, so all of the path's dynamics stand before them: a gain step "
            f"acts at once, in the circuit up to {quantity(late, 's')} later"
        )
    return facts


def delays(pre: Block, post: Block) -> dict[str, Any]:
    """Return how late each kind of path is at low frequency [s], the largest of its channels."""
    before, after = pre.joined().derivatives(3), post.joined().derivatives(2)
    m, n = pre.shape[0], post.shape[0]

    def late(first: Array, zeroth: Array) -> Array:
        strong = np.abs(zeroth) > 1e-6 * np.abs(zeroth).max(initial=0.0)
        out: Array = np.where(strong, -first / np.where(strong, zeroth, 1.0), 0.0)
        return out

    post_late = late(after[1], after[0])
    spring = late(before[1], before[0])[: m // 2]
    damper = late(before[2], before[1])[m // 2 :, :n]
    return {
        "spring_before": float(spring.max()),
        "damper_before": float(damper.max()),
        "after": float(post_late[:, :m].max()),
        "command": float(post_late[:, m : m + n].max()),
    }


def _group_delay(paths: Paths) -> float:
    """Return the delay of the slowest path of a lumped board at the lowest frequency [s]."""
    first = paths.x[0]
    strong = np.abs(first.real) > 1e-3 * np.abs(first.real).max(initial=0.0)
    late = np.where(strong, -first.imag / np.where(strong, first.real, 1.0), 0.0) / (
        2.0 * np.pi * paths.hz[0]
    )
    return float(late.max(initial=0.0))


def _share(value: float) -> str:
    """Return a share in words, whatever its size: `3 % of`, `22 times`."""
    return f"{_percent(value)} of" if value < 1.0 else f"{value:.3g} times"


def _percent(value: float) -> str:
    return f"{100.0 * value:.3g} %"
