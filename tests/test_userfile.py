"""A user's Python file: loaded as it stands, and nothing is left beside it."""

import os
from pathlib import Path

import pytest

from mech.userfile import load_file


@pytest.fixture(autouse=True)
def as_python_is_by_default(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sys.dont_write_bytecode", False)


def test_nothing_is_left_beside_the_file(tmp_path: Path) -> None:
    (tmp_path / "beside.py").write_text("X = 3\n")
    file = tmp_path / "law.py"
    file.write_text(
        f"import sys\nsys.path.insert(0, {str(tmp_path)!r})\nfrom beside import X\ndel sys.path[0]\n"
    )
    assert load_file(file).X == 3
    assert sorted(p.name for p in tmp_path.iterdir()) == ["beside.py", "law.py"]


def test_an_edit_of_equal_size_and_time_is_seen(tmp_path: Path) -> None:
    """Bytecode that another program left there is not believed either."""
    import py_compile

    file = tmp_path / "law.py"
    file.write_text("X = 1\n")
    py_compile.compile(str(file))
    about = file.stat()
    file.write_text("X = 2\n")
    os.utime(file, ns=(about.st_atime_ns, about.st_mtime_ns))
    assert load_file(file).X == 2


def test_a_dataclass_with_postponed_annotations(tmp_path: Path) -> None:
    file = tmp_path / "law.py"
    file.write_text(
        "from __future__ import annotations\nfrom dataclasses import dataclass\n"
        "@dataclass\nclass Law:\n    gain: float = 2.0\n"
    )
    assert load_file(file).Law().gain == 2.0


def test_files_of_one_name_in_two_folders(tmp_path: Path) -> None:
    for name in ("a", "b"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "law.py").write_text(f"NAME = {name!r}\n")
    one, other = (load_file(tmp_path / name / "law.py") for name in ("a", "b"))
    assert (one.NAME, other.NAME) == ("a", "b")
    assert one.__name__ != other.__name__


def test_what_the_file_raises_is_passed_on_and_nothing_is_kept(tmp_path: Path) -> None:
    import sys

    file = tmp_path / "law.py"
    file.write_text("1 / 0\n")
    before = set(sys.modules)
    with pytest.raises(ZeroDivisionError):
        load_file(file)
    assert set(sys.modules) == before
    assert not sys.dont_write_bytecode
