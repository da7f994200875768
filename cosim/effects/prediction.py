"""What a run will cost: points and seconds, apart from set-up, before anything has run.

Calibrated on press, drop and slope in the three models, at their own and at other periods and steps, with
and without noise: points and processor time are within a factor of two on those (a test holds this). The
machine enters by the microseconds a point, measured on one of two cores.
"""

from __future__ import annotations

from cosim.circuits.port import Stated
from cosim.effects import EFFECTS
from cosim.scene import Jitter, PotNoise, Scene

#: Points of a sample beyond the longest steps: what the restart behind its jump and its ramp takes.
RESTART_POINTS = 10.0
#: Points of any further instant that is landed on: ngspice starts afresh there with short steps.
EVENT_POINTS = {"spice": 17.0, "linear": 1.0, "ideal": 1.0}
#: Microseconds a point: fixed, a joint, and an amplifier of the board.
POINT_US = {"spice": (2.0, 0.0, 0.8), "linear": (0.6, 0.5, 0.0), "ideal": (0.45, 0.25, 0.0)}
#: Seconds for the matrices of a slider that is solved exactly, and for the maps of an interval of new length.
EXACT_S = {"spice": 0.0, "linear": 0.015, "ideal": 0.010}
INTERVAL_S = {"spice": 0.0, "linear": 1.4e-4, "ideal": 1.1e-5}


def predict(scene: Scene, constants: Stated, model: str) -> dict[str, float]:
    """Return points and seconds of a run on a circuit model; those of noise apart, because they decide.

    Keys 'points', 'seconds', 'noise_points' and 'noise_seconds'; the last two are parts of the first two.
    """
    step = min(scene.solver.max_step_s, scene.computer.period_s)
    samples = scene.duration_s / scene.computer.period_s
    points = samples * (RESTART_POINTS + scene.computer.period_s / step)
    noisy = 0.0
    for effect in EFFECTS:
        if effect.is_in_force(scene) and not effect.lacks(scene):
            events = effect.cost(scene, constants).events_per_s * scene.duration_s
            added = events * EVENT_POINTS[model]
            points += added
            noisy += added if effect.name in ("pot_noise", "component_noise") else 0.0
    fixed, joint, amplifier = POINT_US[model]
    each = 1e-6 * (fixed + joint * scene.joints + amplifier * sum(constants.count.values()))
    apart = EXACT_S[model] if _is_exact(scene) else 0.0
    if scene.effects.period_jitter is not Jitter.NONE:
        apart += samples * INTERVAL_S[model]
    return {
        "points": round(points),
        "seconds": points * each + apart,
        "noise_points": round(noisy),
        "noise_seconds": noisy * each,
    }


def _is_exact(scene: Scene) -> bool:
    """Whether our own loop goes from event to event by matrix exponentials (`cosim.loop.exact`)."""
    effects = scene.effects
    bent = effects.pot_linearity or effects.pot_calibration
    bent = bent or effects.pot_noise in (PotNoise.STATIC, PotNoise.POSITION)
    return scene.is_slider and not (bent or effects.coulomb or effects.end_stops)
