"""Results: streamed raw files that ngspice reads, folders that appear whole or not at all."""

import json
import math
import os
import resource
import shutil
import struct
import subprocess
import sys
import tracemalloc
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import pytest
from spicelib import RawRead

from cosim.assets import scenes_folder
from cosim.errors import CosimError, InputError, SimulationError
from cosim.provenance import provenance
from cosim.results import FORMATS, Run, json_text, read_csv, write_csv, written_files
from cosim.scene import load_scene
from cosim.storage.checksums import sealed
from cosim.storage.rawfile import RawWriter, Signals, read_raw, stamp
from cosim.storage.staging import Staging

NAMES = ("time", "q1", "imot1", "ksp11", "xboard.xsum1.out")


def table(points: int) -> np.ndarray:
    time = np.arange(points) * 1e-5
    return np.column_stack([time, np.sin(time), np.cos(time), 0 * time + 2.5, time**2])


def raw(path: Path, points: int = 1000) -> Signals:
    with RawWriter(path, NAMES, title="a test") as writer:
        for block in np.array_split(table(points), 7):
            writer.append(block)
    return read_raw(path)


@pytest.fixture
def run(tmp_path: Path) -> Run:
    scene = load_scene(scenes_folder() / "slope.toml")
    return Run(
        scene=scene,
        signals=raw(tmp_path / "somewhere.raw"),
        samples={
            "tick": np.arange(5),
            "time": np.arange(5) * 0.025,
            "pen": np.array([0.1, 1 / 3, 2e-300, 0, -0.0]),
        },
        plan={"model": "spice"},
        events=[{"time": 0.5, "kind": "contact"}],
        measures={"sink": {"value": np.float64(0.0043), "unit": "m", "text": "deepest point"}},
        ledger={"closes": True, "work": np.float32(1.5)},
        stats={"points": np.int64(1000)},
        provenance=provenance(scene, command=["cosim", "run"], ngspice="39", deck_digest="ab"),
    )


def leftovers(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir() if path.name.startswith("."))


# --- the raw file ------------------------------------------------------------------------------------


def test_raw_file_gives_back_every_bit(tmp_path: Path) -> None:
    signals = raw(tmp_path / "a.raw")
    assert tuple(signals) == NAMES
    assert np.array_equal(signals.table, table(1000))
    assert np.array_equal(signals["q1"], table(1000)[:, 1])
    assert signals.table.flags.aligned
    assert not signals.table.flags.writeable


def test_raw_file_without_points(tmp_path: Path) -> None:
    with RawWriter(tmp_path / "a.raw", NAMES):
        pass
    assert len(read_raw(tmp_path / "a.raw")["time"]) == 0


def test_one_point_may_be_a_plain_row(tmp_path: Path) -> None:
    with RawWriter(tmp_path / "a.raw", NAMES) as writer:
        writer.append([0.0, 1.0, 2.0, 3.0, 4.0])
    assert read_raw(tmp_path / "a.raw").table.tolist() == [[0, 1, 2, 3, 4]]


def test_spicelib_reads_it_without_a_dialect(tmp_path: Path) -> None:
    raw(tmp_path / "a.raw", points=1234)
    read = RawRead(tmp_path / "a.raw")
    assert read.dialect == "ngspice"
    assert tuple(read.get_trace_names()) == NAMES
    for name, column in zip(NAMES, table(1234).T, strict=True):
        assert np.array_equal(np.asarray(read.get_trace(name).get_wave(0)), column), name


def test_a_raw_file_has_the_date_of_its_run(tmp_path: Path) -> None:
    raw(tmp_path / "a.raw")
    before = (tmp_path / "a.raw").stat().st_size
    stamp(tmp_path / "a.raw", 1_000_000_000.0)
    assert b"\nDate: Sun Sep  9 01:46:40  2001\n" in (tmp_path / "a.raw").read_bytes()  # POSIX's gigasecond
    assert (tmp_path / "a.raw").stat().st_size == before
    assert np.array_equal(read_raw(tmp_path / "a.raw").table, table(1000))


def test_headings_of_csv_carry_units_and_are_read_with_and_without(run: Run, tmp_path: Path) -> None:
    folder = run.save(tmp_path / "out", formats=FORMATS)
    head = (folder / "signals.csv").read_text().splitlines()[0]
    assert head.startswith("time [s],q1 [rad],")
    bare = tmp_path / "bare.csv"
    text = (folder / "signals.csv").read_text()
    bare.write_text(text.replace(head, ",".join(NAMES), 1))
    for file in (folder / "signals.csv", bare):
        assert list(read_csv(file)) == list(NAMES)


@pytest.mark.skipif(shutil.which("ngspice") is None, reason="the ngspice program is not installed")
def test_ngspice_reads_it(tmp_path: Path) -> None:
    raw(tmp_path / "a.raw", points=12345)
    lines = ["load a.raw", "print length(time)", "print maximum(xboard.xsum1.out)", "print q1[100]", "quit"]
    # in batch mode: its prompt (-p) ends in a segmentation fault where 44 finds no terminal
    (tmp_path / "a.cir").write_text("\n".join(["* read", ".control", *lines, ".endc", ".end", ""]))
    done = subprocess.run(
        ["ngspice", "-n", "-b", "a.cir"],
        cwd=tmp_path,
        env=os.environ | {"HOME": str(tmp_path)},
        capture_output=True,
        text=True,
        timeout=30,
        check=False,
    )
    values = dict(line.split(" = ") for line in done.stdout.splitlines() if " = " in line)
    assert float(values["length(time)"]) == 12345
    # ngspice prints seven digits.
    assert float(values["maximum(xboard.xsum1.out)"]) == pytest.approx(0.12344**2, rel=1e-6)
    assert float(values["q1[100]"]) == pytest.approx(math.sin(1e-3), rel=1e-6)


@pytest.mark.skipif(shutil.which("ngspice") is None, reason="the ngspice program is not installed")
def test_raw_file_of_ngspice_itself_is_read(tmp_path: Path) -> None:
    (tmp_path / "a.cir").write_text("* rc\nv1 a 0 1\nr1 a b 1k\nc1 b 0 1u ic=0\n.tran 10u 1m uic\n.end\n")
    subprocess.run(
        ["ngspice", "-n", "-b", "-r", "a.raw", "a.cir"], cwd=tmp_path, check=True, capture_output=True
    )
    signals = read_raw(tmp_path / "a.raw")
    assert signals["time"][-1] == pytest.approx(1e-3)
    # Default reltol is 1e-3.
    assert signals["v(b)"][-1] == pytest.approx(1 - math.exp(-1), rel=1e-3)


def test_streaming_takes_no_memory(tmp_path: Path) -> None:
    block = table(1000)
    tracemalloc.start()
    with RawWriter(tmp_path / "a.raw", NAMES) as writer:
        for _ in range(500):  # 20 MB
            writer.append(block)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    # The buffer of 1 MB, and the finite test of one block.
    assert peak < 2e6


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
def test_nan_is_refused_with_signal_and_time(tmp_path: Path, bad: float) -> None:
    block = table(10)
    block[7, 2] = bad
    with RawWriter(tmp_path / "a.raw", NAMES) as writer:
        with pytest.raises(SimulationError, match="imot1") as caught:
            writer.append(block)
        assert caught.value.time_s == block[7, 0]
    assert len(read_raw(tmp_path / "a.raw")["time"]) == 0


@pytest.mark.parametrize("names", [[], ["time", "time"], ["time", "a b"], ["time", ""]])
def test_names_that_a_header_cannot_carry(tmp_path: Path, names: list[str]) -> None:
    with pytest.raises(ValueError, match="names"):
        RawWriter(tmp_path / "a.raw", names)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("cut", [1, 8, 39_000, 40_000])
def test_a_raw_file_cut_short_is_refused(tmp_path: Path, cut: int) -> None:
    raw(tmp_path / "a.raw")
    os.truncate(tmp_path / "a.raw", (tmp_path / "a.raw").stat().st_size - cut)
    with pytest.raises(InputError, match="cut short"):
        read_raw(tmp_path / "a.raw")


def test_what_is_no_raw_file_is_refused(tmp_path: Path) -> None:
    (tmp_path / "a.raw").write_text("hello")
    (tmp_path / "b.raw").write_text("Title: x\nFlags: complex\nNo. Points: 1\nVariables:\nBinary:\n")
    (tmp_path / "c.raw").write_text("Title: x\nFlags: real\nNo. Points: many\nVariables:\nBinary:\n")
    for name, words in (
        ("a", "not a binary raw"),
        ("b", "no real"),
        ("c", "damaged"),
        ("d", "cannot be read"),
    ):
        with pytest.raises(InputError, match=words):
            read_raw(tmp_path / f"{name}.raw")


# --- the run -----------------------------------------------------------------------------------------


def test_run_comes_back_whole(run: Run, tmp_path: Path) -> None:
    folder = run.save(tmp_path / "out", formats=FORMATS)
    names = {"signals.raw", "signals.parquet", "signals.csv", "samples.csv", "scene.toml", "run.json"}
    assert {path.name for path in folder.iterdir()} == names
    again = Run.load(folder)
    assert again.scene.as_dict() == run.scene.as_dict()
    assert np.array_equal(again.signals.table, run.signals.table)
    for name, values in run.samples.items():
        assert np.array_equal(again.samples[name], values)
    assert again.measures == {"sink": {"value": 0.0043, "unit": "m", "text": "deepest point"}}
    assert again.events == [{"time": 0.5, "kind": "contact"}]
    assert again.ledger == {"closes": True, "work": 1.5}
    assert again.provenance["versions"]["ngspice"] == "39"
    assert again.provenance["seed"] == run.scene.seed
    assert not leftovers(tmp_path)


def test_a_run_of_the_version_before_is_read(run: Run, tmp_path: Path) -> None:
    """Version 2 named what the user's code printed "said"."""
    folder = replace(run, printed=("one line", "another")).save(tmp_path / "out")
    record = json.loads((folder / "run.json").read_text())
    del record["seal"]
    record = {
        "format": 2,
        "said": record.pop("printed"),
        **{k: v for k, v in record.items() if k != "format"},
    }
    (folder / "run.json").write_text(json.dumps(sealed(record)))
    assert Run.load(folder).printed == ("one line", "another")


def test_csv_and_parquet_hold_the_same_numbers(run: Run, tmp_path: Path) -> None:
    folder = run.save(tmp_path / "out", formats=FORMATS)
    parquet, text = pq.read_table(folder / "signals.parquet"), read_csv(folder / "signals.csv")
    for name in NAMES:
        assert np.array_equal(parquet[name].to_numpy(), run.signals[name])
        assert np.array_equal(text[name], run.signals[name])


def test_same_run_same_bytes(run: Run, tmp_path: Path) -> None:
    first, second = (run.save(tmp_path / name, formats=FORMATS) for name in ("a", "b"))
    for file in first.iterdir():
        assert file.read_bytes() == (second / file.name).read_bytes()


def test_an_earlier_result_is_replaced_and_nothing_else(run: Run, tmp_path: Path) -> None:
    folder = run.save(tmp_path / "out", formats=FORMATS)
    run.save(folder, formats=())
    assert {path.name for path in folder.iterdir()} == {
        "signals.raw",
        "samples.csv",
        "scene.toml",
        "run.json",
    }
    mine = tmp_path / "mine"
    mine.mkdir()
    (mine / "thesis.tex").write_text("years of work")
    with pytest.raises(InputError, match="choose another folder"):
        run.save(mine)
    with pytest.raises(InputError, match="not a folder"):
        run.save(mine / "thesis.tex")
    assert (mine / "thesis.tex").read_text() == "years of work"
    assert not leftovers(tmp_path)


def test_a_new_raw_file_does_not_reach_into_a_saved_result(run: Run, tmp_path: Path) -> None:
    """`save` links the raw file; writing to the old name again must not change the result."""
    folder = run.save(tmp_path / "out")
    before = (folder / "signals.raw").read_bytes()
    raw(run.signals.path, points=3)
    assert (folder / "signals.raw").read_bytes() == before


def test_loaded_run_can_be_saved_over_itself(run: Run, tmp_path: Path) -> None:
    folder = run.save(tmp_path / "out")
    Run.load(folder).save(folder)
    assert np.array_equal(Run.load(folder).signals.table, run.signals.table)


def test_damaged_results_are_refused(run: Run, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"no run\.json"):
        Run.load(tmp_path)
    with pytest.raises(InputError, match="no such file or folder"):
        Run.load(tmp_path / "never" / "made.toml")
    folder = run.save(tmp_path / "out")
    record = (folder / "run.json").read_text()
    for text, words in (
        ("{", "cannot be read"),
        ("[]", "is not a JSON object"),
        ("[" * 100_000, "nested too deeply"),
        ('{"format": 99}', "another version"),
        ('{"format": 1}', "another version"),
        ('{"format": 2}', "is damaged"),
        ('{"format": 3}', "is damaged"),
        ('{"format": 3, "seal": NaN}', "NaN is not a finite number"),
        (record.replace("0.0043", "0.0044"), "is damaged"),
        (json.dumps(sealed({"format": 3, "plan": {}})), "does not hold what a result holds"),
    ):
        (folder / "run.json").write_text(text)
        with pytest.raises(InputError, match=words):
            Run.load(folder)
    (folder / "run.json").write_text(record)
    (folder / "samples.csv").write_text("time\nx\n")
    with pytest.raises(InputError, match="samples"):
        Run.load(folder)


@pytest.mark.parametrize("name", ["signals.raw", "samples.csv", "scene.toml"])
@pytest.mark.parametrize(
    "damage",
    [
        lambda data: data[:-9],
        lambda data: data + b"\n",
        lambda data: b"",
        lambda data: data[:-8] + struct.pack("<d", math.nan),
        lambda data: data[:60] + bytes([data[60] ^ 1]) + data[61:],
    ],
)
def test_a_result_with_a_damaged_file_is_refused(run: Run, tmp_path: Path, name: str, damage: Any) -> None:
    folder = run.save(tmp_path / "out")
    data = (folder / name).read_bytes()
    (folder / name).write_bytes(damage(data))
    with pytest.raises(InputError, match=rf"{name}: is damaged"):
        Run.load(folder)
    (folder / name).unlink()
    with pytest.raises(InputError, match=rf"{name}: is missing"):
        Run.load(folder)
    (folder / name).write_bytes(data)
    Run.load(folder)


def test_a_result_names_no_files_outside_its_folder(run: Run, tmp_path: Path) -> None:
    folder = run.save(tmp_path / "out")
    record = json.loads((folder / "run.json").read_text())
    del record["seal"]
    record["files"]["../somewhere.raw"] = "0"
    (folder / "run.json").write_text(json.dumps(sealed(record)))
    with pytest.raises(InputError, match="is missing"):
        Run.load(folder)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("x,y\n1,2\n3\n", "cannot be read"),
        ("x,y\n1,nan\n", "a.csv:2: y: is not a finite number"),
        ("x,y\n1,2\n3,-inf\n", "a.csv:3: y: is not a finite number"),
        ("x,x\n1,2\n", "headings"),
        ("x\n1,2\n", "headings"),
        ("x,y\n1,2\n#3,4\n", "cannot be read"),
        ("x,y\n1,2\n\x00\n", "cannot be read"),
    ],
)
def test_csv_that_is_damaged(tmp_path: Path, text: str, words: str) -> None:
    (tmp_path / "a.csv").write_text(text)
    with pytest.raises(InputError, match=words):
        read_csv(tmp_path / "a.csv")


def test_csv_keeps_every_bit(tmp_path: Path) -> None:
    column = np.array([0.1, 1 / 3, 5e-324, 1.7976931348623157e308, -0.0])
    write_csv(tmp_path / "a.csv", {"x": column, "a,b": column})
    for back in read_csv(tmp_path / "a.csv").values():
        assert back.tobytes() == column.tobytes()


def test_nan_does_not_get_into_json(run: Run) -> None:
    assert json.loads(json_text({"a": np.array([1.0, 2.0]), "b": Path("x")})) == {"a": [1, 2], "b": "x"}
    with pytest.raises(CosimError, match=r"measures\.sink\.value"):
        json_text({"measures": {"sink": {"value": np.float64("nan")}}})


def test_csv_without_rows(tmp_path: Path) -> None:
    write_csv(tmp_path / "a.csv", {"x": np.empty(0), "y": np.empty(0)})
    assert {name: len(column) for name, column in read_csv(tmp_path / "a.csv").items()} == {"x": 0, "y": 0}


# --- a disk that refuses -------------------------------------------------------------------------------


@contextmanager
def largest_file(size: int) -> Iterator[None]:
    """Let the kernel refuse to write beyond `size` bytes a file, as it does on a full disk."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


def test_refusal_while_streaming_names_the_file(tmp_path: Path) -> None:
    with largest_file(100_000), pytest.raises(InputError, match=r"cannot be written") as caught:
        raw(tmp_path / "a.raw", points=100_000)
    assert caught.value.exit_code == 2
    assert caught.value.problems[0].file == str(tmp_path / "a.raw")


@pytest.mark.parametrize("formats", [("parquet",), ("csv",), ()])
def test_refusal_while_saving_leaves_nothing_half_written(
    run: Run, tmp_path: Path, formats: tuple[str, ...]
) -> None:
    target = tmp_path / "place"
    target.mkdir()
    run.save(target / "out")
    with largest_file(1000), pytest.raises(InputError, match="cannot be written"):
        run.save(target / "new", formats=formats)
    with largest_file(1000), pytest.raises(InputError, match="cannot be written"):
        run.save(target / "out", formats=formats)
    assert [path.name for path in target.iterdir()] == ["out"]
    assert np.array_equal(Run.load(target / "out").signals.table, run.signals.table)


def test_full_disk(run: Run, tmp_path: Path) -> None:
    disk = tmp_path / "disk"
    disk.mkdir()
    mount = ["mount", "-t", "tmpfs", "-o", "size=64k", "tmpfs", str(disk)]
    if os.geteuid() != 0 or subprocess.run(mount, capture_output=True, check=False).returncode != 0:
        pytest.skip("only root may mount a small disk")
    try:
        with pytest.raises(InputError, match="No space left"):
            run.save(disk / "out", formats=FORMATS)
        assert not list(disk.iterdir())
        with pytest.raises(InputError, match="No space left"), RawWriter(disk / "a.raw", NAMES) as writer:
            writer.append(table(10_000))
    finally:
        subprocess.run(["umount", str(disk)], check=True)


def test_unwritable_places_are_reported_before_a_simulation_starts(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="cannot be written") as caught:
        Staging(tmp_path / "file" / "out", "run.json")
    assert caught.value.problems[0].file == str(tmp_path / "file" / "out")


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write everywhere")
def test_read_only_folder(tmp_path: Path) -> None:
    tmp_path.chmod(0o500)
    with pytest.raises(InputError, match="Permission denied"):
        Staging(tmp_path / "out", "run.json")


def test_interrupt_while_staging_leaves_nothing(tmp_path: Path) -> None:
    def interrupted() -> None:
        with Staging(tmp_path / "out", "run.json") as stage:
            (stage.path / "signals.raw").write_text("half")
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        interrupted()
    assert not list(tmp_path.iterdir())


def test_what_a_killed_process_left_is_removed_and_nothing_else(tmp_path: Path) -> None:
    """SIGKILL leaves a staging folder; the next one for that target removes it once its owner is gone."""
    code = (
        "import sys, time; from cosim.storage.staging import Staging; stage = Staging(sys.argv[1]);"
        "(stage.path / 'half').write_text('x'); print(stage.path, flush=True); time.sleep(60)"
    )
    with subprocess.Popen(
        [sys.executable, "-c", code, str(tmp_path / "out")], stdout=subprocess.PIPE, text=True
    ) as owner:
        assert owner.stdout is not None
        left = Path(owner.stdout.readline().strip())
        elsewhere = left.name.replace(".out.", ".out2.", 1)  # the same dead process, another target
        machine, _, pid = left.name.removeprefix(".out.").partition(".")[0].partition("-")
        others = [elsewhere, left.name.replace(machine, "0" * 6), ".out.notes", f".out.{machine}-{pid}.x"]
        for name in others:
            (tmp_path / name).mkdir()
        with Staging(tmp_path / "out"):
            assert left.is_dir(), "its owner lives"
        owner.kill()
    assert left.is_dir()
    with Staging(tmp_path / "out") as stage:
        assert sorted(p.name for p in tmp_path.iterdir()) == sorted([*others, stage.path.name])


def test_published_folder_is_as_public_as_the_users_files(tmp_path: Path) -> None:
    (tmp_path / "other").mkdir()
    with Staging(tmp_path / "out", "run.json") as stage:
        stage.publish()
    assert (tmp_path / "out").stat().st_mode == (tmp_path / "other").stat().st_mode


def test_target_that_became_foreign_meanwhile_is_kept(tmp_path: Path) -> None:
    with Staging(tmp_path / "out", written_files) as stage:
        (tmp_path / "out").mkdir()
        (tmp_path / "out" / "mine.txt").write_text("mine")
        with pytest.raises(InputError):
            stage.publish()
    assert (tmp_path / "out" / "mine.txt").read_text() == "mine"
    assert not leftovers(tmp_path)
