"""Stored results of a stranger's, sealed anew to fit what was put into them: refused in words, never obeyed.

A seal tells damage. It is no signature, so each forgery here has a right one, and right check sums.
"""

import hashlib
import json
import os
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from engine_jobs import job
from support import SCENES, simulate

import cosim
from cosim import cli
from cosim.accuracy.run_outcome import First, Second, Summary
from cosim.errors import InputError
from cosim.export import export
from cosim.ngspice import deck_file
from cosim.plan import resolve
from cosim.results import Run, written_files
from cosim.scene import load_scene
from cosim.storage.checkpoint import Points
from cosim.storage.checksums import file_sums, listed, sealed
from cosim.storage.field_types import fits
from cosim.storage.staging import Staging
from cosim.studies.study import Table, Verdict, load_study, run_study
from cosim.tolerance.engine import merge
from cosim.tolerance.engine import run as measure
from reports.study_page import write_study_page

QUICK = ["duration_s=0.05", "solver.model=linear"]
Change = Callable[[dict[str, Any]], None]


@pytest.fixture(scope="module")
def stored(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A true result."""
    scene = load_scene(SCENES / "press.toml", QUICK)
    return simulate(scene, tmp_path_factory.mktemp("stored") / "run").signals.path.parent


@pytest.fixture
def copy(stored: Path, tmp_path: Path) -> Path:
    """A copy of it to be forged."""
    return Path(shutil.copytree(stored, tmp_path / "forged"))


def reseal(folder: Path, change: Change | None = None) -> None:
    """Change a record, and seal it and all files beside it anew."""
    record = json.loads((folder / "run.json").read_text())
    del record["seal"]
    record["files"] = file_sums(folder, record["files"])
    if change is not None:
        change(record)
    # as json writes it: NaN and infinity pass, where a program that seals honestly would refuse them
    text = json.dumps(record)
    seal = hashlib.sha256(text.encode()).hexdigest()
    (folder / "run.json").write_text(json.dumps({**record, "seal": seal}, ensure_ascii=True))


def board_with(folder: Path, change: Change) -> None:
    """Change the kept board, with a digest that fits wherever there can be one."""
    record = json.loads((folder / "board.json").read_text())
    change(record)
    try:
        text = "".join(line["text"] + "\n" for line in record["lines"])
        record["digest"] = hashlib.sha256(text.encode()).hexdigest()
    except (TypeError, KeyError, UnicodeEncodeError):
        pass
    (folder / "board.json").write_text(json.dumps(record))
    reseal(folder)


def put(path: str, value: Any) -> Change:
    """Return what puts a value at ``a.b.0.c`` of a record."""

    def change(record: dict[str, Any]) -> None:
        *way, last = (int(key) if key.isdigit() else key for key in path.split("."))
        there: Any = record
        for key in way:
            there = there[key]
        there[last] = value

    return change


def nested(levels: int) -> Any:
    value: Any = 1
    for _ in range(levels):
        value = [value]
    return value


FORGED_RECORDS = {
    "a measure that is none": put("measures.peak_force", 7),
    "a measure of words": put("measures.peak_force.value", "1.0"),
    "a measure that is true": put("measures.peak_force.value", True),
    "an error that is a list": put("measures.peak_force.error", [1]),
    "a unit that is a table": put("measures.peak_force.unit", {}),
    "constants of words": put("plan.constants.kt", "rm -rf"),
    "a plan that is a list": put("plan", []),
    "effects that are numbers": put("plan.effects", [1, 2]),
    "an effect without a name": put("plan.effects.0", {"value": 1}),
    "a size that is a number": put("plan.effects.0.size", 3),
    "amplifiers of nothing": put("plan.amplifiers", [{}]),
    "a swing of words": put(
        "plan.amplifiers", [{"path": "x", "part": "y", "peak_v": "1", "swing_v": 1, "headroom": 0.5}]
    ),
    "works of words": put("ledger.work_j.shafts", "much"),
    "a time of an event in words": put("events", [{"time": "noon"}]),
    "an event that is a number": put("events", [4]),
    "points in words": put("stats.points", "many"),
    "a warning without advice": put("warnings", [{"code": "a", "text": "b"}]),
    "a command of tables": put("provenance.command", [{}, []]),
    "what was printed as a table": put("printed", {"a": 1}),
    "files that are a list": put("files", ["signals.raw"]),
    "no files at all": put("files", {}),
    "a scene of nothing": put("scene", {}),
    "a scene of words": put("scene.computer", "press"),
    "a number beyond all": put("stats.wall_s", 1e308 * 10),
    "a number that is none": put("ledger.closure", float("nan")),
    "a whole number of 400 digits": put("stats.extra", 10**400),
    "half a character": put("title", "\ud800"),
    "nested deeply": put("stats.extra", nested(200)),
    "nested beyond the parser": put("stats.extra", nested(900)),
}


@pytest.mark.parametrize("name", FORGED_RECORDS)
def test_a_forged_record_is_refused_with_its_place(copy: Path, name: str) -> None:
    reseal(copy, FORGED_RECORDS[name])
    with pytest.raises(InputError, match=r"run\.json|signals\.raw") as caught:
        Run.load(copy)
    assert len(str(caught.value)) < 1000


def raw_with(change: Callable[[np.ndarray], None]) -> Callable[[Path], None]:
    def forge(folder: Path) -> None:
        data = (folder / "signals.raw").read_bytes()
        start = data.index(b"Binary:\n") + 8
        count = int(
            next(line for line in data[:start].split(b"\n") if b"No. Variables" in line).split(b":")[1]
        )
        table = np.frombuffer(data[start:], np.float64).reshape(-1, count).copy()
        change(table)
        (folder / "signals.raw").write_bytes(data[:start] + table.tobytes())

    return forge


def header_with(old: bytes, new: bytes) -> Callable[[Path], None]:
    def forge(folder: Path) -> None:
        data = (folder / "signals.raw").read_bytes()
        assert old in data
        (folder / "signals.raw").write_bytes(data.replace(old, new, 1))

    return forge


def samples_with(text: str) -> Callable[[Path], None]:
    return lambda folder: (folder / "samples.csv").write_text(text) and None  # type: ignore[return-value]


FORGED_SIGNALS = {
    "no number": raw_with(lambda t: t.__setitem__((5, 3), np.nan)),
    "without end": raw_with(lambda t: t.__setitem__((5, 3), -np.inf)),
    "time that runs back": raw_with(lambda t: t.__setitem__((5, 0), 0.0)),
    "no time": header_with(b"\t0\ttime\t", b"\t0\ttame\t"),
    "two of one name": header_with(b"\t1\t", b"\t1\ttime\t"),
    "fewer than none": header_with(b"No. Points: ", b"No. Points: -"),
    "as many as the disk has bytes": header_with(b"No. Points: ", b"No. Points: 99999999999999999999"),
    "no points": header_with(b"No. Points: ", b"No. Points: 0 "),
    "samples that run back": samples_with("time [s],contact\n1.0,0\n0.5,0\n"),
    "samples without time": samples_with("contact\n1\n"),
    "samples of words": samples_with("time [s],contact\n1.0,__import__('os')\n"),
}


@pytest.mark.parametrize("name", FORGED_SIGNALS)
def test_forged_signals_are_refused(copy: Path, name: str) -> None:
    FORGED_SIGNALS[name](copy)
    reseal(copy)
    with pytest.raises(InputError, match=r"signals\.raw|samples\.csv"):
        Run.load(copy)


FORGED_BOARDS = {
    "no lines": put("lines", []),
    "lines of text": put("lines", [".title", "R1 a b 1"]),
    "a line that is a number": put("lines.3.text", 4),
    "a line of half a character": put("lines.3.text", "R1 a b \udcff"),
    "a place that is words": put("lines.3.lineno", "first"),
    "joints without number": put("joints", 10**9),
    "no joint": put("joints", -1),
    "pins of another board": put("pins", ["vcc"]),
    "pins that are numbers": put("pins", [1, 2]),
    "amplifiers of nothing": put("amplifiers", [{"path": "x"}]),
    "parts that are a table": put("parts", {}),
    "a path that is a list": put("path", ["/etc"]),
    "no digest": lambda record: record.pop("digest") and None,
    "a control block": put("lines.3.text", ".control"),
    "a shell": put("lines.3.text", "R1 a b 1\nshell touch MARK"),
    "a file's source": put("lines.3.text", '.model fs filesource (file="/etc/passwd")'),
    "an include": put("lines.3.text", ".include '/etc/passwd'"),
    "trusted by itself": lambda record: record["lines"][3].update(text=".control", trusted=True),
    "a back-tick": put("lines.3.text", "R`touch MARK` a b 1"),
}


@pytest.mark.parametrize("name", FORGED_BOARDS)
def test_a_forged_board_is_refused(copy: Path, name: str) -> None:
    board_with(copy, FORGED_BOARDS[name])
    try:
        board = deck_file.load(copy)
    except InputError:
        return
    # one that holds nothing but names may load: none of its words reaches ngspice as it stands
    from cosim.ngspice.gate import admit

    assert not any("`" in row for row in admit([line.text for line in board.lines], board.lines).rows)


def test_a_forged_list_of_files_deletes_nothing_outside(copy: Path, stored: Path) -> None:
    """Its check sums are those of the user's files: whoever knows a file's content can list it."""
    mine = copy.parent / "mine.txt"
    mine.write_text("years of work")
    (copy.parent / "deep").mkdir()
    (copy.parent / "deep" / "notes").write_text("years of work")
    (copy / "link").symlink_to(copy.parent / "deep")
    sums = hashlib.sha256(b"years of work").hexdigest()
    outside = ["../mine.txt", str(mine), "x/../../mine.txt", "link/notes", "./../mine.txt", "", ".", ".."]
    reseal(copy, lambda record: record["forms"].update(dict.fromkeys(outside, sums)))
    assert written_files(copy) & set(outside) == set()
    (copy / "link").unlink()
    with Staging(copy, written_files) as stage:
        shutil.copytree(stored, stage.path, dirs_exist_ok=True)
        stage.publish()
    assert mine.read_text() == "years of work"
    for files in (dict.fromkeys(outside, sums), [], 7, {"a": 1}):
        record = sealed({"format": 1, "files": files})
        (copy.parent / ".cosim-files.json").write_text(json.dumps(record))
        assert listed(copy.parent) == {".cosim-files.json"}


@pytest.mark.parametrize("command", ["report", "report two", "compare", "compare measures", "export"])
def test_commands_refuse_a_forged_result_in_words(
    copy: Path, stored: Path, command: str, capsys: pytest.CaptureFixture[str]
) -> None:
    reseal(copy, put("plan.constants.kt", {"__class__": "x"}))
    out = str(copy.parent / "out")
    if command == "export":
        with pytest.raises(InputError, match="constants"):
            export(resolve(load_scene(SCENES / "press.toml", QUICK)), Run.load(copy), out)
        return
    words = {
        "report": ["report", str(copy)],
        "report two": ["report", str(stored), str(copy)],
        "compare": ["compare", str(SCENES / "press.toml"), "--last", str(copy)],
        "compare measures": [
            "compare",
            str(SCENES / "press.toml"),
            "--last",
            str(copy),
            "--measure",
            "k_max",
        ],
    }[command]
    assert cli.main([*words, "-o", out]) == 2
    printed = capsys.readouterr()
    assert "run.json" in printed.err
    assert "kt" in printed.err
    assert "Traceback" not in printed.err + printed.out
    assert not os.path.exists(out)


@pytest.mark.few(6)
@pytest.mark.parametrize("kind", ["law", "operator", "measure"])
@pytest.mark.parametrize("command", ["report", "compare", "compare measures", "verify"])
def test_python_that_a_stored_scene_names_is_not_run(
    copy: Path, kind: str, command: str, capsys: pytest.CaptureFixture[str]
) -> None:
    (copy / "own.py").write_text(f"open({str(copy.parent / 'MARK')!r}, 'w').close()\nclass Own:\n    pass\n")
    where = f"{copy / 'own.py'}:Own"
    change = {
        "law": put("scene.computer.law", where),
        "operator": put("scene.operator", {"type": "python", "file": where}),
        "measure": put("scene.measures", {"names": [where]}),
    }[kind]
    reseal(copy, change)
    out = ["-o", str(copy.parent / "out")]
    if command == "report":
        assert cli.main(["report", str(copy), *out]) == 0
    elif command == "verify":
        assert cli.main(["verify", str(copy)]) == 2
        assert "--trust" in capsys.readouterr().err
    else:
        more = ["--measure", "k_max"] if command == "compare measures" else []
        assert cli.main(["compare", str(SCENES / "press.toml"), "--last", str(copy), *more, *out]) == 2
        assert "--trust" in capsys.readouterr().err
    assert not (copy.parent / "MARK").exists()


def test_a_run_of_another_scene_is_not_compared(copy: Path, capsys: pytest.CaptureFixture[str]) -> None:
    header_with(b"\timot2\t", b"\timotx\t")(copy)
    reseal(copy)
    words = ["compare", str(SCENES / "press.toml"), "--last", str(copy), "-o", str(copy.parent / "out")]
    assert cli.main(words) == 2
    assert "signals are missing" in capsys.readouterr().err


def test_a_result_with_another_number_is_not_verified(copy: Path, capsys: pytest.CaptureFixture[str]) -> None:
    raw_with(lambda t: t.__setitem__((5, 3), t[5, 3] + 1.0))(copy)
    reseal(copy)
    assert cli.main(["verify", str(copy)]) == 1
    assert "at place 5" in capsys.readouterr().out
    assert cli.main(["verify", str(copy), "--seed", "-1"]) == 2
    reseal(copy, put("provenance.versions", ["0.2.0"]))
    assert cli.main(["verify", str(copy)]) == 2


FORGED_SPECS = ["k_max", "a", 1.0], [1.0, 2.0, 3.0], ["k_max"], ["k_max", None, "1"]


@pytest.mark.parametrize("limits", FORGED_SPECS, ids=str)
def test_a_forged_study_is_not_repeated(
    limits: list[Any], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    asked = {
        "cosim": cosim.__version__, "scene": str(SCENES / "press.toml"), "overrides": [], "specs": [limits],
        "measures": ["k_max"], "n": 2, "method": "plain", "seed": 0, "until": "", "wanted": None,
        "corners": False, "two_level": False, "rare": False,
    }  # fmt: skip
    how = {"method": "plain", "n": 2, "variables": 3, "seed": 0, "replicates": 1}
    (tmp_path / "mc.json").write_text(json.dumps({"digest": "x", "asked": asked, "sampling": how}))
    assert cli.main(["verify", str(tmp_path)]) == 2
    assert "is not a record of a study" in capsys.readouterr().err


def test_python_that_a_stored_study_s_scene_names_is_not_run(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "own.py").write_text(f"open({str(tmp_path / 'MARK')!r}, 'w').close()\nclass Own:\n    pass\n")
    asked = {
        "cosim": cosim.__version__, "scene": str(SCENES / "press.toml"),
        "overrides": [f"computer.law={tmp_path / 'own.py'}:Own"], "specs": [], "measures": ["k_max"], "n": 2,
        "method": "plain", "seed": 0, "until": "", "wanted": None, "corners": False, "two_level": False,
        "rare": False,
    }  # fmt: skip
    how = {"method": "plain", "n": 2, "variables": 3, "seed": 0, "replicates": 1}
    (tmp_path / "mc.json").write_text(json.dumps({"digest": "x", "asked": asked, "sampling": how}))
    assert cli.main(["verify", str(tmp_path)]) == 2
    assert "--trust" in capsys.readouterr().err
    assert not (tmp_path / "MARK").exists()


def test_what_a_page_shows_of_a_forged_result_is_text(copy: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """What is of the right form is shown: without effect on browser, terminal or disk."""
    odd = "<script>alert(1)</script>\x1b[2J`touch MARK` $(touch MARK) {{7*7}} $\\frac"

    def change(record: dict[str, Any]) -> None:
        record["title"] = record["scene"]["title"] = odd
        record["printed"] = [odd]
        record["warnings"] = [{"code": odd, "text": odd, "advice": odd}]
        record["measures"][odd] = {"value": 1.0, "unit": odd, "text": odd}
        record["provenance"]["command"] = [odd]
        record["stats"][odd] = {odd: [odd]}
        record["events"] = [{"time": 0.01, "kind": odd, odd: odd}]
        record["plan"]["effects"][0] |= {"name": odd, "value": odd, "not_applicable": odd}

    reseal(copy, change)
    assert cli.main(["report", str(copy), "-o", str(copy.parent / "out")]) == 0
    printed = "".join(capsys.readouterr())
    assert "\x1b" not in printed
    page = (copy.parent / "out" / "report.html").read_text()
    assert "<script>alert" not in page
    assert "&lt;script&gt;" in page
    assert "49" not in page.split("{{7*7}}")[0][-20:]
    assert not list(copy.parent.rglob("MARK*"))


# --- points of sweeps, of accuracy, of studies


def forged_points(path: Path, digest: str, values: dict[str, Any]) -> None:
    with Points(path, digest) as points:
        for key, value in values.items():
            points.get(key, lambda value=value: value)  # type: ignore[misc]


@pytest.mark.parametrize("value", [7, None, [], {}, {"measures": 3, "warnings": []},
                                   {"measures": {"peak_force": "x"}, "warnings": []},
                                   {"measures": {"peak_force": 1.0}, "warnings": [{"code": 1}]},
                                   {"measures": {}, "warnings": {}}], ids=str)  # fmt: skip
def test_a_forged_point_of_a_sweep_is_computed_again(
    value: Any, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("cosim.comparisons.sweep._digest", lambda *_, **__: "known")
    honest = {"measures": {"k_max": 5.0}, "warnings": []}
    monkeypatch.setattr("cosim.comparisons.sweep._measured", lambda *_: honest)
    keys = [f"seed={n}: k_max" for n in (1, 2)]
    forged_points(tmp_path / "points.jsonl", "known", dict.fromkeys(keys, value))
    asked = ["sweep", str(SCENES / "press.toml"), "seed=1,2", "--measure", "k_max", "-o", str(tmp_path)]
    assert cli.main(asked) == 0, capsys.readouterr().err
    assert (tmp_path / "sweep.csv").read_text().count(",5.0") == 2


def test_forms_of_accuracys_points() -> None:
    run = {"measures": {"a": 1.0}, "motion": {"x": [0.0, 1]}, "wall_s": 1.0, "cpu_s": 1, "setup_s": 0.0,
           "points": 3, "rejected": 0, "states": None}  # fmt: skip
    assert fits(run, Summary)
    assert fits({**run, "times": [0.1]}, First)
    assert fits({**run, "decks": {"a": {"reason": "b"}}}, Second)
    for wrong in (
        {"wall_s": "1"},
        {"points": 1.5},
        {"measures": [1]},
        {"motion": {"x": "abc"}},
        {"states": "x"},
    ):
        assert not fits({**run, **wrong}, Summary)
    assert not fits(run, First)
    assert not fits({**run, "times": 3}, First)
    assert not fits({**run, "decks": [1]}, Second)


STUDY = """\
study = "budget"
title = "Budget"
scene = "{scene}"
"""


@pytest.fixture
def study(tmp_path: Path) -> Any:
    file = tmp_path / "study.toml"
    file.write_text(STUDY.format(scene=SCENES / "slope.toml"))
    return load_study(file)


@pytest.mark.parametrize("value", [7, None, {}, {"errors": 3}, {"errors": [], "forces": [], "r_tip": 0.1},
                                   {"errors": [["a"]], "forces": [], "r_tip": "x"}], ids=str)  # fmt: skip
def test_a_forged_point_of_a_study_is_an_error_of_its_file(study: Any, value: Any, tmp_path: Path) -> None:
    forged_points(tmp_path / "out.points.jsonl", study.digest(), {"budget": value})
    with pytest.raises(InputError, match=r"points\.jsonl: holds what cannot be used .*remove it"):
        run_study(study, tmp_path / "out")


TABLE = {"name": "errors", "title": "t", "columns": {"a": [1.0]}, "note": ""}
FORGED_STUDIES = {
    "no tables": {"tables": []},
    "a table of words": {"tables": ["x"]},
    "columns that are numbers": {"tables": [{**TABLE, "columns": {"a": 1}}]},
    "columns of unequal length": {"tables": [{**TABLE, "columns": {"a": [1], "b": []}}]},
    "a table that leads out": {"tables": [{**TABLE, "name": "../../errors"}]},
    "columns of another study": {"tables": [TABLE]},
    "cells that are tables": {"tables": [{**TABLE, "columns": {"source": [{}], "meant as": [[]]}}]},
    "a verdict of nothing": {"verdicts": [{"id": "F13"}]},
    "a verdict that holds by words": {
        "verdicts": [{"id": "a", "claim": "b", "expected": "c", "outcome": "d", "holds": "yes", "own": False}]
    },
    "another study": {"study": "maps"},
    "a module of no study": {"study": "../../os"},
    "seconds of words": {"seconds": "long"},
}


@pytest.mark.parametrize("name", FORGED_STUDIES)
def test_a_forged_record_of_a_study_is_refused(study: Any, name: str, tmp_path: Path) -> None:
    out = tmp_path / "out"
    out.mkdir()
    record = {"format": 3, "study": "budget", "title": "t", "tables": [], "verdicts": [], "notes": [],
              "seconds": 1.0, "digest": study.digest(), **FORGED_STUDIES[name]}  # fmt: skip
    (out / "study.json").write_text(json.dumps(sealed(record)))
    with pytest.raises(InputError, match=r"study\.json"):
        write_study_page([("study", run_study(study, out))], tmp_path / "page", "t", "cosim report")
    assert not (tmp_path / "page").exists()


def test_a_study_of_the_version_before_is_read(study: Any, tmp_path: Path) -> None:
    """Version 2 named the outcome of a verdict "found"."""
    verdict = {"id": "a", "claim": "b", "expected": "c", "found": "d", "holds": True, "own": False}
    record = {"format": 2, "study": "budget", "title": "t", "tables": [], "verdicts": [verdict], "notes": [],
              "seconds": 1.0, "digest": study.digest()}  # fmt: skip
    (tmp_path / "study.json").write_text(json.dumps(sealed(record)))
    assert run_study(study, tmp_path).verdicts == (Verdict("a", "b", "c", "d", True),)


def test_a_study_of_right_form_is_text_on_the_page() -> None:
    assert Table("a", "b", {"c": [1]}).columns == {"c": [1]}
    assert Verdict("a", "b", "c", "d", None).holds is None


# --- samples of Monte Carlo


def rewritten(change: Callable[[pa.Table], pa.Table]) -> Callable[[Path], None]:
    def forge(file: Path) -> None:
        pq.write_table(change(pq.read_table(file)), file)

    return forge


def column(name: str, values: Any) -> Callable[[pa.Table], pa.Table]:
    return lambda table: table.set_column(table.column_names.index(name), name, [values(table[name])])


FORGED_SAMPLES = {
    "not Parquet": lambda file: file.write_bytes(b"PAR1" + b"\0" * 99),
    "a pipe of text": lambda file: file.write_text("sample,a\n1,2\n"),
    "other columns": rewritten(lambda t: t.rename_columns([f"x{k}" for k in range(t.num_columns)])),
    "a column of words": rewritten(column("sample", lambda c: pa.array(map(str, c.to_pylist())))),
    "numbers of other samples": rewritten(column("sample", lambda c: pa.array([7] * len(c), pa.int64()))),
    "fewer rows": rewritten(lambda t: t.slice(3)),
    "empty places": rewritten(column("missing", lambda c: pa.array([None] * len(c), pa.string()))),
    "numbers without end": lambda file: rewritten(
        column(pq.read_table(file).column_names[1], lambda c: pa.array([np.inf] * len(c)))
    )(file),
}


@pytest.mark.parametrize("name", FORGED_SAMPLES)
def test_forged_samples_are_refused_or_measured_again(name: str, tmp_path: Path) -> None:
    mine = job(tmp_path, 12)
    truth = measure(mine, tmp_path / "mc", workers=1).folder / "samples.parquet"
    honest = truth.read_bytes()
    FORGED_SAMPLES[name](truth)
    before = truth.read_bytes()
    with pytest.raises(InputError, match=r"samples\.parquet: is not what a study"):
        measure(mine, tmp_path / "mc", workers=1)
    with pytest.raises(InputError, match=r"samples\.parquet"):
        merge(mine, tmp_path / "merged", [tmp_path / "mc"])
    assert truth.read_bytes() == before
    # as a part of an interrupted study it is measured again
    (tmp_path / "mc" / "parts").mkdir()
    truth.rename(tmp_path / "mc" / "parts" / f"{0:012d}-12.parquet")
    assert (measure(mine, tmp_path / "mc", workers=1).folder / "samples.parquet").read_bytes() == honest


FORGED_SHARDS: tuple[dict[str, Any], ...] = (
    {"first": "0"}, {"first": -5}, {"first": None}, {"first": 5, "last": 5}, {"last": 10**30}, {"last": 99},
    {"names": 3}, {"names": ["x"]},
)  # fmt: skip


@pytest.mark.parametrize("about", FORGED_SHARDS, ids=str)
def test_a_forged_shard_is_refused(about: dict[str, Any], tmp_path: Path) -> None:
    mine = job(tmp_path, 12)
    shard = measure(mine, tmp_path / "shard", workers=1).folder
    record = json.loads((shard / "study.json").read_text())
    (shard / "study.json").write_text(json.dumps({**record, **about}))
    with pytest.raises(InputError, match="no samples of this study"):
        merge(mine, tmp_path / "merged", [shard])


def test_a_file_of_the_users_among_parts_is_kept(tmp_path: Path) -> None:
    mine = job(tmp_path, 12)
    (tmp_path / "mc" / "parts").mkdir(parents=True)
    (tmp_path / "mc" / "parts" / "thesis.txt").write_text("years of work")
    measure(mine, tmp_path / "mc", workers=1)
    assert (tmp_path / "mc" / "parts" / "thesis.txt").read_text() == "years of work"
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "samples.parquet").write_text("years of work")
    with pytest.raises(InputError, match="nothing was changed"):
        measure(mine, tmp_path / "other", workers=1)
    assert (tmp_path / "other" / "samples.parquet").read_text() == "years of work"


@pytest.mark.parametrize(
    "text", ["[1]", "{", '{"digest": 1e999}', '{"digest": "' + "\\ud800" + '"}', "[" * 99999]
)
def test_a_forged_record_of_monte_carlo_is_another_study(
    text: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "mc.json").write_text(text)
    asked = ["mc", str(SCENES / "press.toml"), "-n", "2", "--measure", "k_max", "-o", str(tmp_path)]
    assert cli.main(asked) == 2
    assert "holds another study" in capsys.readouterr().err
