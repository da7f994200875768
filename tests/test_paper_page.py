"""Numbers that the page on the paper quotes are those of its studies; the page names each study."""

import re
from pathlib import Path

import pytest

import cosim

ROOT = Path(__file__).resolve().parents[1]
PAGE = (ROOT / "docs/paper.md").read_text(encoding="utf-8")

#: Study -> (what a verdict found, with a number; the number that the page quotes; by how much it may differ;
#: the words of the page). Bands: rounding of the quoted digits and, of shares of poses, a few poses.
QUOTED = {
    "0_1_acceptance": [
        (r"^([\d.]+) % at most \(as built", 0.004, 0.0005, "0.004 % on ideal parts"),
        (r"as built: ([\d.]+) %", 0.02, 0.005, "0.02 % as built"),
        (r"within 1 % in ([\d.]+) % of the workspace", 40.0, 1.0, "within 1 % in 40 % of the workspace"),
        (r"half way to the wall in ([\d.]+) %", 98.0, 1.0, "in 98 %"),
    ],
    "3_fig16_18": [(r"^([\d.]+); by the motors' stiffness", 0.569, 0.001, "ratio 0.569 where 0.571 is due")],
    "5_1_eta": [
        (r"^([\d.]+) % at 100 N/m", 4.0, 0.5, "Delay eats 4 % of the damping"),
        (r"^([\d.]+) N/m, off by", 2400.0, 50.0, "2.4 kN/m"),
    ],
    "6a_ceiling": [
        (r"^([\d.]+) N/m \(potentiometer noise above 0\.05 N rms\)", 58.0, 0.5, "58 N/m"),
        (r"([\d.]+) N/m \(multiplier at full scale\)", 169.0, 0.5, "169 N/m"),
        (r"([\d.e+]+) N/m \(circuit delay: passive device\)", 3900.0, 50.0, "3.9 kN/m by delay"),
    ],
    "7_footnote2": [(r"^median ([\d.]+) %", 15.0, 0.5, "shifts by 15 % in the median pose")],
}


@pytest.mark.parametrize("name", QUOTED)
def test_the_page_says_it(name):
    text = " ".join(PAGE.split())
    for *_, words in QUOTED[name]:
        assert words in text, words
    assert f"{name}.toml" in text


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::cosim.caution.Doubt")
@pytest.mark.parametrize("name", QUOTED)
def test_the_study_finds_it(name):
    found = [verdict.found for verdict in cosim.study(ROOT / f"scenes/paper/{name}.toml").verdicts]
    for pattern, quoted, band, words in QUOTED[name]:
        numbers = [float(match[1]) for text in found if (match := re.search(pattern, text))]
        assert any(abs(number - quoted) <= band for number in numbers), (words, numbers, found)
