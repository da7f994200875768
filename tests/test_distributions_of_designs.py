"""`--mc N` of compare and sweep: designs by their distributions, with the same draws."""

import csv
import json
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest
from scipy import stats
from support import SCENES

from cosim import cli
from cosim.tolerance.common_draws import Named

PRESS = str(SCENES / "press.toml")
ASKED = ["--measure", "least_stiffness", "--json"]


def call(capsys: pytest.CaptureFixture[str], *words: str, code: int = 0) -> str:
    assert cli.main([*words]) == code
    printed = capsys.readouterr()
    return printed.out if code == 0 else printed.err


def test_a_variables_numbers_are_its_own() -> None:
    """Uniform, independent, and the same wherever the variable is one among others."""
    points = Named(("r1", "r2", "c1"), 5)
    result = points.uniforms(0, 4000)
    assert np.array_equal(result[1001:1100], points.uniforms(1001, 99))
    assert np.array_equal(Named(("x", "c1"), 5).uniforms(7, 50)[:, 1], result[7:57, 2])
    for column in result.T:
        assert stats.kstest(column, "uniform").pvalue > 1e-3
    # of three correlations by 4,000 samples: four of their standard deviations
    assert np.abs(np.corrcoef(result, rowvar=False)[np.triu_indices(3, 1)]).max() < 4.0 / np.sqrt(4000)
    assert not np.array_equal(result, Named(("r1", "r2", "c1"), 6).uniforms(0, 4000))


def test_values_of_a_resistor_by_their_distributions(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A sum amplifier's feedback 2 % larger renders 2 % more of the springs, in every single device."""
    out = tmp_path / "compared"
    words = ["compare", PRESS, "--set", "r_sum_fb=10.2k", *ASKED,
             "--mc", "6", "--spec", "least_stiffness > 0", "-o", str(out)]  # fmt: skip
    result = json.loads(call(capsys, *words))
    first, second = result["sides"]
    files = sorted(out.glob("*/samples.parquet"))
    tables = [pq.read_table(path)["least_stiffness"].to_numpy() for path in files]
    assert len(tables) == 2
    change = second["measures"]["least_stiffness"]["change_of_mean"]
    difference = tables[1] - tables[0]
    half = stats.t.ppf(0.975, 5) * difference.std(ddof=1) / np.sqrt(6)
    assert change["value"] == pytest.approx(difference.mean(), rel=1e-12, abs=1e-18)
    assert change["high"] - change["value"] == pytest.approx(half, rel=1e-9)
    assert first["measures"]["least_stiffness"]["change_of_mean"]["value"] == 0.0
    # the same draws: what differs scatters less than the devices themselves do
    assert difference.std(ddof=1) < 0.2 * tables[0].std(ddof=1)
    assert list(second["yields"]) == ["least_stiffness >= 0 N m/rad"]
    with (out / "distributions.csv").open() as stream:
        assert [row["design"] for row in csv.DictReader(stream)] == [first["label"], second["label"]]
    picture = next(Path(name) for name in result["pictures"] if name.endswith("stiffness.png"))
    assert picture.read_bytes()[:4] == b"\x89PNG"
    # once more: nothing is measured again
    times = [path.stat().st_mtime_ns for path in files]
    assert json.loads(call(capsys, *words)) == result
    assert [path.stat().st_mtime_ns for path in files] == times


@pytest.mark.slow
def test_a_sweep_by_distributions(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    result = json.loads(
        call(capsys, "sweep", PRESS, "r_sum_fb=9.8k:10.2k:3", "--set", "solver.model=linear", *ASKED,
             "--mc", "4", "-o", str(tmp_path / "swept"))
    )  # fmt: skip
    assert [side["label"] for side in result["sides"]] == [
        f"r_sum_fb={v}" for v in ("9800", "10000", "10200")
    ]


def test_slips_are_reported(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = ["-o", str(tmp_path / "out")]
    assert "give their number" in call(capsys, "compare", PRESS, "--spec", "k_max > 5", *out, code=2)
    assert "not a possible number of devices" in call(
        capsys, "compare", PRESS, "--set", "r_sum_fb=10.2k", "--mc", "1", *out, code=2
    )
    assert "one device" in call(
        capsys, "compare", PRESS, "--set", "r_sum_fb=10.2k", "--mc", "9", "--last", "x", *out, code=2
    )
    assert "not a possible number of devices" in call(
        capsys, "sweep", PRESS, "seed=1,2", "--mc", "0", *out, code=2
    )
    # neither is ignored in silence
    assert "--tol = '1e-3'" in call(
        capsys, "sweep", PRESS, "seed=1,2", "--mc", "4", "--tol", "1e-3", *out, code=2
    )
    assert "--most = 4" in call(
        capsys, "compare", PRESS, "--set", "seed=1,2", "--mc", "4", "--most", "4", *out, code=2
    )
