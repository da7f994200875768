"""What a run will cost: points, seconds and the start before them, before anything has run.

Calibrated on the shipped scenes in the three models, with parts at every level and of a vendor, with noise of
both kinds, at relative tolerances from 1e-3 to 1e-6, periods from 1 to 100 ms and other steps: points and
processor time are within a factor of two on those (a test holds this). The machine enters by the
microseconds a point, measured on one of two cores.
"""

from __future__ import annotations

from cosim.circuits.design_constants import Stated
from cosim.effects import EFFECTS
from cosim.scene import Level, Scene
from cosim.scene.mechanism import is_linear_between_events

#: Points of a sample beyond the longest steps: what the restart behind its jump and its ramp takes; in
#: `spice` at ngspice's relative tolerance `_RTOL`, and with its fourth root at others.
RESTART_POINTS = {"spice": 13.0, "linear": 10.0, "ideal": 10.0}
#: The codes move less in a shorter period, and often not at all, and fewer short steps stand behind a smaller
#: jump: below this period [s] the points of a sample fall with so much of a power of it.
RESTART_PERIOD_S = 0.01
RESTART_POWER = {"spice": 0.35, "linear": 0.7, "ideal": 0.45}
#: Points of any further instant that is landed on: ngspice starts afresh there with short steps, whose
#: length goes with the third root of the tolerance, as that of any method of second order.
EVENT_POINTS = {"spice": 17.0, "linear": 1.0, "ideal": 1.0}
#: Points of a tick of component noise in `spice`, for each joint, one at least: its bends are small, and few
#: short steps follow. Fewer yet with offsets, whose volts the relative tolerance then goes by.
COMPONENT_POINTS, COMPONENT_POINTS_OFFSET = 1.65, 1.2
_RTOL = 1e-4
#: Microseconds a point: fixed, a joint, and in `spice` a straight and a bent element of the board.
POINT_US = {
    "spice": (2.4, 0.0, 0.08, 0.28),
    "linear": (0.4, 0.8, 0.0, 0.0),
    "ideal": (0.45, 0.25, 0.0, 0.0),
}
#: A slew limit at level gbw stands inside the loop of its pole: it takes this many times the Newton steps.
SLEW_STEPS = 1.9
#: Seconds for the matrices of a slider that is solved exactly, and for the maps of an interval of new length.
EXACT_S = {"spice": 0.0, "linear": 0.0075, "ideal": 0.0045}
INTERVAL_S = {"spice": 0.0, "linear": 1.4e-4, "ideal": 1.1e-5}
#: The same where a slider is solved exactly: matrix exponentials for each new length.
EXACT_INTERVAL_S = {"spice": 0.0, "linear": 4.2e-4, "ideal": 3.3e-4}
#: Seconds a sample for a control law in Python.
LAW_S = 7e-5
#: Microseconds a point for an operator in Python: it is called some twice a point, at trials too.
OPERATOR_US = {"spice": 26.0, "linear": 36.0, "ideal": 36.0}
#: Seconds of processor time from the command to the first point, with everything compiled and extracted
#: before: two processes load Python, ngspice and compiled code, and the board's stability is judged.
START_S = 0.9


def predict(scene: Scene, constants: Stated, model: str) -> dict[str, float]:
    """Return points and seconds of a run on a circuit model; those of noise apart, because they decide.

    Keys 'points', 'seconds', 'noise_points' and 'noise_seconds', the last two parts of the first two; and
    'start_seconds', which come before.
    """
    step = min(scene.solver.max_step_s, scene.computer.period_s)
    samples = scene.duration_s / scene.computer.period_s
    finer = _RTOL / scene.solver.rtol if model == "spice" else 1.0
    smaller = min(scene.computer.period_s / RESTART_PERIOD_S, 1.0) ** RESTART_POWER[model]
    points = samples * (RESTART_POINTS[model] * smaller * finer**0.25 + scene.computer.period_s / step)
    noisy = 0.0
    for effect in EFFECTS:
        if effect.is_in_force(scene) and not effect.lacks(scene):
            each = EVENT_POINTS[model] * finer ** (1.0 / 3.0)
            if effect.name == "component_noise" and model == "spice":
                each = max(1.0, _of_tick(scene) * finer ** (1.0 / 3.0))
            added = effect.cost(scene, constants).events_per_s * scene.duration_s * each
            points += added
            noisy += added if effect.name in ("pot_noise", "component_noise") else 0.0
    fixed, joint, straight, bent = POINT_US[model]
    micro = fixed + joint * scene.joints + straight * constants.straight + bent * constants.bent
    if model == "spice" and scene.effects.opamp_slew:
        micro *= SLEW_STEPS
    if scene.operator.type == "python":
        micro += OPERATOR_US[model]
    apart = EXACT_S[model] if is_linear_between_events(scene) else 0.0
    if any(each.fresh_intervals and each.is_in_force(scene) for each in EFFECTS):
        apart += samples * (EXACT_INTERVAL_S if is_linear_between_events(scene) else INTERVAL_S)[model]
    if scene.computer.law is not None:
        apart += samples * LAW_S
    return {
        "points": round(points),
        "seconds": 1e-6 * points * micro + apart,
        "noise_points": round(noisy),
        "noise_seconds": 1e-6 * noisy * micro,
        "start_seconds": START_S,
    }


def _of_tick(scene: Scene) -> float:
    """Return the points that follow a tick of component noise in `spice`."""
    offset = scene.effects.opamp_offset or scene.effects.opamp is Level.FULL
    return (COMPONENT_POINTS_OFFSET if offset else COMPONENT_POINTS) * scene.joints
