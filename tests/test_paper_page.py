"""Numbers that the page on the paper quotes are those of its studies; the page names each study."""

import re
from dataclasses import replace
from pathlib import Path

import pytest
from paper_quotes import QUOTED

from cosim.storage.checkpoint import Points
from cosim.studies.study import load_study

ROOT = Path(__file__).resolve().parents[1]
PAGE = (ROOT / "docs/paper.md").read_text(encoding="utf-8")


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
    return [verdict.outcome for verdict in result.verdicts] + rows


def value(match):
    """Return the number of a match; of two, by how many per cent the second is less than the first."""
    numbers = [float(each) for each in match.groups()]
    return numbers[0] if len(numbers) == 1 else 100.0 * (1.0 - numbers[1] / numbers[0])


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::cosim.caution.Doubt")
@pytest.mark.parametrize("name", QUOTED)
def test_the_study_finds_it(name):
    result = texts(name)
    for pattern, quoted, band, words in QUOTED[name]:
        numbers = [value(match) for text in result if (match := re.search(pattern, text))]
        assert any(abs(number - quoted) <= band for number in numbers), (words, numbers, result)
