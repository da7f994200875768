"""Numbers that the page on the paper quotes are those of its studies; the page names each study."""

import re
from dataclasses import replace
from pathlib import Path

import pytest

from cosim.storage.checkpoint import Points
from cosim.studies.study import load_study

ROOT = Path(__file__).resolve().parents[1]
PAGE = (ROOT / "docs/paper.md").read_text(encoding="utf-8")

#: Study -> (what a verdict found, or a row of a short table, with a number, or two of which the page says by
#: how many per cent the second is less; what the page quotes; by how much it may differ; the page's words).
#: Bands: rounding of the quoted digits and, of shares of poses, a few poses.
QUOTED = {
    "0_1_acceptance": [
        (r"^([\d.]+) % at most \(as built", 0.004, 0.0005, "0.004 % on ideal parts"),
        (r"as built: ([\d.]+) %", 0.02, 0.005, "0.02 % as built"),
        (r"within 1 % in ([\d.]+) % of the workspace", 40.0, 1.0, "within 1 % in 40 % of the workspace"),
        (r"half way to the wall in ([\d.]+) %", 98.0, 1.0, "in 98 %"),
    ],
    "3_fig16_18": [(r"^([\d.]+); by the motors' stiffness", 0.569, 0.001, "ratio 0.569, expected 0.571")],
    "5_1_eta": [
        (r"^([\d.]+) % at 100 N/m", 4.0, 0.5, "Delay eats 4 % of the damping"),
        (r"^([\d.]+) N/m, off by", 2400.0, 50.0, "2.4 kN/m"),
        (
            r"^limits: current drive;.* practical limit b/sum \[N/m\] ([\d.]+)",
            250.0,
            5.0,
            "0.25 kN/m with current drive",
        ),
    ],
    "6a_ceiling": [
        (r"^([\d.]+) N/m \(potentiometer noise above 0\.05 N rms\)", 58.0, 0.5, "58 N/m"),
        (r"([\d.]+) N/m \(multiplier at full scale\)", 169.0, 0.5, "169 N/m"),
        (r"([\d.e+]+) N/m \(circuit delay: passive device\)", 3900.0, 50.0, "3.9 kN/m by delay"),
    ],
    "1_fig13": [
        (r"^slope (-[\d.]+); of the exact", -0.94, 0.005, "log-log slope -0.94"),
        (r"of the exact limit (-[\d.]+)$", -0.93, 0.005, "that of the exact limit -0.93"),
        (r"^-([\d.]+) % at 3 ms", 2.6, 0.05, "at most 2.6 % up to 10 ms"),
        (r"-([\d.]+) % at 52\.7 ms", 43.0, 0.5, "at 53 and 73 ms"),
        (r"-([\d.]+) % at 72\.6 ms", 53.0, 0.5, "43 and 53 % softer"),
        (
            r"\+([\d.]+) N/m with an ideal circuit; with its own differentiator \+([\d.]+) exact",
            18.0,
            0.5,
            "differentiator takes 18 % of the gain at 3 ms",
        ),
    ],
    "6b_onset": [
        (r"^rests up to .* ([\d.]+) at 25 ms", 400.0, 5.0, "on up to 400 N/m at 25 ms"),
        (r"^rests up to .* ([\d.]+) at 100 ms", 80.0, 1.0, "80 N/m at 100 ms"),
    ],
    "7_footnote2": [(r"^median ([\d.]+) %", 15.0, 0.5, "shifts by 15 % in the median pose")],
}


@pytest.mark.parametrize("name", QUOTED)
def test_the_page_says_it(name):
    text = " ".join(PAGE.split())
    for *_, words in QUOTED[name]:
        assert words in text, words
    assert f"{name}.toml" in text


#: Curves of Fig. 13 that the page quotes; all of them with their variations take three times as long.
CURVES = ("discrete only", "with 100 N/m analog", "with 0.11 N s/m analog")


def texts(name):
    """Return what the verdicts of a study found, and the rows of its short tables, each as a text."""
    spec = load_study(ROOT / f"scenes/paper/{name}.toml")
    if name == "1_fig13":
        families = tuple(each for each in spec.parameters.families if each.name in CURVES)
        spec = replace(spec, parameters=spec.parameters.model_copy(update={"families": families}))
    with Points(None) as points:
        result = spec.study.analyse(spec, points)
    rows = [
        f"{table.name}: "
        + "; ".join([str(row[0]), *map(" ".join, zip(table.columns, map(str, row), strict=True))])
        for table in result.tables
        for row in list(zip(*table.columns.values(), strict=True))[:20]
    ]
    return [verdict.found for verdict in result.verdicts] + rows


def value(match):
    """Return the number of a match; of two, by how many per cent the second is less than the first."""
    numbers = [float(each) for each in match.groups()]
    return numbers[0] if len(numbers) == 1 else 100.0 * (1.0 - numbers[1] / numbers[0])


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::cosim.caution.Doubt")
@pytest.mark.parametrize("name", QUOTED)
def test_the_study_finds_it(name):
    found = texts(name)
    for pattern, quoted, band, words in QUOTED[name]:
        numbers = [value(match) for text in found if (match := re.search(pattern, text))]
        assert any(abs(number - quoted) <= band for number in numbers), (words, numbers, found)
