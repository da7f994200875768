"""setup/ngspice.sh asks for what is missing, and fails only without the library."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

SCRIPT = Path(__file__).parents[1] / "setup" / "ngspice.sh"
TOOLS = ("grep", "id", "printf")

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="a script for a Unix shell")


@pytest.fixture
def bare(tmp_path: Path) -> Path:
    """A folder of programs with a package manager that has nothing, and a linker that knows no ngspice."""
    folder = tmp_path / "bin"
    folder.mkdir()
    for name in TOOLS:
        (folder / name).symlink_to(shutil.which(name) or "")
    for name, text in (("apt-get", "exit 1"), ("ldconfig", "echo nothing")):
        program(folder, name, text)
    return folder


def program(folder: Path, name: str, text: str = "exit 0") -> None:
    file = folder / name
    file.write_text(f"#!/bin/sh\n{text}\n")
    file.chmod(0o755)


def setup(folder: Path, *asked: str, library: Path | None = None) -> "subprocess.CompletedProcess[str]":
    env = {"PATH": str(folder)} | ({} if library is None else {"NGSPICE_LIBRARY_PATH": str(library)})
    shell = shutil.which("sh") or "/bin/sh"
    return subprocess.run(
        [shell, str(SCRIPT), *asked],
        env=env,
        capture_output=True,
        text=True,
        check=False,
        stdin=subprocess.DEVNULL,
    )


def test_without_the_library_it_fails_and_says_what_to_run(bare: Path) -> None:
    done = setup(bare)
    assert done.returncode == 1
    assert "apt-get install libngspice0 ngspice" in done.stderr
    assert "NGSPICE_LIBRARY_PATH" in done.stderr


@pytest.mark.parametrize("named", [True, False])
def test_the_library_without_the_program_is_enough(bare: Path, tmp_path: Path, named: bool) -> None:
    library = tmp_path / "a folder" / "libngspice.so.0"
    library.parent.mkdir()
    library.touch()
    program(bare, "ldconfig", f"echo 'libngspice.so.0 => {library}'")
    done = setup(bare, library=library if named else None)
    assert done.returncode == 0
    assert "no ngspice program" in done.stderr
    assert setup(bare, "chromium").returncode == 0


def test_a_named_library_that_is_not_there_is_reported(bare: Path, tmp_path: Path) -> None:
    done = setup(bare, library=tmp_path / "nowhere.so")
    assert done.returncode == 1
    assert "names no file" in done.stderr


@pytest.mark.parametrize("browser", ["chromium", "chromium-browser", "google-chrome"])
def test_nothing_is_done_where_all_is_there(bare: Path, browser: str) -> None:
    program(bare, "ngspice")
    program(bare, browser)
    program(bare, "ldconfig", "echo 'libngspice.so.0 => /usr/lib/libngspice.so.0'")
    program(bare, "apt-get", "echo touched >&2; exit 1")
    done = setup(bare, "chromium")
    assert (done.returncode, done.stderr) == (0, "")


def test_a_package_manager_that_helps(bare: Path, tmp_path: Path) -> None:
    if os.getuid() != 0:
        program(bare, "sudo", 'while [ "${1#-}" != "$1" ]; do shift; done; "$@"')
    library = tmp_path / "libngspice.so.0"
    touch = shutil.which("touch")
    program(bare, "ldconfig", f"[ -e '{library}' ] && echo libngspice.so.0; true")
    program(bare, "apt-get", f'case "$*" in *install*libngspice0*) {touch} "{library}";; esac')
    done = setup(bare)
    assert done.returncode == 0, done.stderr
    assert library.exists()
