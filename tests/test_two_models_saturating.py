"""Two levels where `linear` is wrong: a shipped board that saturates in its range stays unbiased."""

import json
import math

import pytest
from support import SCENES

from cosim import cli

#: Dropped from 50 mm onto 150 N/m the mass goes deeper than the difference amplifier's output reaches (13.5 V
#: at some 31 mm): the push stops growing there, which `linear` does not know.
DEEP = (
    "device.slider.origin_m=[0.0,0.05]", "duration_s=0.25",
    "computer.method=continuous", "computer.discrete_stiffness_n_per_m=0",
    "computer.analog_stiffness_n_per_m=150", "effects.opamp_saturation=true",
)  # fmt: skip
MEASURES = ("peak_current", "max_penetration")
#: Half of a 95 % interval in standard errors.
Z = 1.96


def study(capsys, out, *words):
    settings = [word for each in DEEP for word in ("--set", each)]
    settings += [word for each in MEASURES for word in ("--measure", each)]
    asked = ["mc", str(SCENES / "drop.toml"), "--model", "spice", "--workers", "1", "--json", "-o", str(out)]
    assert cli.main([*asked, *settings, *words]) == 0
    return json.loads(capsys.readouterr().out)


@pytest.mark.slow
def test_measures_of_a_board_that_saturates_are_unbiased_and_their_gain_is_reported(tmp_path, capsys):
    """48 devices on both models against 256 Sobol points on `spice` alone, to four standard errors of both.

    `linear` knows nothing of the limit: its current is 9 % too large and its depth 2 % too small, tens of
    standard errors. The current follows it badly (correlation 0.8: its peak is where the amplifier stops),
    and two models save a quarter at most, or are left aside with a word; the depth follows with 0.999.
    """
    both = study(capsys, tmp_path / "two", "-n", "48", "--two-level")["two_level"]
    plain = study(capsys, tmp_path / "plain", "-n", "256", "--sampling", "sobol")["measures"]
    assert (both["dear"], both["cheap"]) == ("spice", "linear")
    for name in MEASURES:
        level, pilot = both["moments"][name], both["moments"][name]["pilot"]
        for what, known in (("mean", plain[name]["mean"]), ("spread", plain[name]["standard_deviation"])):
            halves = level[f"{what}_high"] - level[f"{what}_low"], known["high"] - known["low"]
            error = math.hypot(*halves) / 2.0 / Z
            assert abs(level[what] - known["value"]) < 4.0 * error, (name, what)
            if what == "mean":  # what `linear` alone would say
                assert abs(pilot["middle_of_cheap"] - known["value"]) > 10.0 * error, name
        assert level["gain"] > 0.0
    current, depth = (both["moments"][name] for name in MEASURES)
    assert current["pilot"]["correlation"] < 0.95
    assert depth["pilot"]["correlation"] > 0.99
    assert depth["gain"] < min(current["gain"], 1.0)
    assert depth["word"] == ""
