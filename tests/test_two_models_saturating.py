"""Two levels where `linear` is wrong: a board that saturates within its working range stays unbiased."""

import json
import math

import pytest
from support import SCENES

from cosim import cli

#: Dropped from 0.2 m onto 150 N/m the mass goes deeper than the difference amplifier's output reaches (13.5 V
#: at some 31 mm): the push stops growing there, which `linear` does not know.
DEEP = (
    "device.slider.origin_m=[0.0,0.2]", "computer.method=continuous", "computer.discrete_stiffness_n_per_m=0",
    "computer.analog_stiffness_n_per_m=150", "effects.opamp_saturation=true", "duration_s=0.25",
)  # fmt: skip
N = 80


def study(capsys, out, *words):
    settings = [word for each in DEEP for word in ("--set", each)]
    measures = ["--measure", "peak_current", "--measure", "max_penetration"]
    asked = ["mc", str(SCENES / "drop.toml"), "--model", "spice", "-n", str(N), "--workers", "1", "--json"]
    assert cli.main([*asked, *settings, *measures, "-o", str(out), *words]) == 0
    return json.loads(capsys.readouterr().out)


@pytest.mark.slow
def test_a_saturating_measure_is_unbiased_and_its_gain_is_reported(tmp_path, capsys):
    """Against plain samples of another seed; `linear` alone is wrong by a quarter in the current."""
    both = study(capsys, tmp_path / "two", "--two-level", "--seed", "11")["two_level"]
    plain = study(capsys, tmp_path / "plain", "--seed", "12")["measures"]
    assert (both["dear"], both["cheap"]) == ("spice", "linear")
    for name, far in (("peak_current", 0.2), ("max_penetration", 0.005)):
        level, pilot = both["moments"][name], both["moments"][name]["pilot"]
        known = plain[name]["mean"]
        assert abs(pilot["middle_of_cheap"] / known["value"] - 1.0) > far  # what it corrects
        # half widths of 95 % are near two standard errors; four of these for the difference of two
        errors = [(level["mean_high"] - level["mean_low"]) / 4.0, (known["high"] - known["low"]) / 4.0]
        assert abs(level["mean"] - known["value"]) < 4.0 * math.hypot(*errors), name
        assert 0.0 < level["gain"] < math.inf
        assert abs(pilot["correlation"]) <= 1.0
        print(f"{name}: correlation {pilot['correlation']:.4f}, gain {level['gain']:.3g}, {level['word']}")
