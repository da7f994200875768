"""Every number with a unit that a page quotes is typed or printed there, or held by what is named here."""

import re
import subprocess
import sys
from pathlib import Path

import pytest
from paper_quotes import QUOTED
from quoted_numbers import prose, unaccounted

import cosim

ROOT = Path(__file__).resolve().parents[1]
PAGES = {
    str(path.relative_to(ROOT)): path.read_text(encoding="utf-8")
    for path in (ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md")))
}
#: Page -> phrase -> scene, key and value that it repeats.
SCENES = {
    "README.md": {
        "a 45 degree wall, sampled every 25 ms": ("slope", "computer.period_s", 0.025),
        "a 45° wall while the computer samples every 25 ms": ("slope", "computer.period_s", 0.025),
    },
    "docs/index.md": {
        "a 45 degree wall, for three control methods sampled every 25 ms": (
            "slope",
            "computer.period_s",
            0.025,
        ),
        "a 45° wall while the computer samples every 25 ms": ("slope", "computer.period_s", 0.025),
        "render its 100 N/m wall": ("press", "computer.analog_stiffness_n_per_m", 100.0),
    },
    "docs/tutorials/first-wall.md": {
        "The scene asks for 100 N/m": ("press", "computer.analog_stiffness_n_per_m", 100.0)
    },
    "docs/tutorials/first-edit.md": {
        "you ask for 100 N/m": ("press", "computer.analog_stiffness_n_per_m", 100.0)
    },
    "docs/explanation/certificates.md": {
        "of the damping at 100 N/m": ("slope", "computer.analog_stiffness_n_per_m", 100.0)
    },
}
#: Page -> phrase -> the file that states the number, and how.
CODE = {
    "docs/explanation/three-models.md": {
        "refused beyond 2 % of full scale": (
            "cosim/circuits/extraction/certificate.py",
            "WORST_NONLINEARITY = 0.02",
        )
    },
    "docs/glossary.md": {"A 0 V source": ("netlists/README.md", "0 V probes")},
    "docs/how-to/own-board.md": {"±15 V": ("cosim/circuits/decks.py", "SUPPLY_V = 15.0")},
    "docs/explanation/error-estimates.md": {
        "494 errors were measured against references: 99.6 % lay within": (
            "benchmarks/estimates.py",
            "--random N",
        ),
        "1674 errors) 99.0 % lay within it and 99.5 %": ("benchmarks/estimates.py", "--random N"),
        "on alone 98.8 % and 99.6 %": ("benchmarks/estimates.py", "--random N"),
        "326 errors) 95.7 % lay within the bound and 98.2 % within": (
            "benchmarks/estimates.py",
            "--random N",
        ),
        "one resistor moved by up to ±1 %": ("benchmarks/estimates.py", "rng.uniform(0.99, 1.01)"),
        "a 95 % bound": ("tests/test_quoted_numbers.py", "def test_bounds_hold_as_often_as_they_say"),
        "Of all paths 95 % lie so close": (
            "tests/test_noise_interval.py",
            "def test_in_95_of_100_runs_the_interval_holds_the_mean_over_paths",
        ),
        "93 to 97 % lie within": ("tests/test_noise_interval.py", "0.93 <= share <= 0.97"),
    },
    "docs/explanation/certificates.md": {
        "a difference above 2 % of rated current": (
            "cosim/circuits/extraction/certificate.py",
            "BENT = 0.02",
        ),
        "above 20 % there is no model": (
            "cosim/circuits/extraction/certificate.py",
            "WORST_LARGE_SIGNAL = 0.2",
        ),
        "bend by 0.4 % at level": ("cosim/circuits/extraction/certificate.py", "BENT"),
    },
    "docs/tutorials/first-monte-carlo.md": {
        "its design value of 104.5 N/m": (
            "docs/tutorials/first-wall.md",
            "check: rendered_stiffness 104.474",
        ),
        "the 95 % confidence interval": ("cosim/tolerance/intervals.py", "0.95"),
    },
    "docs/how-to/cluster.md": {
        "about 200 MB": ("tests/test_quoted_numbers.py", "def test_a_run_takes_the_memory_that_the_page_says")
    },
}
#: Page -> phrases that assume, count or round something that no program finds.
ASSUMED = {
    "README.md": ["what 1 % resistors do"],
    "docs/index.md": [
        "what 1 % resistors do", "to within 1 N/m of the design", "do you buy at 0.1 %",
        "3 minutes", "5 minutes",
    ],
    "docs/how-to/rare-failures.md": ["Zero failures in 64 samples only mean \"below about 5 %\""],  # 3/64
    "docs/paper.md": [
        "with 100 N/m of analog stiffness the limit drops beyond 40 ms", "10 mm deep", "at 1 N of preload",
        "the stiffness of 100 N/m shifts", "of the damping] at 100 N/m", "(felt above 0.05 N rms)",
        "ends above 40 ms: at 53 and 73 ms", "at 3 ms",
    ],
}  # fmt: skip


def known(name):
    phrases = [*SCENES.get(name, {}), *CODE.get(name, {}), *ASSUMED.get(name, ())]
    if name == "docs/paper.md":
        phrases += [words for study in QUOTED.values() for *_, words in study]
    return phrases


@pytest.mark.parametrize("name", PAGES)
def test_every_number_is_held_by_something(name):
    assert unaccounted(PAGES[name], known(name)) == []
    for phrase in known(name):
        assert phrase in prose(PAGES[name]), f"{name} does not say {phrase!r} any more"


def test_a_number_from_nowhere_is_seen():
    page = (
        "It is 12.5 N/m.\n\n<!-- output ±1 % -->\n```text\nk 12.51 N/m\n```\nThen 14 N/m, `a=7` and 7 N/m.\n"
    )
    assert [each.partition(":")[0] for each in unaccounted(page)] == ["14 N/m"]
    assert unaccounted(page, ["Then 14 N/m"]) == []


def test_numbers_of_scenes_and_code_are_those():
    for phrases in SCENES.values():
        for phrase, (name, key, value) in phrases.items():
            result = cosim.load_scene(ROOT / f"scenes/{name}.toml")
            for part in key.split("."):
                result = getattr(result, part)
            assert result == value, (phrase, result)
    for phrases in CODE.values():
        for phrase, (name, text) in phrases.items():
            assert re.search(re.escape(text), (ROOT / name).read_text(encoding="utf-8")), (phrase, name, text)


_PEAK_OF_A_CHILD = (
    "import resource, subprocess, sys; subprocess.run(sys.argv[1:], check=True);"
    "print(resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss)"
)


@pytest.mark.slow
def test_a_run_takes_the_memory_that_the_page_says(tmp_path):
    """About 200 MB a process, by a half, once all is compiled: a rule for a scheduler's limit."""
    command = [
        sys.executable,
        "-m",
        "cosim",
        "run",
        str(ROOT / "scenes/press.toml"),
        "--quiet",
        "-o",
        str(tmp_path / "out"),
    ]
    subprocess.run(command, cwd=ROOT, check=True)  # compiles what is not yet, with twice the memory
    # by a small process between: what this one starts begins with the peak of all tests before it
    asked = [sys.executable, "-c", _PEAK_OF_A_CHILD, *command]
    measured = subprocess.run(asked, cwd=ROOT, check=True, capture_output=True, text=True)
    assert 100.0 <= int(measured.stdout.split()[-1]) / 1024.0 <= 300.0


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::cosim.caution.Doubt")
def test_bounds_hold_as_often_as_they_say(capsys):
    """One scene at three tolerances, of what the page quotes: 95 % promised, all within three times."""
    from benchmarks.estimates import main

    assert main(["press"]) == 0
    out = capsys.readouterr().out
    match = re.search(
        r"^all: (\d+) errors, ([\d.]+) % within the bound, ([\d.]+) % within", out, re.MULTILINE
    )
    assert int(match[1]) >= 20
    assert float(match[2]) >= 95.0
    assert float(match[3]) == 100.0
