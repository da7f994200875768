"""Nothing of the user's is ever overwritten or deleted, and what cannot be written is refused at once."""

import json
import os
import shutil
from importlib import import_module
from pathlib import Path

import pytest
from support import BOARD1, ROOT, SCENES, scene_of, simulate, slider

from cosim import cli
from cosim.comparisons.effects_ledger import EffectsLedger, Row
from cosim.errors import CosimError, InputError
from cosim.results import FORMATS, Run
from cosim.scene import load_scene
from cosim.storage.owned_files import own_file, write_file, write_files
from cosim.storage.staging import writable_folder
from cosim.terminal import printable
from reports import write_report


@pytest.fixture(scope="module")
def result(tmp_path_factory: pytest.TempPathFactory) -> Run:
    folder = tmp_path_factory.mktemp("once")
    tables = slider(duration_s=0.05, solver={"model": "linear"})
    return simulate(scene_of(folder, tables), folder / "run")


@pytest.fixture(scope="module")
def result_folder(result: Run, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = result.save(tmp_path_factory.mktemp("whole") / "out", formats=FORMATS)
    write_report(Run.load(folder), folder / "report")
    return folder


@pytest.fixture
def out(result_folder: Path, tmp_path: Path) -> Path:
    """A result with all its forms and its page."""
    return Path(shutil.copytree(result_folder, tmp_path / "out"))


def contents(folder: Path) -> dict[str, bytes]:
    return {
        path.relative_to(folder).as_posix(): path.read_bytes() for path in folder.rglob("*") if path.is_file()
    }


# --- results


def test_a_result_with_its_page_is_replaced(result: Run, out: Path) -> None:
    result.save(out)
    assert {path.name for path in out.iterdir()} == {
        "run.json", "signals.raw", "signals.parquet", "samples.csv", "scene.toml",
    }  # fmt: skip


@pytest.mark.parametrize(
    "name",
    [
        "thesis.txt",
        "report/notes.txt",
        "deep/er/thesis.txt",
        ".hidden",
        "signals.csv.bak",
        "report/figures/own.png",
    ],
)
def test_a_file_of_the_users_in_a_result_is_kept(result: Run, out: Path, name: str) -> None:
    (out / name).parent.mkdir(parents=True, exist_ok=True)
    (out / name).write_text("years of work")
    before = contents(out)
    with pytest.raises(InputError, match="nothing was changed"):
        result.save(out)
    assert contents(out) == before


@pytest.mark.parametrize(
    "name", ["scene.toml", "samples.csv", "signals.csv", "report/report.html", "run.json"]
)
def test_a_file_that_was_edited_is_the_users(result: Run, out: Path, name: str) -> None:
    with (out / name).open("a") as stream:
        stream.write("# my own line\n")
    before = contents(out)
    with pytest.raises(InputError, match=f"holds {name.split('.')[0]}|holds "):
        result.save(out)
    assert contents(out) == before


def test_a_link_in_a_result_is_kept(result: Run, out: Path, tmp_path: Path) -> None:
    (tmp_path / "data").mkdir()
    (tmp_path / "data" / "thesis.txt").write_text("years of work")
    (out / "link").symlink_to(tmp_path / "data")
    with pytest.raises(InputError, match="holds link"):
        result.save(out)
    assert (out / "link" / "thesis.txt").read_text() == "years of work"


def test_a_run_json_of_somebody_else_proves_nothing(result: Run, tmp_path: Path) -> None:
    folder = tmp_path / "out"
    folder.mkdir()
    (folder / "run.json").write_text(json.dumps({"format": 2, "files": {"thesis.txt": "0"}}))
    (folder / "thesis.txt").write_text("years of work")
    with pytest.raises(InputError):
        result.save(folder)
    assert (folder / "thesis.txt").exists()


def test_a_file_that_comes_while_the_run_ends_is_kept(
    result: Run, out: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    rename = Path.rename

    def late(self: Path, target: Path) -> Path:
        if self == out:  # between the look and the renaming
            (out / "thesis.txt").write_text("years of work")
        return rename(self, target)

    monkeypatch.setattr(Path, "rename", late)
    with pytest.raises(InputError, match="moved aside"):
        result.save(out)
    kept = [path for path in out.parent.rglob("thesis.txt")]
    assert [path.read_text() for path in kept] == ["years of work"]


# --- pages


def test_a_page_replaces_its_own_files_only(result: Run, tmp_path: Path) -> None:
    page = write_report(result, tmp_path)
    (tmp_path / "figures" / "own.png").write_text("mine")
    (tmp_path / "thesis.txt").write_text("mine")
    stale = sorted((tmp_path / "figures").glob("path.*"))
    assert stale
    write_report(result, tmp_path)
    assert (tmp_path / "figures" / "own.png").read_text() == "mine"
    assert (tmp_path / "thesis.txt").read_text() == "mine"
    page.write_text(page.read_text() + "<!-- my remark -->")
    with pytest.raises(InputError, match="nothing was changed"):
        write_report(result, tmp_path)
    assert "my remark" in page.read_text()


@pytest.mark.few(1)
@pytest.mark.parametrize("name", ["report.html", "figures/energy.svg"])
def test_a_page_of_the_users_is_kept(result: Run, tmp_path: Path, name: str) -> None:
    (tmp_path / name).parent.mkdir(exist_ok=True)
    (tmp_path / name).write_text("mine")
    with pytest.raises(InputError, match="is in the way"):
        write_report(result, tmp_path)
    assert contents(tmp_path) == {name: b"mine"}


# --- tables and pictures of commands

#: Commands with `-o`, the short arguments that they need, and a file that each writes there.
PRODUCTS = {
    "stability": ([], "stability.csv"),
    "sweep": (["computer.analog_stiffness_n_per_m=50,100", "--measure", "k_max"], "sweep.csv"),
    "sweep picture": (["computer.analog_stiffness_n_per_m=50,100", "--measure", "k_max"], "sweep.png"),
    "effects": ([], "effects.svg"),
}


@pytest.mark.few(2)
@pytest.mark.parametrize("name", PRODUCTS)
def test_a_product_replaces_what_is_its_own_and_nothing_else(
    name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    arguments, file = PRODUCTS[name]
    row = Row("encoder", "True", {"peak_force": 0.1}, {"peak_force": 0.2}, 0.1, 0.1)
    peak = {"peak_force": {"value": 1.0, "unit": "N", "text": "largest force"}}
    ledger = EffectsLedger(peak, peak, 1.0, 2.0, (row,), 3)  # what is measured is not the question here
    monkeypatch.setattr("cosim.comparisons.effects_ledger.effects_ledger", lambda *_, **__: ledger)
    monkeypatch.setattr("reports.stability._PERIODS", (1.0, 2.0))
    monkeypatch.setattr("reports.stability._POINTS", 5)
    out = tmp_path / "out"
    command = [name.split()[0], str(SCENES / "press.toml"), *arguments, "-o", str(out)]
    out.mkdir()
    (out / "thesis.txt").write_text("years of work")
    for _ in range(2):  # what it wrote itself is replaced
        assert cli.main(command) == 0, capsys.readouterr().err
    (out / file).write_bytes((out / file).read_bytes() + b"\nmy remark")
    before = contents(out)
    capsys.readouterr()
    # told before anything is computed: no child is asked
    monkeypatch.setattr("cosim.ngspice.child.Child.call", lambda *_, **__: pytest.fail("computed first"))
    assert cli.main(command) == 2
    err = capsys.readouterr().err
    assert f"{out / file}: is in the way" in err
    assert contents(out) == before


def test_a_second_command_into_a_folder_takes_nothing_away_from_the_first(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """All pages have one name: the second is refused before it computes."""
    pages = {
        "reports.page": ("report.html", "figures/energy.csv"),
        "reports.monte_carlo": ("report.html", "samples.csv"),
        "reports.accuracy": ("report.html", "accuracy.csv"),
        "reports.hard_cases": ("report.html", "hard_cases.csv"),
        "reports.boards": ("report.html",),
        "reports.study_page": ("report.html", "data/limits.csv"),
    }
    manifests = [import_module(name).MANIFEST for name in pages]
    assert len(set(manifests)) == len(pages)
    monkeypatch.setattr("cosim.ngspice.child.Child.call", lambda *_, **__: pytest.fail("computed first"))
    scene = str(SCENES / "press.toml")
    commands = [
        ["mc", scene, "-n", "4", "--measure", "k_max"],
        ["accuracy", scene],
        ["hard-cases", "32"],
        ["report", str(SCENES / "paper" / "6b_onset.toml")],
    ]
    for command, product in zip(commands, [*list(pages)[1:4], "reports.study_page"], strict=True):
        for first in pages:
            if first == product:
                continue
            out = tmp_path / command[0] / first
            write_files(out, dict.fromkeys(pages[first], b"first"), import_module(first).MANIFEST)
            before = contents(out)
            assert cli.main([*command, "-o", str(out)]) == 2
            assert "report.html: is in the way" in capsys.readouterr().err
            assert contents(out) == before


def test_files_that_a_killed_call_left_are_its_own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_files(tmp_path, {"a.csv": b"1", "b.csv": b"2", "old.csv": b"0"})
    replace = os.replace

    def killed(source: Path, target: Path) -> None:
        if Path(target).name == "b.csv":
            raise KeyboardInterrupt
        replace(source, target)

    monkeypatch.setattr(os, "replace", killed)
    with pytest.raises(KeyboardInterrupt):
        write_files(tmp_path, {"a.csv": b"3", "b.csv": b"4"})
    monkeypatch.undo()
    assert contents(tmp_path).items() >= {"a.csv": b"3", "b.csv": b"2"}.items()
    write_files(tmp_path, {"a.csv": b"5", "b.csv": b"6"})
    assert contents(tmp_path).keys() == {"a.csv", "b.csv", ".cosim-files.json"}


def test_a_foreign_file_in_a_result_is_reported_before_plan_and_verdict(
    out: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    (out / "thesis.txt").write_text("years of work")
    monkeypatch.setattr("cosim.plan.resolve", lambda *_, **__: pytest.fail("planned first"))
    monkeypatch.setattr("cosim.runner.verdict", lambda *_, **__: pytest.fail("judged first"))
    assert cli.main(["run", str(SCENES / "press.toml"), "-o", str(out)]) == 2
    assert "holds thesis.txt" in capsys.readouterr().err
    with pytest.raises(InputError, match="holds thesis"):
        simulate(load_scene(SCENES / "press.toml"), out)


# --- single files


@pytest.mark.parametrize("command", ["export", "device"])
@pytest.mark.parametrize("kind", ["scene", "board", "text"])
def test_inputs_are_not_written_over(
    tmp_path: Path, command: str, kind: str, capsys: pytest.CaptureFixture[str]
) -> None:
    scene = tmp_path / "my.toml"
    scene.write_text((SCENES / "press.toml").read_text().replace("../netlists", str(ROOT / "netlists")))
    board = tmp_path / "board.cir"
    board.write_text(BOARD1.read_text())
    (tmp_path / "notes.txt").write_text("mine")
    target = {"scene": scene, "board": board, "text": tmp_path / "notes.txt"}[kind]
    before = contents(tmp_path)
    assert cli.main([command, str(scene), "-o", str(target)]) == 2
    assert "nothing was changed" in capsys.readouterr().err
    assert contents(tmp_path) == before


@pytest.mark.parametrize("command", ["export", pytest.param("device", marks=pytest.mark.slow)])
def test_a_single_file_replaces_what_it_wrote_and_nobody_has_edited(
    command: str, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    scene = scene_of(tmp_path, slider(duration_s=0.05, solver={"model": "linear"}))
    file, other = tmp_path / "out" / "my file", tmp_path / "out" / "another"
    file.parent.mkdir()
    words = [command, str(scene.file), "-o"]
    for _ in range(2):
        assert cli.main([*words, str(file)]) == 0
    assert (f"ngspice -b '{file}'" in capsys.readouterr().out) == (command == "export")
    assert cli.main([*words, str(other)]) == 0  # a second one beside it takes nothing away from the first
    first = file.read_bytes()
    lists = {f".{path.name}.cosim.json" for path in (file, other)}
    assert set(contents(file.parent)) == {file.name, other.name, *lists}
    # its beginning is what we write, and still it is the user's now: told before anything is computed
    file.write_bytes(first + b"* years of work\n")
    before = contents(file.parent)
    with monkeypatch.context() as patched:
        patched.setattr("cosim.ngspice.child.Child.call", lambda *_, **__: pytest.fail("computed first"))
        assert cli.main([*words, str(file)]) == 2
    assert "nothing was changed" in capsys.readouterr().err
    assert contents(file.parent) == before
    # what was moved to another name is nobody's: no list speaks of it
    file.rename(file.with_name("moved"))
    assert cli.main([*words, str(file.with_name("moved"))]) == 2
    assert cli.main([*words, str(file)]) == 0
    assert file.read_bytes() == first


def test_a_list_of_somebody_else_proves_nothing(tmp_path: Path) -> None:
    file = tmp_path / "thesis.cir"
    write_file(file, b"deck")
    kept = (tmp_path / ".thesis.cir.cosim.json").read_bytes()
    file.write_bytes(b"years of work")
    for forged in (
        kept,
        kept.replace(b'"seal"', b'"sea1"'),
        b"{}",
        b"[" * 99_999,
        b'{"format": 1, "files": 7}',
    ):
        (tmp_path / ".thesis.cir.cosim.json").write_bytes(forged)
        with pytest.raises(InputError, match="nothing was changed"):
            write_file(file, b"deck")
    assert file.read_bytes() == b"years of work"


def test_an_empty_file_may_be_written_and_a_link_leads_to_its_target(tmp_path: Path) -> None:
    (tmp_path / "deep").mkdir()
    (tmp_path / "deep" / "deck.cir").touch()
    (tmp_path / "link.cir").symlink_to(tmp_path / "deep" / "deck.cir")
    for _ in range(2):
        write_file(tmp_path / "link.cir", b"deck")
    assert (tmp_path / "link.cir").is_symlink()
    assert (tmp_path / "deep" / "deck.cir").read_bytes() == b"deck"
    with pytest.raises(InputError, match="too long"):
        write_file(tmp_path / ("n" * 250), b"deck")


# --- at once


@pytest.mark.parametrize(
    "given",
    [
        ["run", "no.toml"], ["report", "no"], ["sweep", "no.toml", "r12=1k,2k"], ["effects", "no.toml"],
        ["stability", "no.toml"], ["compare", "a.cir", "b.cir", "no.toml"],
    ],
    ids=lambda given: given[0],
)  # fmt: skip
def test_a_place_that_cannot_be_written_is_reported_before_anything_else(
    given: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The scene does not even exist: the place is looked at first."""
    (tmp_path / "file").write_text("mine")
    assert cli.main([*given, "-o", str(tmp_path / "file" / "out")]) == 2
    err = capsys.readouterr().err
    assert f"{tmp_path / 'file'}: exists and is not a folder" in err
    assert "no.toml" not in err


@pytest.mark.parametrize("command", ["export", "device"])
def test_a_file_that_cannot_be_written_is_reported_at_once(
    command: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    scene = str(SCENES / "press.toml")
    assert cli.main([command, scene, "-o", str(tmp_path / "no" / "folder" / "x")]) == 2
    assert "there is no such folder" in capsys.readouterr().err
    assert cli.main([command, scene, "-o", str(tmp_path)]) == 2
    assert "is not a place for a file" in capsys.readouterr().err


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write anywhere")
def test_a_folder_without_permission(tmp_path: Path) -> None:
    tmp_path.chmod(0o500)
    try:
        with pytest.raises(CosimError, match="cannot be written"):
            writable_folder(tmp_path / "deeper" / "out")
    finally:
        tmp_path.chmod(0o700)


def test_looking_leaves_nothing_behind(tmp_path: Path) -> None:
    writable_folder(tmp_path / "a" / "b")
    own_file(tmp_path / "x.csv")
    assert not list(tmp_path.iterdir())


# --- what is echoed


def test_a_scene_may_begin_with_a_mark(tmp_path: Path) -> None:
    text = (SCENES / "press.toml").read_text().replace("../netlists", str(ROOT / "netlists"))
    (tmp_path / "bom.toml").write_bytes(b"\xef\xbb\xbf" + text.encode())
    assert load_scene(tmp_path / "bom.toml").title == "Static push on a wall"


@pytest.mark.parametrize("mark", ["\x1b[2J\x1b]0;gone\x07", "\x9b2J", "\u202egnp", "\u2028", "\x7f\x08\r"])
def test_no_file_steers_the_terminal(mark: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    tables = slider(title=f"a {mark} title", duration_s=0.05, solver={"model": "linear"})
    scene = scene_of(tmp_path, tables)
    assert cli.main(["plan", str(scene.file)]) == 0
    assert cli.main(["plan", str(scene.file), "--set", f"title=b{mark}", "--json"]) in (0, 2)
    assert cli.main(["plan", str(scene.file), "--set", f"operator.type={mark}x"]) == 2
    printed = "".join(capsys.readouterr())
    assert not set(printed) & set(mark) - set("[2J]0;gone p")
    assert printable(f"a{mark}") in printed or "a " in printed


def test_a_long_line_is_not_echoed_whole(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    board = tmp_path / "board.cir"
    board.write_text(BOARD1.read_text() + "\n.control " + "x" * 200_000 + "\n")
    for more in ([], ["--json"]):
        assert cli.main(["check", str(board), *more]) == 2
        out, err = capsys.readouterr()
        assert 0 < len(out + err) < 3000


@pytest.mark.parametrize(
    ("given", "name"),
    [
        (["mc", "{scene}", "-n", "2", "--measure", "k_max"], "samples.csv"),
        (["mc", "{scene}", "-n", "2", "--measure", "k_max"], "samples.parquet"),
        (["accuracy", "{scene}"], "accuracy.json"),
        (["hard-cases", "21"], "hard_cases.csv"),
    ],
)
def test_a_file_in_the_way_of_a_study_is_reported_before_it_begins(
    given: list[str], name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    (tmp_path / name).write_text("years of work")
    for work in (
        "tolerance.engine._here",
        "accuracy.work_precision.run",
        "accuracy.hard_cases.hard_case.run",
    ):
        monkeypatch.setattr(f"cosim.{work}", lambda *_, **__: pytest.fail("computed first"))
    words = [word.format(scene=SCENES / "press.toml") for word in given]
    assert cli.main([*words, "-o", str(tmp_path)]) == 2
    assert name in capsys.readouterr().err
    assert contents(tmp_path) == {name: b"years of work"}
