"""Points of sweeps and studies on disk: damage, foreign files, locks, full disks, and what a kill leaves."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from cosim.assets import scenes_folder
from cosim.cli import main
from cosim.errors import InputError, SimulationError, StorageError
from cosim.storage.checkpoint import Points
from cosim.storage.staging import Staging, atomic_file, make_scratch, scratch_folder

DROP = str(scenes_folder() / "drop.toml")
FAST = ["--set", "duration_s=0.02", "--set", "solver.model=linear"]


def kept(path, count=3):
    """Write a file of `count` points, each its own index; return its lines."""
    with Points(path, "a") as points:
        for index in range(count):
            points.get(str(index), lambda index=index: {"value": index})
    return path.read_text().splitlines(keepends=True)


def restored(path):
    """Keys that a new sitting takes over, and those that it had to compute again."""
    again = []
    with Points(path, "a") as points:
        for key in "012":
            points.get(key, lambda key=key: again.append(key) or {"value": int(key)})
            assert points.get(key, dict) == {"value": int(key)}
    return again


@pytest.mark.parametrize(
    "damage",
    [
        lambda line: line[: len(line) // 2],  # cut off by a kill, the next one written behind it
        lambda line: line[:-1].replace("1", "7") + "\n",  # another number, still JSON
        lambda line: "[1]\n",
        lambda line: "null\n",
        lambda line: "[" * 100_000 + "\n",
        lambda line: '{"key": "1", "value": NaN, "seconds": 0.1, "crc": 3}\n',
        lambda line: '{"key": "1", "value": 1}\n',
        lambda line: "\x00\x00\ufffd\n",
        lambda line: "\n",
        lambda line: "",
    ],
)
def test_a_damaged_point_is_computed_again_and_the_others_are_kept(tmp_path, damage):
    path = tmp_path / "points.jsonl"
    lines = kept(path)
    path.write_text("".join([*lines[:2], damage(lines[2]), *lines[3:]]))
    assert "1" in restored(path)
    assert restored(path) == []
    assert "0" not in (again := restored(path)), again


def test_bytes_that_are_no_text_are_computed_again(tmp_path):
    path = tmp_path / "points.jsonl"
    kept(path)
    data = path.read_bytes()
    path.write_bytes(data[:-20] + b"\xff\xfe" + data[-18:])
    assert restored(path) == ["2"]


@pytest.mark.parametrize("content", ["[1]\n", "my thesis\n", "my thesis", "{}\n", '{"key": "0"}\n', "\n"])
def test_a_file_that_is_not_ours_is_left_alone(tmp_path, content):
    path = tmp_path / "points.jsonl"
    path.write_text(content)
    with pytest.raises(InputError, match="holds no points of cosim"):
        Points(path, "a")
    assert path.read_text() == content


@pytest.mark.parametrize("content", ["", '{"dig', '{"digest": "a'])
def test_a_file_that_was_killed_while_it_began_is_begun_again(tmp_path, content):
    path = tmp_path / "points.jsonl"
    path.write_text(content)
    assert restored(path) == ["0", "1", "2"]


def test_two_processes_do_not_write_to_one_place(tmp_path):
    path = tmp_path / "points.jsonl"
    with Points(path, "a") as first:
        first.get("0", lambda: 0)
        with pytest.raises(InputError, match="another process of cosim writes here"):
            Points(path, "b")
        first.get("1", lambda: 1)
    with Points(path, "a") as again:
        assert [again.get(key, pytest.fail) for key in "01"] == [0, 1]


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs a device that is always full")
def test_a_full_disk_is_an_error_in_words(tmp_path):
    path = tmp_path / "points.jsonl"
    points = Points(path, "a")
    full = open("/dev/full", "w", encoding="utf-8")
    points._stream.close()
    points._stream = full
    with pytest.raises(StorageError, match=r"points\.jsonl: cannot be written: No space left"):
        points.get("0", lambda: 0)
    with pytest.raises(StorageError, match="No space left"):
        points.__exit__()


def test_a_worker_that_is_ended_from_outside_is_an_error_in_words(tmp_path):
    """What the others finished before is kept."""
    with Points(tmp_path / "points.jsonl", "one") as points:
        with pytest.raises(SimulationError, match="ended from outside"):
            points.map(os._exit, {"a": 1, "b": 1}, workers=2)
        assert points.map(abs, {"c": -1, "d": -2}, workers=2) == [1, 2]


def test_a_bad_point_of_a_sweep_is_a_row(tmp_path, capsys):
    asked = ["sweep", DROP, "opa548_gbw=1meg,0,2meg", "--measure", "peak_force", *FAST, "--json"]
    assert main([*asked, "--out", str(tmp_path)]) == 1
    out = json.loads(capsys.readouterr().out)
    forces = out["measures"]["peak_force"]
    assert forces[1] is None or "opa548_gbw=0" not in out["failed"]
    assert forces[0] is not None
    assert forces[2] is not None


def test_a_value_that_the_scene_refuses_is_a_row(tmp_path, capsys):
    asked = ["sweep", DROP, "computer.period_s=0.01,-1,0.02", "--measure", "peak_force", *FAST, "--json"]
    assert main([*asked, "--out", str(tmp_path)]) == 1
    out = json.loads(capsys.readouterr().out)
    assert [value is None for value in out["measures"]["peak_force"]] == [False, True, False]
    assert "computer.period_s" in out["failed"]["computer.period_s=-1"]
    assert len((tmp_path / "sweep.csv").read_text().splitlines()) == 4


def test_a_sweep_of_bad_points_only_is_an_error_that_tells_each_reason(tmp_path, capsys):
    asked = ["sweep", DROP, "computer.period_s=-2,-1", "--out", str(tmp_path / "out"), *FAST]
    assert main(asked) == 2
    err = capsys.readouterr().err
    assert "-2" in err
    assert "-1" in err
    assert not (tmp_path / "out").exists()


def test_a_failure_leaves_the_earlier_file_and_nothing_beside_it(tmp_path):
    file = tmp_path / "board.cir"
    file.write_text("mine")

    def fail_halfway():
        with atomic_file(file) as temporary:
            temporary.write_text("half")
            raise RuntimeError

    with pytest.raises(RuntimeError):
        fail_halfway()
    assert file.read_text() == "mine"
    assert list(tmp_path.iterdir()) == [file]
    with atomic_file(file) as temporary:
        temporary.write_text("whole")
    assert file.read_text() == "whole"
    assert list(tmp_path.iterdir()) == [file]


def test_a_file_behind_a_link_is_replaced_and_the_link_stays(tmp_path):
    file, link = tmp_path / "table.csv", tmp_path / "link.csv"
    file.write_text("old")
    link.symlink_to(file)
    with atomic_file(link) as temporary:
        temporary.write_text("new")
    assert link.is_symlink()
    assert file.read_text() == "new"


@pytest.mark.parametrize("make", [os.mkfifo, os.mkdir])
def test_what_is_no_file_is_not_replaced(tmp_path, make):
    place = tmp_path / "pipe"
    make(place)
    with pytest.raises(InputError, match="is not a regular file"), atomic_file(place):
        pytest.fail("entered")
    assert place.exists()


KILLED = """
import os, signal, sys
from pathlib import Path
from cosim.storage.staging import Staging, make_scratch, atomic_file
here = Path(sys.argv[1])
print(make_scratch("ngspice"), flush=True)
stage = Staging(here / "result")
with atomic_file(here / "deck.cir") as file:
    file.write_text("half")
    os.kill(os.getpid(), signal.SIGKILL)
"""


def test_what_a_killed_process_left_is_removed_at_the_next_start(tmp_path, monkeypatch):
    monkeypatch.setenv("TMPDIR", str(tmp_path / "tmp"))
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path / "tmp"))
    (tmp_path / "tmp").mkdir()
    done = subprocess.run(
        [sys.executable, "-c", KILLED, str(tmp_path)], capture_output=True, text=True, check=False
    )
    left = Path(done.stdout.strip())
    assert done.returncode < 0
    assert left.is_dir()
    assert sorted(p.name[:8] for p in tmp_path.iterdir() if p.name.startswith(".")) == [
        ".deck.ci",
        ".result.",
    ]
    with scratch_folder("sweep"):
        assert not left.exists()
    with atomic_file(tmp_path / "deck.cir") as file:
        file.write_text("whole")
    with Staging(tmp_path / "result"):
        pass
    assert not [p for p in tmp_path.iterdir() if p.name.startswith(".")]
    assert not list((tmp_path / "tmp").iterdir())


def test_the_scratch_folder_of_a_living_process_stays(tmp_path, monkeypatch):
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    mine = make_scratch("ngspice")
    with scratch_folder("sweep") as other:
        assert mine.is_dir()
        assert other.is_dir()
