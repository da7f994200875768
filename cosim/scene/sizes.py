"""What a scene makes the computer hold in memory, known before anything is allocated."""

from collections.abc import Callable, Iterator
from typing import Any

from cosim.errors import Problem

__all__ = ["SIZES"]

#: Most samples of the computer in a run: 10 h at 3.6 ms, 100 s at 10 us; each is a row of some 25 numbers.
MOST_SAMPLES = 10_000_000
#: Most random numbers of one kind that a run draws ahead: a quarter of a gigabyte.
MOST_DRAWN = 30_000_000

Get = Callable[[str], Any]
Check = Callable[[Get], Iterator[Problem]]


def _samples(get: Get) -> Iterator[Problem]:
    duration, period = get("duration_s"), get("computer.period_s")
    if duration / period > MOST_SAMPLES:
        yield Problem(
            f"the run would have {duration / period:.3g} samples", key="computer.period_s", value=period,
            unit="s", allowed=f">= {duration / MOST_SAMPLES:.3g}: at most {MOST_SAMPLES:.0e} in duration_s",
        )  # fmt: skip


def _noise(key: str, asked: Callable[[Get], bool], streams: Callable[[int], int]) -> Check:
    """Noise that is drawn twice for each period of its bandwidth, `streams` of it for a number of joints."""

    def check(get: Get) -> Iterator[Problem]:
        duration, bandwidth = get("duration_s"), get(key)
        joints = 1 if get("device.linkage") == "slider" else len(get("device.chain.lengths_m"))
        count = 2.0 * duration * bandwidth * streams(joints)
        if asked(get) and count > MOST_DRAWN:
            yield Problem(
                f"noise for {duration:g} s would be {count:.3g} random numbers", key=key, value=bandwidth,
                unit="Hz", allowed=f"<= {bandwidth * MOST_DRAWN / count:.3g} in a run so long",
            )  # fmt: skip

    return check


SIZES: tuple[Check, ...] = (
    _samples,
    _noise(
        "device.potentiometer.noise_bandwidth_hz",
        lambda get: get("effects.pot_noise") in ("white", "peak_to_peak"),
        lambda joints: joints,
    ),
    # at most one stream for each X of a multiplier and each pin cmd
    _noise(
        "device.component_noise_bandwidth_hz",
        lambda get: bool(get("effects.component_noise")),
        lambda joints: 2 * joints * joints + joints,
    ),
)
