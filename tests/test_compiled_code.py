"""Libraries of compiled code: never stale, never damaged, the same bytes from the same sources."""

import ctypes
import os
import shutil
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support import SCENES

from cosim import cli
from cosim.loop.linear.divided_differences import TOP, single
from cosim.loop.linear.exact_steps import leaps
from cosim.loop.pin_voltages import is_gain
from mech import Chain, library_files
from mech.energy import energy
from mech.kinematics import tip
from mech.records import LINKAGE, OPERATOR

ROOT = Path(__file__).resolve().parents[1]
#: Calls a function with a known value, tip of one link of 0.5 m at angle 0, and prints it and who was there.
CALL = """
import sys, mech
print(mech.Chain(lengths_m=(0.5,), masses_kg=0.1).forward((0.0,))[0], "numba" in sys.modules)
"""


def call(place: Path, folder: Path, **more: str) -> subprocess.CompletedProcess[str]:
    """Call it from the sources in `place`, in a process of its own."""
    env = {**os.environ, library_files.FOLDER: str(folder), "PYTHONPATH": str(place), **more}
    return subprocess.run(
        [sys.executable, "-c", CALL], cwd=folder, env=env, capture_output=True, text=True, check=False
    )


@pytest.fixture
def mechanics(tmp_path: Path) -> Path:
    """A folder of sources that has the mechanics alone, and so one small library."""
    shutil.copytree(
        ROOT / "mech", tmp_path / "some place" / "mech", ignore=shutil.ignore_patterns("__pycache__")
    )
    (tmp_path / "libraries").mkdir()
    return tmp_path / "some place"


DAMAGES = [
    lambda whole: b"",
    lambda whole: whole[: len(whole) // 2],
    lambda whole: whole[:-1],
    lambda whole: whole[:400] + bytes([whole[400] ^ 8]) + whole[401:],
    lambda whole: b"\0" * len(whole),
    lambda whole: whole + b"x",
]


@pytest.mark.parametrize("damage", DAMAGES)
def test_damage_is_seen(tmp_path: Path, damage: Any) -> None:
    """Broken once: without the check sum a flipped byte passes."""
    file = tmp_path / "one.library"
    file.write_bytes(library_files.pack(bytes(range(256)) * 4))
    assert library_files.unpack(file) == bytes(range(256)) * 4
    file.write_bytes(damage(file.read_bytes()))
    assert library_files.unpack(file) is None


@pytest.mark.slow
def test_a_library_is_built_once_anew_where_damaged_and_serves_a_moved_installation(mechanics: Path) -> None:
    folder = mechanics.parent / "libraries"
    assert call(mechanics, folder).stdout.split() == ["0.5", "False"]
    (file,) = folder.glob("*.library")
    first, born = file.read_bytes(), file.stat().st_mtime_ns
    assert call(mechanics, folder).returncode == 0
    assert file.stat().st_mtime_ns == born
    # the same sources make the same bytes, whatever was there before
    file.write_bytes(first[:-7])
    moved = mechanics.rename(mechanics.with_name("moved"))
    assert call(moved, folder).stdout.split() == ["0.5", "False"]
    assert file.read_bytes() == first
    # other sources make another file
    with (moved / "mech" / "kinematics.py").open("a") as stream:
        stream.write("# changed\n")
    assert call(moved, folder).returncode == 0
    assert len(list(folder.glob("*.library"))) == 2


def test_libraries_that_nobody_uses_any_more_are_removed(tmp_path: Path, monkeypatch: Any) -> None:
    """Of twelve versions eight stay, and any of the last day; of two the one of last month goes."""
    monkeypatch.setenv(library_files.FOLDER, str(tmp_path))
    day_s, now_s = 86400.0, time.time()
    ages = {
        "mech": [0.5, 0.9, *range(2, 12)],
        "cosim.loop": [29, 31],
        "cosim.loop.spice": [0.1 * k for k in range(9)],
    }
    for package, days in ages.items():
        for k, age in enumerate(days):
            file = tmp_path / f"{package}-{k:016x}.library"
            file.touch()
            os.utime(file, (now_s - age * day_s,) * 2)
    (tmp_path / "cosim.loop.spice.lock").touch()
    library_files._tidy_up()
    left = {package: len(list(tmp_path.glob(f"{package}-*"))) for package in ages}
    assert left == {"mech": 8, "cosim.loop": 1, "cosim.loop.spice": 9}
    assert (tmp_path / f"mech-{7:016x}.library").exists()
    assert (tmp_path / "cosim.loop.spice.lock").exists()


def test_a_library_in_use_is_not_old(tmp_path: Path, monkeypatch: Any) -> None:
    """A version that runs each day is not removed by another that is built each day."""
    monkeypatch.setenv(library_files.FOLDER, str(tmp_path))
    files, old_s = [library_files.file_of(package) for package in library_files.PACKAGES], time.time() - 4e6
    for file in files:
        file.write_bytes(library_files.pack(b"code"))
        os.utime(file, (old_s, old_s))
    library_files.ready()
    library_files._tidy_up()
    assert all(file.exists() for file in files)


def test_a_process_that_builds_none_says_what_is_missing(mechanics: Path) -> None:
    done = call(mechanics, mechanics.parent / "libraries", COSIM_BUILDS_NONE="1")
    assert done.returncode != 0
    assert "compiled code is missing, and this process builds none" in done.stderr
    assert not list((mechanics.parent / "libraries").iterdir())


def test_what_cannot_be_compiled_says_why(mechanics: Path) -> None:
    source = mechanics / "mech" / "kinematics.py"
    source.write_text(source.read_text().replace("def tip(p", "def tip(p, more", 1))
    done = call(mechanics, mechanics.parent / "libraries")
    assert done.returncode != 0
    assert "the compiled code cannot be built: " in done.stderr


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write everywhere")
def test_where_nothing_can_be_written_a_process_keeps_its_own(mechanics: Path) -> None:
    folder = mechanics.parent / "libraries"
    folder.chmod(0o555)
    assert call(mechanics, folder).stdout.split() == ["0.5", "False"]
    assert not list(folder.iterdir())


def test_the_table_of_packages_is_what_the_sources_say() -> None:
    offers = {
        library_files.library_of(".".join(path.relative_to(ROOT).with_suffix("").parts))
        for folder in ("mech", "cosim")
        for path in (ROOT / folder).rglob("*.py")
        if library_files._OFFERS.search(path.read_text(encoding="utf-8"))
    }
    assert offers == set(library_files.PACKAGES)


def test_a_library_is_another_when_what_its_modules_import_changes(monkeypatch):
    packages = library_files.PACKAGES
    before = {package: library_files.stamp(package) for package in packages}
    modules = {package: (*library_files.modules_of(package), "mech.build") for package in packages}
    closures = {package: library_files.closure(each) for package, each in modules.items()}
    for module in (
        "mech.build", "mech.kinematics",
        "cosim.loop.spice.watch", "cosim.circuits.decks", "cosim.scene.schema",
    ):  # fmt: skip
        text = {**library_files.sources(), module: library_files.sources()[module] + b"\n"}
        changed = library_files._Sources(text)
        library_files.stamp.cache_clear()
        monkeypatch.setattr(library_files, "sources", lambda changed=changed: changed)
        try:
            others = {package for package in packages if library_files.stamp(package) != before[package]}
        finally:
            monkeypatch.undo()
            library_files.stamp.cache_clear()
        assert others == {package for package in packages if module in closures[package]}
    assert {"mech.kinematics", "mech.build"} <= set.intersection(*closures.values())
    # its limits are constants of the watch's
    assert "cosim.circuits.decks" in closures["cosim.loop.spice"]
    assert "cosim.loop.spice.watch" not in closures["cosim.loop.linear"]


def test_a_library_is_another_when_what_translates_it_changes(monkeypatch):
    numba = pytest.importorskip("numba")
    assert numba.__version__.encode() in library_files._translator()
    before = library_files.stamp("mech")
    monkeypatch.setattr(library_files, "_translator", lambda: b"a later version")
    library_files.stamp.cache_clear()
    try:
        assert library_files.stamp("mech") != before
    finally:
        library_files.stamp.cache_clear()


def test_imports_are_found_in_every_form(monkeypatch):
    text = b"import mech.a, mech.b as b\nfrom mech.c import (\n    d,\n    e,  # word\n)\n"
    text += b"if x:\n    from mech import f, g as h\n"
    names = ("mech.x", *(f"mech.{c}" for c in "abcfg"), "mech.c.d", "mech.c.e", "mech")
    known = library_files._Sources({name: text if name == "mech.x" else b"" for name in names})
    monkeypatch.setattr(library_files, "sources", lambda: known)
    library_files._imports.cache_clear()
    try:
        assert {name for name in library_files.closure(["mech.x"]) if known[name] != b""} == {"mech.x"}
        assert library_files.closure(["mech.x"]) >= set(names)
    finally:
        library_files._imports.cache_clear()


P = Chain(lengths_m=(0.3, 0.2), masses_kg=0.1).pack()


@pytest.mark.parametrize(
    "arguments",
    [
        (P, np.zeros(2), np.zeros(2)),  # an array of records for one record
        (np.zeros(1, [("n", "i8")])[0], np.zeros(2), np.zeros(2)),
        (P[0], np.zeros(2, np.float32), np.zeros(2)),
        (P[0], np.zeros((1, 2)), np.zeros(2)),
        (P[0], np.zeros(4)[::2], np.zeros(2)),
        (P[0], np.zeros(2, int), np.zeros(2)),
    ],
)
def test_an_argument_of_another_kind_is_refused_where_it_would_be_misread(arguments: Any) -> None:
    """Addresses carry no types. Broken once: without the check of contiguity the strided array passes."""
    with pytest.raises(TypeError, match=r"not (a contiguous array|one record)"):
        tip(*arguments)


def test_numbers_of_all_kinds_arrive_and_return() -> None:
    assert P.dtype == LINKAGE
    flat = Chain(lengths_m=(0.3, 0.2), masses_kg=0.1)
    assert energy(flat.pack()[0], np.zeros(1, OPERATOR)[0], np.zeros(2), np.zeros(2)) == (0.0, 0.0)
    values = np.zeros(TOP + 1, complex)
    single(0.3 + 0.4j, values)  # F_0 = exp
    assert values[0] == pytest.approx(np.exp(0.3 + 0.4j), rel=1e-15)


def test_inner_functions_are_refused_and_too_few_arguments() -> None:
    with pytest.raises(
        TypeError, match=r"cosim\.loop\.pin_voltages\.is_gain is called by compiled code alone"
    ):
        is_gain(None, 0)
    with pytest.raises(ValueError, match="shorter"):
        leaps(0, 0)


def test_an_entry_keeps_its_name_and_words() -> None:
    assert tip.__name__ == "tip"
    assert tip.__doc__ is not None
    assert isinstance(tip._function, ctypes._CFuncPtr)


#: Lets the C library have no memory, and calls what needs some.
NO_MEMORY = """
import ctypes
import llvmlite.binding as llvm
import numpy as np
from mech import Chain
from mech.records import OPERATOR, new_work
from mech.stiction import settle

none = ctypes.CFUNCTYPE(ctypes.c_void_p, ctypes.c_size_t)(lambda size: None)
llvm.add_symbol("malloc", ctypes.cast(none, ctypes.c_void_p).value)
p = Chain(lengths_m=(0.3, 0.2), masses_kg=0.1, coulomb_n_m=0.1).pack()
settle(p[0], np.zeros(1, OPERATOR)[0], 0.0, *np.zeros((4, 6)), new_work()[0])
"""


def test_no_memory_is_an_error_and_no_crash() -> None:
    """It ended the process by a trap once."""
    env = {**os.environ, "PYTHONPATH": str(ROOT)}
    done = subprocess.run(
        [sys.executable, "-c", NO_MEMORY], env=env, capture_output=True, text=True, check=False
    )
    assert (done.returncode, done.stderr.splitlines()[-1]) == (1, "MemoryError: settle")


@pytest.mark.slow
@pytest.mark.own_process
def test_warm_compiles_ahead_and_says_where(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setenv(library_files.FOLDER, str(tmp_path))
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    assert not library_files.is_built()
    assert cli.main(["warm"]) == 0
    out, err = capsys.readouterr()
    assert library_files.is_built()
    assert str(tmp_path) in out
    assert "linear stepper: " in err
    assert "in step with ngspice: " in err
    assert cli.main(["warm"]) == 0
    assert "compiling" not in capsys.readouterr().err
    kept = set((tmp_path / "cache" / "cosim" / "circuits").iterdir())
    assert cli.main(["run", str(SCENES / "slope.toml"), "-o", str(tmp_path / "run")]) == 0
    assert set((tmp_path / "cache" / "cosim" / "circuits").iterdir()) == kept  # nothing was left to measure
