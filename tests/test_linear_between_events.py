"""Whether a scene is linear between its events is stated once, for the loop and for what it costs."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from linear_runs import CONSTANTS, ideal
from support import scene_of, slider

from cosim.loop.linear.run_linear import prepare
from cosim.scene.mechanism import is_linear_between_events

#: Tables of a scene, and whether all that acts between two events is linear in angles and speeds.
SCENES: list[tuple[str, dict[str, Any], bool]] = [
    ("plain", {}, True),
    ("viscous", {"effects": {"viscous": True}, "device": {"slider": {"viscous_n_m_s": 1e-3}}}, True),
    ("friction", {"effects": {"coulomb": True}, "device": {"slider": {"coulomb_n_m": 1e-3}}}, False),
    ("friction of zero", {"effects": {"coulomb": True}, "device": {"slider": {"coulomb_n_m": 0.0}}}, True),
    ("stops", {"effects": {"end_stops": True}, "device": {"slider": {"stops_rad": [[-1.0, 1.0]]}}}, False),
    ("noise in time", {"effects": {"pot_noise": "white"}}, True),
    ("an offset of the angle", {"effects": {"pot_noise": "static"}}, False),
    ("an error over the angle", {"effects": {"pot_noise": "position"}}, False),
    ("a gain error", {
        "effects": {"pot_calibration": True}, "device": {"potentiometer": {"gain_error": 0.01}},
    }, False),
]  # fmt: skip


@pytest.mark.parametrize(("more", "linear"), [pytest.param(*each[1:], id=each[0]) for each in SCENES])
def test_a_scene_is_linear_between_events(tmp_path: Path, more: dict[str, Any], linear: bool) -> None:
    scene = scene_of(tmp_path, slider(duration_s=0.05, **more))
    assert is_linear_between_events(scene) == linear
    packed = prepare(scene, CONSTANTS, ideal(1), record=False)
    assert bool(packed.exact.on[0]) == linear
    # the packed records hold what is not linear: the statement overlooks none of it
    state = packed.memory.state[0]
    bends = [np.any(state["p"][name]) for name in ("coulomb_on", "stops_on", "shaft_on")]
    assert linear == (not any(bends) and not state["position_noise"]["address"])
