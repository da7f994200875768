"""Studies of many samples: what they hold and say of a part; samples that hang, parts that were left."""

import gc
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from engine_jobs import job
from formula_studies import SLOPE, formulas, measured
from support import SCENES

import cosim.tolerance.batch as batch_module
from cosim.errors import SimulationError
from cosim.plan import resolve
from cosim.scene import load_scene
from cosim.tolerance import study_results
from cosim.tolerance.batch import Batch
from cosim.tolerance.engine import run
from cosim.tolerance.unit_cube import Method, sampling

HERE = Path(__file__).parent


@pytest.mark.parametrize("method", ["plain", "lhs", "sobol"])
def test_a_thinned_sampling_has_the_first_points_of_each_randomisation(method: Method) -> None:
    whole = sampling(method, 640, 5, 3)
    few = whole.thinned(100)
    assert few.n == {"plain": 100}.get(method, 96)
    rows = whole.uniforms(0, whole.n).reshape(whole.replicates, whole.each, 5)[:, : few.each]
    assert np.array_equal(few.uniforms(0, few.n), rows.reshape(few.n, 5))
    assert np.array_equal(few.uniforms(7, 1)[0], rows.reshape(few.n, 5)[7])
    assert whole.thinned(whole.n) is whole
    assert "among" not in whole.as_dict()  # what a study is named by is what it was


@pytest.mark.parametrize("method", ["plain", "lhs"])
def test_a_long_study_looks_at_a_part_for_its_bill_and_says_so(method, monkeypatch) -> None:
    """Shares are slopes squared, whichever samples show them; mean and yield are those of all samples."""
    short = measured(formulas(2048, method=method))
    monkeypatch.setattr(study_results, "MOST_LOOKED_AT", 512)
    long = measured(formulas(2048, method=method))
    assert "512 of the 2048 samples" in " ".join(long.notes)
    assert "of the 2048 samples" not in " ".join(short.notes)
    assert long.summaries["peak_force"] == short.summaries["peak_force"]
    assert long.yields == short.yields
    shares = {line.name: line.share["peak_force"].value for line in long.bill}
    assert [shares[f"r{k}"] for k in range(6)] == pytest.approx(SLOPE**2, abs=0.01)


@pytest.mark.slow
def test_a_million_samples_and_their_page_stay_below_two_gigabytes(tmp_path: Path) -> None:
    """36 components, all samples kept, page written: 470 MB; with every sample's deviations it was 2.4 GB.

    A worker that measures real devices has 0.2 GB more, whatever their number.
    """
    command = [sys.executable, str(HERE / "million_samples.py"), str(tmp_path / "mc"), "1000000"]
    done = subprocess.run(command, capture_output=True, text=True, check=True, cwd=HERE)
    peak = re.match(r"(\d+) MB", done.stdout)
    assert peak, done.stderr
    assert int(peak[1]) < 1500
    assert (tmp_path / "mc" / "report.html").stat().st_size < 2e6
    assert (tmp_path / "mc" / "sliders.html").stat().st_size < 500_000


def test_a_sample_that_hangs_twice_has_its_reason_and_the_others_go_on(monkeypatch) -> None:
    """The process that hangs is ended by its time limit, a `SimulationError`; a second one may do."""
    plan = resolve(load_scene(SCENES / "drop.toml", ["duration_s=0.02", 'solver.model="spice"']))
    real, calls = batch_module.run, []

    def hangs(given, *words, **more):
        calls.append(given.board.text)
        share = calls.count(given.board.text)
        if share == 1 or (len(set(calls)) == 2 and share == 2):  # all once, the second device twice
            raise SimulationError("no progress for 60 s")
        return real(given, *words, **more)

    monkeypatch.setattr(batch_module, "run", hangs)
    with Batch(plan, ("rsp11",), ("peak_force",)) as batch:
        table = batch.measures(np.array([[24.3e3], [24.4e3], [24.5e3]]))
        assert list(batch.failures) == [1]
        assert "no progress" in batch.failures[1]["peak_force"]
    assert np.isfinite(table[[0, 2]]).all()
    assert np.isnan(table[1]).all()
    assert len(calls) == 6


def test_what_a_killed_process_left_among_the_parts_is_taken_away(tmp_path: Path) -> None:
    """Seen to fail without the sweep: the folder of parts then stays."""
    folder = tmp_path / "mc"
    run(job(tmp_path / "first", 6), folder, workers=1, chunk=3)
    (folder / "samples.parquet").unlink()
    parts = folder / "parts"
    parts.mkdir()
    dead = subprocess.Popen([sys.executable, "-c", ""])
    dead.wait()
    from cosim.storage.staging import _label

    (parts / f".000000000003-3.parquet.{_label()}-{dead.pid}.abcd1234.parquet").write_bytes(b"half")
    run(job(tmp_path / "first", 6), folder, workers=1, chunk=3)
    assert not parts.exists()


@pytest.mark.parametrize(("measure", "per_sample"), [("max_penetration", 0), ("k_max", 3)])
def test_no_circuit_of_an_earlier_sample_stays(monkeypatch, measure, per_sample) -> None:
    """A process collects garbage by itself as good as never: 0.35 MB of a sample stayed, 2.1 GB of 3,000.

    A run leaves none at all: seen to fail with `ctypes.cast` for the address of a callback, and with one that
    holds its `Recorder`. Of the board's measures something is left: seen to fail without the collection.
    """
    plan = resolve(load_scene(SCENES / "drop.toml", ["duration_s=0.02", 'solver.model="linear"']))
    left: list[int] = []

    def call(self, target, payload, count):
        plan.stated(self._alive())
        gc.collect()
        gc.disable()
        try:
            return batch_module.measured(payload, lambda _: None)
        finally:
            left.append(gc.collect())
            gc.enable()

    monkeypatch.setattr(Batch, "_call", call)
    if not per_sample:
        monkeypatch.setattr(batch_module, "_COLLECTED", 1000)
    with Batch(plan, ("rsp11",), (measure,)) as batch:
        for count in (1, 2, 34):  # the garbage of one sample is left, the second and the last
            batch.measures(np.linspace(24e3, 25e3, count)[:, None])
    assert left[2] - left[1] <= per_sample * left[1]
