"""The front door in Python: names, import orders, cost, scenes changed in Python, a run in a notebook."""

import subprocess
import sys
import types
import warnings
from pathlib import Path

import numpy as np
import pytest

import cosim
from cosim.assets import netlists_folder, scenes_folder
from cosim.caution import Caution, Doubt, collected, warn
from cosim.units import measured

ROOT = Path(__file__).resolve().parents[1]
PRESS = scenes_folder() / "press.toml"
SLOPE = scenes_folder() / "slope.toml"


def python(code: str) -> str:
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False, cwd=ROOT)
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_every_public_name_is_there_and_documented():
    for name in cosim.__all__:
        value = getattr(cosim, name)
        assert value.__doc__, name
        assert name in dir(cosim)
    with pytest.raises(AttributeError, match="no attribute 'stabilty'"):
        cosim.stabilty  # noqa: B018


def test_the_stub_names_what_the_package_names():
    """Types come from the stub, values from the module: both must list the same."""
    stub = (ROOT / "cosim" / "__init__.pyi").read_text()
    assert {line.split(" as ")[1] for line in stub.splitlines() if " as " in line} == set(cosim.__all__)


@pytest.mark.few(2)
@pytest.mark.parametrize(
    "first",
    ["cosim.loop.spice.run_spice", "cosim.runner", "cosim.checking.check", "cosim.comparisons.sweep",
     "cosim.comparisons.compare_boards", "cosim.studies.device", "cosim.analysis.stability"],
)  # fmt: skip
def test_names_mean_the_same_in_either_order_of_import(first):
    names = "cosim.run, cosim.check, cosim.sweep, cosim.compare, cosim.stability, cosim.noise, cosim.device"
    tell = f"print([f.__module__ + '.' + f.__name__ for f in ({names})])"
    one, other = (
        python(f"import {first}, cosim; {tell}"),
        python(f"import cosim; {tell}; import {first}; {tell}"),
    )
    assert one.count("cosim.api.") == 7
    assert other == one + one


def test_importing_costs_no_heavy_import():
    """`import cosim` takes no package along that numpy's import does not: then it cannot cost much more."""
    result = python(
        "import sys, cosim; heavy = ('numpy', 'scipy', 'numba', 'pydantic', 'matplotlib', 'pyarrow');"
        "print([name for name in heavy if name in sys.modules])"
    )
    assert result.strip() == "[]"


def test_a_run_on_linear_loads_neither_ngspice_nor_what_fits_a_circuit():
    """Its process finds the circuit in the cache; nor does it build the checks of a scene that it is sent."""
    heavy = ("PySpice", "cosim.ngspice.simulator", "cosim.circuits.fitting.networks", "scipy.linalg", "numba",
             "cosim.circuits.extraction.path_measurement", "importlib.metadata")  # fmt: skip
    result = python(
        f"import sys, cosim.loop.early_linear; print([name for name in {heavy} if name in sys.modules]);"
        "from cosim.scene import Scene; print(Scene.__pydantic_complete__)"
    )
    assert result.split() == ["[]", "False"]


def test_importing_costs_at_most_half_more_than_numpy():
    """In processor time, of pairs one after the other, so that the machine's load drops out."""

    def seconds(name: str) -> float:
        code = f"import {name}, time; print(time.process_time())"
        return float(python(code)) - float(python("import time; print(time.process_time())"))

    assert np.median([seconds("cosim") / seconds("numpy") for _ in range(5)]) <= 1.5


def test_types_are_shipped():
    """PEP 561: a package says that its annotations are meant for others."""
    assert all((ROOT / package / "py.typed").is_file() for package in ("cosim", "mech", "reports"))


def test_a_scene_changed_in_python_is_that_of_its_file():
    scene = cosim.load_scene(PRESS)
    changed = scene.with_values({"computer.period_s": 0.005, "r_sum_spring": "24k"})
    file = cosim.load_scene(PRESS, ["computer.period_s=0.005", "device.values.r_sum_spring=24k"])
    assert changed == file
    assert changed.digest() == file.digest()
    assert changed.effects.model_fields_set == file.effects.model_fields_set
    assert scene == cosim.load_scene(PRESS)


def test_a_written_scene_is_that_of_python(tmp_path):
    changed = cosim.load_scene(PRESS).with_values({"computer.period_s": 0.005, "r_sum_spring": "24k"})
    copy = tmp_path / "copy.toml"
    copy.write_text(changed.to_toml())
    assert cosim.load_scene(copy).as_dict() == changed.as_dict()


@pytest.mark.parametrize(
    ("key", "value", "read"),
    [
        ("computer.period_s", np.float64(0.004), lambda scene: scene.computer.period_s == 0.004),
        ("seed", np.int64(7), lambda scene: scene.seed == 7),
        ("wall.normal", np.array([0.0, 1.0]), lambda scene: scene.wall.normal == (0.0, 1.0)),
        ("effects.gravity", True, lambda scene: scene.effects.gravity is True),
        ("operator", {"type": "mass", "mass_kg": 0.1}, lambda scene: scene.operator.mass_kg == 0.1),
        ("xdiff1.r1", 1e4, lambda scene: scene.device.values["xdiff1.r1"] == "10000.0"),
    ],
)
def test_values_of_every_kind(key, value, read):
    assert read(cosim.load_scene(SLOPE).with_values({key: value}))


def test_a_scene_without_layers_can_be_changed(tmp_path):
    """A copy with an update, and a stored scene: what they hold is the base, not the file."""
    scene = cosim.load_scene(PRESS)
    copied = scene.model_copy(update={"seed": 11})
    assert copied.with_values({"computer.period_s": 0.005}).seed == 11
    stored = cosim.scene.scene_from_dict(scene.as_dict())
    assert stored.with_values({"seed": 5}).as_dict() == {**scene.as_dict(), "seed": 5}


@pytest.mark.parametrize("value", [float("nan"), float("inf"), -0.01, "soon", None])
def test_a_bad_value_is_one_clear_error(value):
    with pytest.raises(cosim.InputError, match=r"computer\.period_s"):
        cosim.load_scene(PRESS).with_values({"computer.period_s": value})


def test_doubts_are_warnings_where_nobody_collects(monkeypatch):
    from cosim.api.python_warnings import doubts

    with pytest.warns(Doubt, match="looks odd: look again"), doubts():
        warn(Caution("odd", "looks odd", "look again"))
    with warnings.catch_warnings(), collected() as heard, doubts():
        warnings.simplefilter("error")
        warn(Caution("odd", "looks odd", "look again"))
    assert [caution.code for caution in heard] == ["odd"]


@pytest.fixture(scope="module")
def run() -> cosim.Run:
    return cosim.run(cosim.load_scene(PRESS).with_values({"duration_s": 0.05}))


def test_a_run_holds_numpy_arrays_in_si_units(run):
    time = run.signals["time"]
    assert isinstance(time, np.ndarray)
    assert time[0] == 0.0
    assert time[-1] == pytest.approx(0.05, rel=1e-12)
    assert all(np.shape(column) == time.shape for column in run.signals.values())


@pytest.mark.parametrize("library", ["pandas", "polars"])
def test_a_table_is_of_the_library_that_is_there(run, library, monkeypatch):
    import importlib.util

    class DataFrame(dict):
        pass

    kept = importlib.util.find_spec
    monkeypatch.setitem(sys.modules, library, types.SimpleNamespace(DataFrame=DataFrame))
    monkeypatch.setattr(
        "importlib.util.find_spec",
        lambda name, *more: name == library or None if name in ("pandas", "polars") else kept(name, *more),
    )
    for of in ("signals", "samples"):
        table, source = run.to_dataframe(of), getattr(run, of)
        assert list(table) == list(source)
        assert np.array_equal(table["time"], source["time"])


def test_a_table_without_a_library_says_what_to_install(run, monkeypatch):
    monkeypatch.setattr("importlib.util.find_spec", lambda *_: None)
    with pytest.raises(ImportError, match="pip install pandas"):
        run.to_dataframe()
    with pytest.raises(ValueError, match="'signals' or 'samples'"):
        run.to_dataframe("events")


def test_a_run_draws_itself(run):
    from matplotlib.figure import Figure

    assert isinstance(run.plot("currents"), Figure)
    assert isinstance(run.plot(), Figure)
    with pytest.raises(ValueError, match="there are path, tangent_normal"):
        run.plot("curents")


def test_a_notebook_shows_summary_measures_and_picture(run):
    html = run._repr_html_()
    assert run.scene.title in html
    assert all(f"<td>{name}</td>" in html for name in run.measures)
    assert html.count("<img") == 1
    row = next(iter(run.measures.values()))
    assert f"<td>{measured(row['value'], row['error'], row['unit'])}</td>" in html


def test_python_says_what_the_command_says(capsys):
    import json

    from cosim import cli

    assert cli.main(["stability", str(PRESS), "--json"]) == 0
    out = json.loads(capsys.readouterr().out)["cases"][0]
    result = cosim.stability(PRESS).as_dict()
    assert {key: out[key] for key in result} == json.loads(json.dumps(result))


def test_a_board_is_checked_with_other_values():
    result = cosim.check(netlists_folder() / "board1.cir", {"r_sum_spring": "24k"})
    assert result.subject.label == "r_sum_spring=24k"
