"""Effects of the computer: converters and time."""

from __future__ import annotations

from cosim.circuits.port import Stated
from cosim.effects.effect import ALL, Cost, Effect, Size
from cosim.effects.scale import scale
from cosim.scene import Scene


def _dac(scene: Scene, constants: Stated) -> Size:
    at, dac = scale(scene, constants), scene.computer.dac
    reach = dac.range_v if dac.range_v is not None else constants.dac_v
    bits = dac.bits if dac.bits is not None else round(constants.dac_bits)
    step = 2.0 * reach / 2**bits
    by_u = at.analog_n_per_m * at.reach_m / constants.v_rad
    by_command = 1.0 / (constants.v_nm * at.reach_m)
    by_gain = constants.k_fs / constants.v_fs / at.reach_m**2 * at.depth_m
    force = (by_u + by_command + by_gain) * step / 2.0
    return Size(step, "V", at.capped(force), "a code", "half a code of u, cmd and gain each")


def _delay(scene: Scene, constants: Stated) -> Size:
    lag = (scene.computer.delay_periods + scene.computer.delay_fraction) * scene.computer.period_s
    force = scale(scene, constants).of_delay(lag)
    return Size(lag, "s", force, "late", "k v t_d; K t_d of damping, Colgate and Schenkel 1997")


def _delay_cost(scene: Scene, constants: Stated) -> Cost:
    if scene.computer.delay_fraction == 0.0:
        return Cost(0.0, 0, "nothing for whole periods")
    return Cost(1.0 / scene.computer.period_s, 0, "one more event a sample")


#: In the order in which a plan lists them.
COMPUTER = (
    Effect("dac", False, (True,), "computer", ALL, size=_dac),
    Effect("delay", False, (True,), "computer", ALL, size=_delay, cost=_delay_cost),
)
