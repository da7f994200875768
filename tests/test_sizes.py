"""Numbers that size memory or time are refused before anything is allocated."""

from pathlib import Path

import pytest
from support import merge, scene_of, slider

from cosim.errors import InputError


@pytest.mark.parametrize(
    ("top", "key", "least"),
    [
        ({"duration_s": 1e5, "computer": {"period_s": 1e-6}}, "computer.period_s", "1e+11 samples"),
        (
            {"duration_s": 1e4, "effects": {"pot_noise": "white"},
             "device": {"potentiometer": {"noise_bandwidth_hz": 1e7}}},
            "device.potentiometer.noise_bandwidth_hz", "2e+11 random numbers",
        ),
        (
            {"duration_s": 1e5, "effects": {"component_noise": True},
             "device": {"component_noise_bandwidth_hz": 1e5}},
            "device.component_noise_bandwidth_hz", "6e+10 random numbers",
        ),
    ],
)  # fmt: skip
def test_a_scene_too_large_for_memory_is_refused(tmp_path: Path, top: dict, key: str, least: str) -> None:
    with pytest.raises(InputError) as caught:
        scene_of(tmp_path, merge(slider(), top))
    problem = next(each for each in caught.value.problems if each.key == key)
    assert least in problem.message
    assert problem.allowed


def test_what_is_allowed_is_accepted(tmp_path: Path) -> None:
    """1e6 periods of 0.1 s, and a noise of 10 kHz for a minute, are no one's slip."""
    scene_of(tmp_path, slider(duration_s=1e5, computer={"period_s": 0.1}))
    noisy = {"effects": {"pot_noise": "white"}, "device": {"potentiometer": {"noise_bandwidth_hz": 1e4}}}
    scene_of(tmp_path, merge(slider(duration_s=60.0), noisy))
