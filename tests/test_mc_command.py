"""`cosim mc` from the command line: end to end, replayed, and what it refuses."""

import csv
import json
import re
import shlex
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
from scipy import stats
from support import ROOT, SCENES

from cosim import cli
from cosim.commands.mc import replay, whole
from cosim.tolerance.distribution_functions import extracted_calls
from cosim.tolerance.monte_carlo import Study
from cosim.tolerance.random_variables import Tolerances
from cosim.tolerance.scene_study import _endless
from cosim.tolerance.unit_cube import sampling

PRESS = str(SCENES / "press.toml")
ASKED = ["mc", PRESS, "--model", "linear", "--measure", "curl", "--spec", "least_stiffness > -0.0001"]


def call(capsys: pytest.CaptureFixture[str], *words: str, code: int = 0) -> str:
    assert cli.main([*words]) == code
    printed = capsys.readouterr()
    return printed.out if code == 0 or "--json" in words else printed.err


def test_a_study_its_files_and_one_of_its_devices_again(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "mc"
    result = json.loads(call(capsys, *ASKED, "-n", "52", "-o", str(out), "--json"))
    assert result["sampling"]["n"] == 52
    with (out / "samples.csv").open() as stream:
        rows = list(csv.DictReader(stream))
    assert [row["sample"] for row in rows] == [str(k) for k in range(52)]
    curl = np.array([float(row["curl [N/m]"]) for row in rows])
    mean = result["measures"]["curl"]["mean"]
    assert mean["value"] == pytest.approx(curl.mean())
    assert mean["high"] - mean["low"] == pytest.approx(
        2 * stats.t.ppf(0.975, 51) * curl.std(ddof=1) / np.sqrt(52)
    )
    passed = sum(int(row["pass"]) for row in rows)
    share = result["yields"]["least_stiffness >= -0.0001 N m/rad"]
    exact = stats.binomtest(passed, 52).proportion_ci(method="exact")
    assert (share["low"], share["high"]) == pytest.approx((exact.low, exact.high))
    # by symmetry of the two joints' windings, which make the curl between them
    shares = {line["name"]: line["share"]["curl"]["value"] for line in result["bill"]}
    assert {line["name"] for line in result["bill"][:6]} >= {"xdrv1.xmotor:motor_r", "xdrv2.xmotor:motor_r"}
    assert sum(shares.values()) == pytest.approx(1.0, abs=0.35)
    worst = result["worst"]["curl"][0]
    page = (out / "report.html").read_text()
    assert f"--sample {worst[0]}<" in page
    # the head has the command of the whole study
    assert re.search(r"<code>cosim mc [^<]* --model linear -n 52</code>", page)
    again = json.loads(call(capsys, *ASKED, "--sample", str(worst[0]), "--json"))
    assert again["measures"]["curl"] == worst[1]
    # the same call is the same study; another one does not write over it
    call(capsys, *ASKED, "-n", "52", "-o", str(out), "--seed", "2", code=2)
    assert (out / "samples.csv").is_file()


@pytest.mark.parametrize(
    ("words", "reason"),
    [
        (["-n", "0"], "not a possible number of samples"),
        (
            ["-n", "40", "--measure", "k_max", "--until", "k_max +- 5 N/m", "--two-level"],
            "-n: has no meaning",
        ),
        (["--measure", "k_max", "--until", "k_max +- 5 N/m", "--two-level"], "only their samples tell"),
        (["--spec", "k_max in 9..3"], "empty range"),
        (["--cluster", "tcp://127.0.0.1:9", "--measure", "k_max"], "--cluster"),
        (["--measure", "curll"], "nearest is curl"),
        (["--spec", "curll > 3"], "nearest is curl"),
        (["--spec", "curl in 3..3"], "empty range"),
        (["--spec", "curl about 3"], "is not a specification"),
        (["--spec", "curl < 1e999"], "is not a specification"),
        (["--until", "curl +- 1e999", "--measure", "curl"], "is not a precision"),
        (["--until", "yield +- 0.5%"], "needs a --spec"),
        (
            ["--until", "yield +- 60%", "--spec", "curl < 3"],
            "'yield +- 60%': tells nothing of a yield (allowed",
        ),
        (["--until", "k_max +- 5 N/m"], "not asked for"),
        (["--yield", "99"], "is not a yield"),
        (["--set", "tolerance.mass=150%"], "more tolerance than value"),
        (["--set", "tolerance.components.rsp99=1%"], "nearest is rsp"),
        (["--set", "tolerance.trim.rsp11=curl of 3"], "is not a trim"),
        (
            ["--set", 'tolerance.trim."xder1.c21"="curl to 3"'],
            "xder1.c21 is no resistor (allowed: a resistor",
        ),
        (["--set", "tolerance.trim.rsp11=k_max to -3 N/m"], "k_max is never negative (allowed: > 0 N/m)"),
        (
            ["--list", "--set", "tolerance.trim.rsp11=rendered_stiffness to -100 N/m"],
            "'rendered_stiffness to -100 N/m': rendered_stiffness is never negative (allowed: > 0 N/m)",
        ),
        (
            [
                "--set",
                "tolerance.components.rsp11=tol=1% match=board:bag",
                "--set",
                "tolerance.components.rsp12=tol=1% match=board:bagg",
            ],
            "rsp11 is alone in the network board:bag; nearest is board:bagg",
        ),
        (["--set", "tolerance.components.rsp11=lott=1%"], "'lott=1%' is no part of a tolerance"),
        (["--set", "tolerance.mass=lot=-1%"], "negative"),
        (["--shard", "²/3", "--measure", "k_max"], "--shard = '²/3': is not a shard"),
        (["--shard", "9/9", "-n", "4", "--measure", "k_max", "-o", "{out}"], "I/N with I <= N <= 4"),
        (["--sampling", "sobol", "--sample", "100000"], "not a sample of the study"),
    ],
)
def test_slips_are_errors_at_once(
    words: list[str], reason: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = [word.format(out=tmp_path / "mc") for word in words]
    assert reason in call(capsys, "mc", PRESS, *words, code=2)
    assert not (tmp_path / "mc").exists()


@pytest.mark.parametrize(("known", "n", "reason"), [
    (64, 2 * 10**7, "would take 20000000 samples"),
    (64, 10**18, "would take more than 1e+18 samples"),  # it said 1000000000000000000
    (3, 10**18, "cannot be judged: 3 of the pilot's 64 devices have the measure"),
])  # fmt: skip
def test_a_precision_out_of_reach_says_why(known: int, n: int, reason: str) -> None:
    results = np.full((64, 1), np.nan)
    results[:known] = 1.0
    pilot = Study(Tolerances((), ()), sampling("plain", 64, 0, 1), "ideal", ("k_max",), np.ones(1), results)
    assert _endless(n, "k_max", pilot) == reason


def test_ngspices_own_loop_draws_the_same(tmp_path: Path) -> None:
    """A divider of two agauss resistors, 10,000 draws of either, by Kolmogorov and Smirnov."""
    if shutil.which("ngspice") is None:
        pytest.skip("the ngspice program is not installed")
    value = "agauss(1k,100,3)"
    deck = tmp_path / "loop.cir"
    deck.write_text(
        f"loop\nV1 in 0 1\nR1 in out {{{value}}}\nR2 out 0 {{{value}}}\n.control\nsetseed 7\nrepeat 10000\n"
        "reset\nop\nprint v(out)\ndestroy all\nend\nquit\n.endc\n.end\n"
    )
    done = subprocess.run(["ngspice", "-b", deck], capture_output=True, text=True, timeout=300, check=False)
    theirs = np.array([float(v) for v in re.findall(r"^v\(out\) = (\S+)", done.stdout, re.M)])
    assert len(theirs) == 10_000
    nominal, shape = extracted_calls(value)[1]["drawn__1"]
    r = nominal + shape.inverse(np.random.default_rng(3).random((10_000, 2)))
    assert stats.ks_2samp(theirs, r[:, 1] / r.sum(axis=1)).pvalue > 1e-3


def test_a_tolerance_that_was_edited_makes_another_study(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """In a netlist it is a comment, a scene names a histogram's file only: old samples came out as new."""
    shutil.copytree(ROOT / "netlists", tmp_path / "netlists")
    scene, out = tmp_path / "scenes" / "press.toml", tmp_path / "mc"
    lot = scene.parent / "lot.csv"
    scene.parent.mkdir()
    scene.write_text(f'{Path(PRESS).read_text()}\n[tolerance.components]\nrsp11 = "histogram=lot.csv"\n')
    lot.write_text("percent\n-1\n0\n1\n")
    words = ["mc", str(scene), "--model", "linear", "--measure", "curl", "-n", "2", "-o", str(out)]
    call(capsys, *words)
    before = (out / "samples.parquet").read_bytes()
    call(capsys, *words)
    summer = tmp_path / "netlists" / "blocks" / "summer.cir"
    for file, old, new in ((summer, "24.3k $ tol=1%", "24.3k $ tol=2%"), (lot, "-1", "-5")):
        text = file.read_text()
        assert old in text
        file.write_text(text.replace(old, new))
        assert "holds another study" in call(capsys, *words, code=2), file
        file.write_text(text)
    call(capsys, *words)
    assert (out / "samples.parquet").read_bytes() == before


@pytest.mark.parametrize(
    ("words", "reason"),
    [
        (["--list", "-o", "x"], "--out: has no meaning beside --list"),
        (["--list", "-n", "5"], "-n: has no meaning beside --list"),
        (["--sample", "0", "--worst-case"], "--worst-case: has no meaning beside --sample"),
        (["--sample", "0", "-o", "x"], "--out: has no meaning beside --sample"),
        (["--shard", "1/2", "--merge", "a"], "--merge: has no meaning beside --shard"),
        (["--shard", "1/2", "--worst-case"], "--worst-case: has no meaning beside --shard"),
        (["--merge", "a", "--workers", "2"], "--workers: has no meaning beside --merge"),
        (["--until", "k_max +- 5", "-n", "5"], "-n: has no meaning beside --until"),
        (["--yield", "99%"], "needs a --spec"),
        # an array job whose variable is not set measured the whole study in each of its processes
        (["--shard", ""], "--shard = '': is empty"),
        (["--cluster", "", "--until", "", "-o", ""], "--out = '': is empty"),
        (["--set", "seed=1", "--set", "seed=2"], "--set = 'seed=2': is set twice\n"),
        (["--seed", "-1"], "--seed = -1: is not a valid seed"),
        (["--seed", "9" * 30], "is not a valid seed"),
    ],
)
def test_no_option_is_ignored_in_silence(
    words: list[str], reason: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert cli.main(["mc", PRESS, "--measure", "k_max", *words]) == 2
    assert reason in capsys.readouterr().err


def test_a_command_to_replay_grants_what_the_study_was_granted() -> None:
    """Without --include the command of a worst device was refused."""
    typed = ["mc", PRESS, "--trust", "--include", "/vendor parts", "--include", "b"]
    args = cli.build_parser(["mc"]).parse_args(typed)
    for command in (f"{replay(args, 4)} 2", whole(args)):
        again = cli.build_parser(["mc"]).parse_args(shlex.split(command)[1:])
        assert (again.trust, again.include) == (True, ["/vendor parts", "b"])


@pytest.mark.slow
def test_a_sample_of_a_number_that_a_pilot_chose_replays(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Randomised points depend on how many there are: the command on the page says the number."""
    words = ["mc", PRESS, "--model", "linear", "--measure", "curl", "--sampling", "sobol"]
    out = tmp_path / "mc"
    study = json.loads(call(capsys, *words, "--until", "curl +- 1 N/m", "-o", str(out), "--json"))
    n, (number, value) = study["sampling"]["n"], study["worst"]["curl"][0]
    assert study["sampling"]["replicates"] == 16
    page = (out / "report.html").read_text()
    assert f"--sampling sobol -n {n} --sample {number}<" in page
    again = json.loads(call(capsys, *words, "-n", str(n), "--sample", str(number), "--json"))
    assert again["measures"]["curl"] == value
