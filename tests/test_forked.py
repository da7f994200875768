"""A child that is a copy of its parent: it serves, is confined, and leaves ngspice to others."""

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

HERE = Path(__file__).parent
pytestmark = pytest.mark.skipif(not sys.platform.startswith("linux"), reason="copies are made on Linux")
#: In a process of its own: this one has threads.
SCRIPT = """
import json, os, sys
sys.path.insert(0, {here!r})
from pathlib import Path
from cosim.errors import CosimError
from cosim.ngspice.child import call, start_early

def early():
    return start_early("cosim.loop.early_linear", library=False, shared=("numpy", "cosim.scene"),
                       reads=[Path({place!r})])

out = {{"parent": os.getpid()}}
with early() as child:
    out["copy"] = child.call("ngspice_targets:in_a_copy", {place!r})
    out["volts"] = float(child.call("ngspice_targets:simulate", "t\\nV1 a 0 3\\nR1 a 0 1k\\n")["a"][0])
with early() as child:
    out["forgiving"] = child.call("ngspice_targets:forgiving", "t\\nV1 a 0 3\\nR1 a 0 1k\\n")
    out["behind ngspice"] = child.call("ngspice_targets:in_a_copy", {place!r})
with early() as child:
    out["asked to read"] = call("ngspice_targets:in_a_copy", {place!r}, child=child, reads=[Path({place!r})])
with early() as child:
    try:
        child.call("ngspice_targets:segfault", None)
    except CosimError as error:
        out["crash"] = str(error)
with early() as child:
    try:
        child.call("ngspice_targets:spin", None, time_limit_s=0.5)
    except CosimError as error:
        out["limit"] = str(error)
print(json.dumps(out))
"""


@pytest.fixture(scope="module")
def seen(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    place = tmp_path_factory.mktemp("place")
    scratch = tmp_path_factory.mktemp("scratch")
    env = {**os.environ, "OPENBLAS_NUM_THREADS": "1", "TMPDIR": str(scratch), "SECRET": "of the parent"}
    code = SCRIPT.format(here=str(HERE), place=str(place))
    done = subprocess.run([sys.executable, "-c", code], env=env, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")
    return {**json.loads(done.stdout), "left": [*scratch.iterdir(), *place.iterdir()]}


def test_a_copy_has_a_folder_a_home_and_an_environment_of_its_own(seen: dict[str, Any]) -> None:
    copy = seen["copy"]
    assert copy["is_copy"]
    assert copy["pid"] != seen["parent"]
    assert copy["files"] == [".spiceinit"]
    assert copy["home"] != os.environ["HOME"]
    assert copy["secret"] is None
    assert copy["descriptors"] <= 5  # the usual three, answers, and that of the list
    assert seen["left"] == []


def test_a_copy_is_confined(seen: dict[str, Any]) -> None:
    """Broken once: without `confine` in `worker.serve` both are done."""
    assert seen["copy"]["made a process"] is False
    if seen["copy"]["landlock"]:
        assert seen["copy"]["wrote"] is False
        assert seen["copy"]["read"] is False


def test_a_process_of_its_own_runs_ngspice(seen: dict[str, Any]) -> None:
    assert seen["volts"] == 3.0
    assert not seen["behind ngspice"]["is_copy"]
    assert seen["behind ngspice"]["pid"] != seen["copy"]["pid"]


def test_what_goes_on_without_a_figure_does_not_go_on_without_ngspice(seen: dict[str, Any]) -> None:
    """As the verdict on stability. Broken once: it is "not to be had" if `NeedsNgspice` is a `CosimError`."""
    assert seen["forgiving"] == "3 V"


def test_a_process_of_its_own_runs_the_users_python(seen: dict[str, Any]) -> None:
    assert not seen["asked to read"]["is_copy"]
    assert seen["asked to read"]["read"] is True


def test_what_happens_to_a_copy_is_heard(seen: dict[str, Any]) -> None:
    assert "crashed (SIGSEGV)" in seen["crash"]
    assert "time limit of 0.5 s" in seen["limit"]
