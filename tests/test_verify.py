"""`cosim verify`: a result is what comes out again, or what differs is told."""

import json
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from support import SCENES

from cosim import cli

DROP = str(SCENES / "drop.toml")
SHORT = ["--set", "duration_s=0.05", "--set", "solver.model=linear"]


def call(capsys: pytest.CaptureFixture[str], *words: str, code: int = 0) -> str:
    assert cli.main([*words]) == code
    printed = capsys.readouterr()
    return printed.err if code == 2 else printed.out


def test_a_run_comes_out_again(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "run"
    call(capsys, "run", DROP, *SHORT, "-o", str(out))
    assert "the same, bit for bit" in call(capsys, "verify", str(out))
    record = json.loads((out / "run.json").read_text())
    assert record["provenance"]["versions"]["cosim"]
    # a number changed behind the tool's back is found by its seal, before anything runs
    raw = bytearray((out / "signals.raw").read_bytes())
    raw[-1] ^= 1
    (out / "signals.raw").write_bytes(raw)
    assert "signals.raw" in call(capsys, "verify", str(out), code=2)


def test_a_study_comes_out_again_and_a_changed_number_is_found(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "mc"
    call(capsys, "mc", DROP, "--model", "linear", "--measure", "eta", "--measure", "k_max", "-n", "6",
         "--spec", "k_max > 100", "-o", str(out), "--workers", "1")  # fmt: skip
    result = json.loads(call(capsys, "verify", str(out), "--samples", "3", "--json"))
    assert result["same"]
    assert len(result["repeated"]) == 3
    file = out / "samples.parquet"
    table = pq.read_table(file)
    k_max = table["k_max"].to_numpy().copy()
    k_max[4] = np.nextafter(k_max[4], np.inf)
    place = table.schema.get_field_index("k_max")
    pq.write_table(table.set_column(place, table.schema.field(place), pa.array(k_max)), file)
    answer = call(capsys, "verify", str(out), "--samples", "6", code=1)
    assert "sample 4: k_max" in answer
    assert answer.count("sample ") == 1
    # another version, another scene, no record of what was asked
    record = json.loads((out / "mc.json").read_text())
    for change, expected in (
        ({"asked": {**record["asked"], "cosim": "0.0.1"}}, "was written by cosim 0.0.1"),
        ({"asked": None}, "does not say what was asked"),
        ({"digest": "0" * 64}, "have changed since"),
        ({"asked": {**record["asked"], "n": None}}, "is not a record of a study"),
        ({"asked": {**record["asked"], "n": -3}}, f"{out / 'mc.json'}: -n = -3: is not a possible"),
        ({"asked": {**record["asked"], "measures": ["k_ma"]}}, f"{out / 'mc.json'}: --measure = 'k_ma'"),
        ({"sampling": {**record["sampling"], "method": "lhs", "replicates": 0}}, "holds another study"),
    ):
        (out / "mc.json").write_text(json.dumps({**record, **change}))
        assert expected in call(capsys, "verify", str(out), code=2)


def test_damaged_unfinished_and_partial_studies_say_what_to_do(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """They advised -o, which `verify` does not have, and called an unfinished study none."""
    out, shard, words = tmp_path / "mc", tmp_path / "shard", ["--workers", "1", "-n", "4"]
    asked = ["mc", DROP, "--model", "linear", "--measure", "k_max"]
    call(capsys, *asked, *words, "-o", str(out))
    call(capsys, *asked, *words, "--shard", "1/2", "-o", str(shard))
    told = call(capsys, "verify", str(shard), code=2)
    assert "an unfinished study, or a shard" in told
    kept = {path.name: path.read_bytes() for path in out.iterdir() if path.is_file()}
    for folder, again in ((out, ["verify", str(out)]), (shard, [*asked, "-n", "4", "--merge", str(shard)])):
        file = folder / "samples.parquet"
        file.write_bytes(file.read_bytes()[:900])
        told = call(capsys, *again, *(["-o", str(tmp_path / "all")] if "--merge" in again else []), code=2)
        assert f"{file}: is damaged" in told
        assert " -o" not in told
    assert {path.name: path.read_bytes() for path in out.iterdir() if path.is_file()} == kept | {
        "samples.parquet": kept["samples.parquet"][:900]
    }
    (out / "study.json").unlink()  # what is damaged is not taken for another's
    assert "is damaged, or not what" in call(capsys, "verify", str(out), code=2)


def test_slips_are_reported(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert "holds neither a run" in call(capsys, "verify", str(tmp_path), code=2)
    assert "not a possible number of samples" in call(
        capsys, "verify", str(tmp_path), "--samples", "0", code=2
    )


def test_the_folder_of_all_results_says_which_to_name(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    top = tmp_path / "out"
    for k, record in enumerate(("run.json", "mc.json", "study.json")):
        (top / f"deeper{k}" / "one").mkdir(parents=True)
        (top / f"deeper{k}" / "one" / record).write_text("{}")
    for k in range(9):
        (top / f"run{k}").mkdir()
        (top / f"run{k}" / "run.json").write_text("{}")
    result = call(capsys, "verify", str(top), code=2)
    # of eleven runs and studies of tolerances eight are shown; deeper2 has neither
    assert "below it: deeper0/one, deeper1/one, run0, run1, run2, run3, run4, run5, and 3 more" in result
    deep = tmp_path / "all"  # `report` itself takes the results right below a folder
    deep.mkdir()
    for name in ("deeper0", "deeper1"):
        (top / name).rename(deep / name)
    result = call(capsys, "report", str(deep), code=2)
    assert "below it: deeper0/one" in result
    assert "deeper1" not in result  # a study of tolerances has a page of its own
