"""What each block takes of eta: of formulas, by taking one block's dynamics away, and by every command."""

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support import SCENES, shared_child

from cosim.catalogue import find, needing_no_run
from cosim.circuits.extraction.block_delays import MOTOR, SpringDelay, Step
from cosim.cli import main
from cosim.comparisons.board_measures import board_measures, contact_measures
from cosim.errors import InputError
from cosim.plan import resolve
from cosim.scene import load_scene
from cosim.tolerance.batch import Batch

PRESS = str(SCENES / "press.toml")
BLOCKS = ("angle", "diffamp", "vca", "summer", "driver", "motor")
SHARES = tuple(f"eta_{block}" for block in BLOCKS)
#: From netlists/: gain-bandwidths of TL072 and OPA548, pole of the AD633, winding.
TL072_HZ, OPA548_HZ, AD633_HZ, MOTOR_S = 3e6, 1e6, 1e6, 1.5e-3 / 5.0


def of(*names: str, **values: Any) -> dict[str, float]:
    """Measures of the press board with op-amps of finite bandwidth."""
    changed = [f"device.values.{name}={value}" for name, value in values.items()]
    plan = resolve(load_scene(PRESS, ["solver.model=linear", *changed]))
    rows, lacking = board_measures(plan, names, child=shared_child())
    assert not lacking
    return {name: row["value"] for name, row in rows.items()}


def test_shares_are_those_of_the_formulas_and_add_up() -> None:
    """A stage of noise gain g is late by g/(2 pi GBW): shares are in the ratio of these delays, motor L/R."""
    shares = of("eta", *SHARES)
    total = shares.pop("eta")
    assert math.fsum(shares.values()) == pytest.approx(total, rel=1e-12)
    per_gain = 1.0 / (2.0 * np.pi * TL072_HZ)
    # 2 x 24.3 kOhm, 2 x 6.19 kOhm and 20 kOhm into the summing amplifier's 10 kOhm; see tests/test_delay.py
    summing = 1.0 + 2 * 10.0 / 24.3 + 2 * 10.0 / 6.19 + 10.0 / 20.0
    late = {
        "eta_angle": per_gain, "eta_diffamp": 17.9 * per_gain, "eta_vca": 1.0 / (2.0 * np.pi * AD633_HZ),
        "eta_summer": summing * per_gain, "eta_driver": 3.0 / (2.0 * np.pi * OPA548_HZ), "eta_motor": MOTOR_S,
    }  # fmt: skip
    for name, delay in late.items():
        assert shares[name] / shares["eta_motor"] == pytest.approx(delay / MOTOR_S, rel=5e-3), name
    together = of("eta_driver_and_motor", "eta_diffamp_and_angle")
    assert together["eta_driver_and_motor"] == pytest.approx(shares["eta_driver"] + shares["eta_motor"])
    assert together["eta_diffamp_and_angle"] == pytest.approx(shares["eta_angle"] + shares["eta_diffamp"])


@pytest.mark.parametrize(
    ("block", "faster"),
    [
        ("diffamp", {"xdiff1.xop.gbw": 3e12, "xdiff2.xop.gbw": 3e12}),
        ("motor", {"motor_l": 1.5e-9}),
    ],
)
def test_a_share_is_what_eta_loses_with_that_block_s_dynamics(block: str, faster: dict[str, float]) -> None:
    """The block a million times as fast takes a millionth; what eta lost, it had taken."""
    name = f"eta_{block}"
    before, after = (of("eta", name, **changed) for changed in ({}, faster))
    assert before["eta"] - after["eta"] == pytest.approx(before[name] - after[name], rel=1e-4)
    assert after[name] == pytest.approx(1e-6 * before[name], rel=1e-2)


def test_groups_of_a_path() -> None:
    """What is one step cannot be parted; several steps can be put together, in any order."""
    path = SpringDelay(1, 1, (Step("diff amp", "x1", 2.0), Step("sum", "x2", 3.0), Step("sum", "x3", 4.0),
                              Step(f"drive and {MOTOR}", "x4 and motor", 5.0)), 1.0)  # fmt: skip
    known = {"diff_amp": 2.0, "sum": 7.0, "drive_and_motor": 5.0, "motor_and_drive": 5.0,
             "sum_and_diff_amp": 9.0, "motor_and_sum_and_drive": 12.0}  # fmt: skip
    assert {group: path.of_group(group) for group in known} == known
    assert path.groups == ("diff_amp", "sum", "drive_and_motor")
    for unknown in ("drive", "motor", "sum_and_motor", "vca", ""):
        assert path.of_group(unknown) is None, unknown


def test_names() -> None:
    assert needing_no_run(("eta_vca", "peak_force", "eta")) == ("eta_vca", "eta")
    assert all(find(name) is None for name in ("eta_", "eta_a-b", "eta_a b", "etas", "_eta_vca", ""))


def test_a_current_drive_is_known_with_its_motor_and_no_viscosity_has_no_share() -> None:
    plan = resolve(load_scene(PRESS, ["effects.driver=current", "solver.model=linear"]))
    rows, lacking = contact_measures(plan, shared_child())
    shares = [row["value"] for name, row in rows.items() if name.startswith("eta_")]
    assert math.fsum(shares) == pytest.approx(rows["eta"]["value"], rel=1e-12)
    rows, lacking = board_measures(plan, ("eta_motor", "eta_driver_and_motor"), child=shared_child())
    assert list(rows) == ["eta_driver_and_motor"]
    assert (
        "known by eta_angle, eta_diffamp, eta_vca, eta_summer, eta_driver_and_motor" in lacking["eta_motor"]
    )


def test_devices_of_a_batch_have_them_as_alone() -> None:
    """A drawn component makes a copy of its block, which keeps its name."""
    plan = resolve(load_scene(PRESS, ["solver.model=linear"]))
    key = "xdiff1.r11"
    with Batch(plan, (key,), ("eta", *SHARES)) as batch:
        row = batch.measures(np.array([[12e3]]))[0]
    assert not batch.failures
    assert row[0] == pytest.approx(math.fsum(row[1:]), rel=1e-12)
    alone = of("eta", *SHARES, **{f'"{key}"': "12k"})
    np.testing.assert_allclose(row, [alone[name] for name in ("eta", *SHARES)], rtol=1e-6)


def test_commands(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    def asked(*words: str) -> Any:
        assert main([*words, "--json"]) == 0
        return json.loads(capsys.readouterr().out)

    swept = asked("sweep", PRESS, "motor_l=1.5m,3m", "--measure", "eta_motor", "-o", str(tmp_path / "sweep"))
    low, high = swept["measures"]["eta_motor"]
    assert high == pytest.approx(2.0 * low, rel=1e-4)
    sides = asked("compare", PRESS, "--set", "motor_l=3m", "--measure", "eta_motor")["measures"]
    assert [side["eta_motor"]["value"] for side in sides] == [low, high]
    listed = asked("nodes", PRESS)["measures"]
    assert set(SHARES) < set(listed)


@pytest.mark.parametrize(
    "words",
    [
        ("run", PRESS), ("sweep", PRESS, "motor_l=1m,2m"), ("mc", PRESS, "-n", "2"),
        ("compare", PRESS, "--set", "motor_l=3m"),
    ],
)  # fmt: skip
def test_a_block_that_no_board_has_is_refused(
    words: tuple[str, ...], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main([*words, "--measure", "eta_difamp", "-o", str(tmp_path / "out")]) == 2
    told = capsys.readouterr().err
    assert "no block difamp; nearest is diffamp" in told
    assert not (tmp_path / "out").exists()


def test_a_scene_s_own_list_is_checked(tmp_path: Path) -> None:
    from cosim.comparisons.measure_values import run_with_measures

    plan = resolve(load_scene(PRESS, ['measures.names=["eta_difamp"]']))
    with pytest.raises(InputError, match="no block difamp"):
        run_with_measures(plan, tmp_path / "run", child=shared_child())
