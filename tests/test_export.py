"""Exported decks run in the ngspice program, and agree with the lockstep."""

import json
import re
import shutil
import subprocess
from dataclasses import replace
from shutil import copytree

import numpy as np
import pytest
from plain_ngspice import ngspice
from scipy.interpolate import PchipInterpolator
from support import SCENES, merge, shared_child, simulate, slider, toml

from cosim.circuits.boardgen import write_board
from cosim.circuits.decks import Tolerances
from cosim.cli import main
from cosim.errors import InputError
from cosim.export import export
from cosim.export.waveform import RISE_S, channel, source, straightened
from cosim.plan import resolve
from cosim.runner import run as run_plan
from cosim.scene import load_scene

#: Both sides converge to each other within these (issue: 1 micrometre, 1e-4 of the peak force).
POSITION_M, FORCE_SHARE = 1e-6, 1e-4


def tight(file, overrides, rtol, step):
    """Plan of a scene with every tolerance that matters tightened, the small charges of op-amps included."""
    fine = (f"solver.rtol={rtol}", f"solver.max_step_s={step}", "solver.coupling_tolerance_rad=1e-10")
    plan = resolve(load_scene(file, (*overrides, *fine)))
    return replace(plan, tolerances=Tolerances(rtol=rtol, method="gear", charge_c=1e-14))


def both_sides(folder, file, *overrides, rtol=1e-6, step=2e-4):
    """Lockstep and monolithic deck of a scene, both tight: signals of the one, raw file of the other."""
    run = run_plan(tight(file, overrides, rtol, step), folder / "run", formats=(), child=shared_child())
    deck = export(tight(file, overrides, 1e-7, 5e-5), run, folder / "monolithic.cir")
    return run.signals, ngspice(deck)


def largest_difference(ours, theirs, name):
    """Over all points of the lockstep; cubic between the points of the other side, for they lie denser."""
    t, at = np.unique(np.asarray(theirs["time"]), return_index=True)
    other = PchipInterpolator(t, np.asarray(theirs[f"v({name})"])[at])
    return float(np.abs(other(np.asarray(ours["time"])) - ours[name]).max())


def check_agreement(ours, theirs):
    peak = float(np.hypot(ours["fx"], ours["fy"]).max())
    assert np.ptp(ours["x"]) + np.ptp(ours["y"]) > 1e-3, "nothing moved"
    for axis in "xy":
        assert largest_difference(ours, theirs, axis) < POSITION_M
        if peak > 0.0:
            assert largest_difference(ours, theirs, f"f{axis}") < FORCE_SHARE * peak


def test_slope_agrees_with_the_monolithic_deck(tmp_path):
    check_agreement(*both_sides(tmp_path, SCENES / "slope.toml"))


@pytest.mark.slow
@pytest.mark.parametrize("name", ["drop", "press", "slope_joint_pd", "slope_discrete"])
def test_scenes_agree_with_their_monolithic_decks(tmp_path, name):
    check_agreement(*both_sides(tmp_path, SCENES / f"{name}.toml"))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "overrides"),
    [
        ("slope", ["effects.gravity=true", "effects.viscous=false", "effects.coriolis=false"]),
        ("slope", ["effects.dac_settling=false"]),
        (
            "slope",
            [
                'effects.driver="current"',
                "effects.delay=true",
                "computer.delay_fraction=0.3",
                "computer.analog_damping_n_s_per_m=2.0",
                "computer.dac.skew_s=1e-4",
                "effects.dac_skew=true",
            ],
        ),
    ],
    ids=["gravity", "jumps", "delay-damper-skew"],
)
def test_effects_agree_with_their_monolithic_decks(tmp_path, name, overrides):
    check_agreement(*both_sides(tmp_path, SCENES / f"{name}.toml", *overrides, rtol=1e-7, step=1e-4))


@pytest.mark.slow
@pytest.mark.parametrize(("name", "of"), [("drop", "slider"), ("slope", "chain")])
def test_smoothed_friction_comes_to_friction_that_holds(tmp_path, name, of):
    """A deck's friction creeps with the speed of its tanh, the run's holds: they meet as that speed falls.

    Forces jump where a joint stops, over a speed in the deck: positions are compared.
    """
    apart = []
    for speed in (1e-3, 1e-4):
        changes = ("effects.coulomb=true", f"device.{of}.coulomb_speed_rad_per_s={speed}")
        ours, theirs = both_sides(
            tmp_path / str(speed), SCENES / f"{name}.toml", *changes, rtol=1e-7, step=1e-4
        )
        apart.append(max(largest_difference(ours, theirs, axis) for axis in "xy"))
        # creep over the whole run at the end of a lever of 0.3 m
        assert apart[-1] < 0.3 * speed * ours["time"][-1]
    assert apart[1] < 0.2 * apart[0]


def arm(board, n):
    """A hanging chain of n links that swings freely, started out of balance, with a mass in its hand."""
    return merge(
        slider(),
        {
            "duration_s": 0.3,
            "device": {
                "board": str(board),
                "linkage": "chain",
                "slider": None,
                "chain": {
                    "lengths_m": [0.1] * n,
                    "masses_kg": [0.1] * n,
                    "coms_m": [0.05] * n,
                    "inertias_kg_m2": [8e-5] * n,
                    "rotor_inertia_kg_m2": [2e-6] * n,
                },
                "start": {"q_rad": [0.3 + 0.1 * j for j in range(n)], "v_rad_per_s": [1.0] * n},
            },
            "operator": {"type": "mass", "mass_kg": 0.05},
            "effects": {"motor": "full", "gravity": True, "coriolis": True, "rotor_inertia": True},
            "wall": None,
        },
    )


@pytest.mark.parametrize("n", [1, 3])
def test_any_number_of_links(tmp_path, n):
    netlists = copytree(SCENES.parent / "netlists", tmp_path / "netlists")
    board = netlists / f"board{n}.cir"
    write_board(n, board)
    file = tmp_path / "arm.toml"
    file.write_text(toml(arm(board, n)))
    check_agreement(*both_sides(tmp_path, file))


@pytest.mark.parametrize("noise", ["none", pytest.param("white", marks=pytest.mark.slow)])
def test_replay_gives_the_recorded_currents(tmp_path, noise):
    run = simulate(load_scene(SCENES / "slope.toml", (f'effects.pot_noise="{noise}"',)), tmp_path / "run")
    again = ngspice(export(resolve(run.scene), run, tmp_path / "replay.cir", "replay"))
    peak = max(np.abs(run.signals["imot1"]).max(), np.abs(run.signals["imot2"]).max())
    for name in ("imot1", "imot2"):
        # angles are straight lines between the recorded points, at most 2 ms apart
        assert largest_difference(run.signals, again, name) < 1e-2 * peak


def test_decks_print_measures(tmp_path):
    run = simulate(load_scene(SCENES / "press.toml", ("duration_s=0.3",)), tmp_path / "run")
    result = ngspice(export(resolve(run.scene), run, tmp_path / "m.cir"), raw=False)
    by_name = dict(re.findall(r"^(\w+)\s*=\s*(\S+)", result, re.MULTILINE))
    assert float(by_name["y_end"]) == pytest.approx(run.signals["y"][-1], abs=1e-5)
    # angles and speeds of the joints, not of the links
    for j in (1, 2):
        assert float(by_name[f"pot{j}_end"]) == pytest.approx(run.signals[f"q{j}"][-1], abs=1e-4)
        assert float(by_name[f"v{j}_end"]) == pytest.approx(run.signals[f"v{j}"][-1], abs=1e-3)
    assert "w2_end" not in by_name
    assert float(by_name["imot1_rms"]) < float(by_name["imot1_max"]) - float(by_name["imot1_min"])


VENDOR = """\
.subckt limited 1 2 3 4 5
Rin 1 2 10meg
Gm 0 6 value={limit(v(1,2)*1m, -300u, 300u)}
Ro 6 0 316meg
Cc 6 0 31.83p
Eout 5 0 6 0 1
Rp 3 4 100k
.ends limited
"""


def test_the_command_that_export_prints_runs_as_it_is(tmp_path, capsys, monkeypatch):
    """In a shell, with a name that needs quotes and a model that needs ngspice's PSpice mode."""
    if shutil.which("ngspice") is None:
        pytest.skip("the ngspice program is not installed")
    monkeypatch.chdir(tmp_path)
    (tmp_path / "limited.lib").write_text(VENDOR)
    how = f"file='{tmp_path}/limited.lib',subckt='limited',pins='1 2 3 4 5',dialect='pspice'"
    part = f"device.parts.tl072={{{how}}}"
    folder = tmp_path / "a board's $HOME"
    folder.mkdir()
    scene, deck = str(SCENES / "drop.toml"), str(folder / "deck; one.cir")
    assert main(["export", scene, "--set", "duration_s=0.02", "--set", part, "-o", deck, "--json"]) == 0
    line = json.loads(capsys.readouterr().out)["command"]
    assert "-D ngbehavior=psa" in line
    done = subprocess.run(["sh", "-c", line], capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == 0, done.stderr
    assert re.search(r"^imot1_max\s*=\s*\S+", done.stdout, re.MULTILINE), done.stdout


def test_effects_that_are_off_leave_no_term(tmp_path):
    def elements(*overrides):
        scene = load_scene(SCENES / "slope.toml", ("duration_s=0.05", *overrides))
        run = simulate(scene, tmp_path / "run")
        text = export(resolve(scene), run, tmp_path / "deck.cir").read_text()
        return text[text.index("* link 1") :]

    off = ("effects.coriolis=false", "effects.viscous=false")
    bare = elements(*off)
    assert "tanh" not in bare
    assert "v(w1)*v(w1)" not in bare
    more = {
        "viscous": elements(off[0]),
        "coriolis": elements(off[1]),
        "coulomb": elements(*off, "effects.coulomb=true"),
        "gravity": elements(*off, "effects.gravity=true"),
    }
    lines = {name: len(text.splitlines()) - len(bare.splitlines()) for name, text in more.items()}
    # one element a joint; gravity [0, -9.81] acts on each link's cosine; Coriolis only lengthens expressions
    assert lines == {"viscous": 2, "coriolis": 0, "coulomb": 2, "gravity": 2}
    assert "v(w1)*v(w1)" in more["coriolis"]


def test_same_run_same_deck(tmp_path):
    scene = load_scene(SCENES / "slope.toml", ("duration_s=0.1",))
    run = simulate(scene, tmp_path / "run")
    one, two = (export(resolve(scene), run, tmp_path / f"{k}.cir").read_bytes() for k in range(2))
    assert one == two


@pytest.mark.parametrize(
    ("overrides", "key"),
    [
        (["device.chain.stops_rad=[[-1.0,2.0],[-1.0,2.0]]", "effects.end_stops=true"], "effects.end_stops"),
        (['effects.pot_noise="static"'], "effects.pot_noise"),
    ],
)
def test_what_a_monolithic_deck_cannot_carry(tmp_path, overrides, key):
    scene = load_scene(SCENES / "slope.toml", ("duration_s=0.05", *overrides))
    run = simulate(scene, tmp_path / "run")
    with pytest.raises(InputError, match="monolithic") as caught:
        export(resolve(scene), run, tmp_path / "deck.cir")
    assert [problem.key for problem in caught.value.problems] == [key]
    assert not (tmp_path / "deck.cir").exists()
    assert export(resolve(scene), run, tmp_path / "replay.cir", "replay").exists()


def test_a_run_of_something_else_is_refused(tmp_path):
    run = simulate(load_scene(SCENES / "slope_discrete.toml", ("duration_s=0.05",)), tmp_path / "run")
    with pytest.raises(InputError, match="ksp11"):
        export(resolve(load_scene(SCENES / "slope.toml", ("duration_s=0.05",))), run, tmp_path / "deck.cir")
    with pytest.raises(InputError, match="shorter"):
        export(resolve(load_scene(SCENES / "slope_discrete.toml")), run, tmp_path / "deck.cir")
    with pytest.raises(InputError, match="kind"):
        export(resolve(run.scene), run, tmp_path / "deck.cir", "both")
    with pytest.raises(InputError, match=re.escape(str(tmp_path / "none"))):
        export(resolve(run.scene), run, tmp_path / "none" / "deck.cir")


@pytest.mark.parametrize("behind", [2.02e-3, 2e-3])  # the next point, or that of the limit from the right
def test_a_channel_that_jumps_rises_right_behind_the_sample(behind: float):
    time = np.array([0.0, 1e-3, 2e-3, behind, 3e-3])
    t, v = channel(time, np.array([1.0, 1.0, 1.0, 4.0, 4.0]), 0.0)
    assert t.tolist() == [0.0, 2e-3, 2e-3 + RISE_S]
    assert v.tolist() == [1.0, 1.0, 4.0]


def test_a_channel_that_settles_keeps_its_ramp():
    time = np.array([0.0, 1e-3, 1.004e-3, 1.01e-3, 2e-3, 3e-3])
    t, v = channel(time, np.array([0.0, 0.0, 0.4, 1.0, 1.0, 1.0]), 1e-5)
    assert t.tolist() == [0.0, 1e-3, 1.01e-3]
    assert v.tolist() == [0.0, 0.0, 1.0]


def test_a_constant_channel_is_a_number():
    assert source("u1", *channel(np.array([0.0, 1.0]), np.array([2.5, 2.5]), 0.0)) == "Vu1 u1 0 dc 2.5"


def test_straight_lines_lose_their_inner_points():
    t, v = straightened(np.array([0.0, 1.0, 2.0, 3.0]), np.array([0.0, 1.0, 2.0, 2.0]))
    assert t.tolist() == [0.0, 2.0, 3.0]
    assert v.tolist() == [0.0, 2.0, 2.0]
