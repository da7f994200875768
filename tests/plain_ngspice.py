"""The ngspice program itself, without anything of ours."""

import shutil
import subprocess

import pytest

from cosim.storage.rawfile import read_raw


def ngspice(deck, *, raw=True):
    """Run the program in a folder that is not the deck's; return its output, or the raw file's signals."""
    if shutil.which("ngspice") is None:
        pytest.skip("the ngspice program is not installed")
    folder = deck.parent / "elsewhere"
    folder.mkdir(exist_ok=True)
    file = folder / "out.raw"
    command = ["ngspice", "-b", str(deck), *(["-r", str(file)] if raw else [])]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, timeout=300, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    return read_raw(file) if raw else done.stdout
