"""Effects of the computer: converters and time."""

from __future__ import annotations

from cosim.circuits.design_constants import Stated
from cosim.effects.dac_skew import DAC_SKEW
from cosim.effects.effect import ALL, Cost, Effect, Size
from cosim.effects.period_jitter import PERIOD_JITTER
from cosim.effects.scale import scale
from cosim.scene import Method, Scene


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


def _settling(scene: Scene, constants: Stated) -> Size:
    settle = scene.computer.dac.settling_s
    force = scale(scene, constants).of_delay(settle)
    return Size(settle, "s", force, "of ramp from code to code", "k v t_s")


def _settling_cost(scene: Scene, constants: Stated) -> Cost:
    return Cost(0.0, 0, "a ramp for a jump")


def _lacks_settling(scene: Scene) -> str:
    return "" if scene.computer.dac.settling_s > 0.0 else "computer.dac.settling_s is zero"


def _geometric(scene: Scene, constants: Stated) -> Size:
    at = scale(scene, constants)
    k = at.force_n / at.reach_m
    return Size(k, "N/m", at.capped(k * at.depth_m), "of apparent stiffness", "F / r; Chen and Kao 2000")


def _lacks_springs(scene: Scene) -> str:
    if scene.is_slider:
        return "a slider's Jacobian does not change"
    if scene.computer.law is not None:
        return "the user's law decides what the springs are"
    if scene.computer.method not in (Method.CONTINUOUS, Method.COMBINED):
        return f"the method {scene.computer.method.value} has no coupled springs"
    return ""


def _lacks_delay(scene: Scene) -> str:
    computer = scene.computer
    return "" if computer.delay_periods or computer.delay_fraction else "no delay is stated in [computer]"


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
    Effect(
        "dac", False, (True,), "computer", ALL, size=_dac,
        keys=("computer.dac.bits", "computer.dac.range_v"), not_held="the codes of the DACs",
    ),
    Effect(
        "dac_settling", False, (True,), "computer", ALL,
        size=_settling, cost=_settling_cost, lacks=_lacks_settling, keys=("computer.dac.settling_s",),
    ),
    DAC_SKEW,
    Effect(
        "delay", False, (True,), "computer", ALL, size=_delay, cost=_delay_cost, lacks=_lacks_delay,
        keys=("computer.delay_periods", "computer.delay_fraction"),
    ),
    PERIOD_JITTER,
    Effect(
        "geometric_stiffness", False, (True,), "computer", ALL,
        size=_geometric, lacks=_lacks_springs,
    ),
)  # fmt: skip
