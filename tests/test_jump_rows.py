"""Rows of the lockstep: accepted points, and the limits from the right where DACs jump."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from linear_runs import CONSTANTS
from support import (
    COMMAND_TRUE,
    GEAR,
    KT,
    MOTOR_H,
    MOTOR_OHM,
    SPRING_TRUE,
    TORQUE,
    V_NM,
    merge,
    quick,
    slider,
)

from cosim.circuits.decks import Drive
from cosim.loop import signals as signals_module
from cosim.loop.columns import columns
from cosim.loop.jump_rows import right_limits
from cosim.loop.signals import Layout, held_signals
from cosim.types import Array
from mech import Slider

COMMANDS = """
from cosim.loop.userlaw import Command
class Commands:
    def control(self, sample):
        return Command(torque_n_m=[0.02 * (sample.tick % 2)])
"""
SPRING = """
from cosim.loop.userlaw import Command
class Spring:
    def control(self, sample):
        return Command(u_rad=0 * sample.q_rad, stiffness=[[0.5 * (sample.tick % 2)]])
"""


def jumps(folder: Path, law: str, **top: Any) -> tuple[dict[str, Array], Array]:
    """Run on ngspice; return the signals, and the rows at which a jump begins."""
    (folder / "law.py").write_text(law)
    tables = slider(duration_s=0.09, computer={"law": "law.py:" + law.split("class ")[1].split(":")[0]})
    got = quick(folder, merge(tables, top)).signals
    made = {name: np.array(got[name]) for name in got}
    return made, np.flatnonzero(np.diff(made["time"]) == 0.0)


def test_a_command_through_resistors_is_exact_at_both_sides(tmp_path: Path) -> None:
    made, at = jumps(tmp_path, COMMANDS)
    i = made["imot1"]
    np.testing.assert_allclose(made["time"][at], [0.025, 0.05, 0.075], rtol=0, atol=1e-15)
    # by the board's resistors; op-amps of gain 1e9 leave out below 1e-7
    high = 0.02 * V_NM * COMMAND_TRUE / TORQUE
    np.testing.assert_allclose(i[at], [0.0, high, 0.0], rtol=1e-7, atol=1e-7 * high)
    np.testing.assert_allclose(i[at + 1], [high, 0.0, high], rtol=1e-7, atol=1e-7 * high)
    # the DACs and what follows from them at once jump with it, the device does not
    np.testing.assert_allclose(made["cmd1"][at + 1], [0.02 * V_NM, 0.0, 0.02 * V_NM], rtol=1e-12)
    np.testing.assert_allclose(made["fmy"][at + 1], i[at + 1] * KT * GEAR / 0.1333, rtol=1e-9, atol=1e-12)
    for name in ("x", "y", "q1", "v1", "pot1", "e_kin"):
        assert (made[name][at] == made[name][at + 1]).all(), name


def test_a_spring_is_right_of_the_jump_to_second_order(tmp_path: Path) -> None:
    """From 0 to k q at the instant's own angle: steps four times shorter err by a sixteenth."""
    errors = []
    for step in (8e-3, 2e-3):
        made, at = jumps(
            tmp_path, SPRING, device={"start": {"q_rad": [0.12], "v_rad_per_s": [-1.0]}},
            solver={"max_step_s": step, "coupling_tolerance_rad": 1e-3, "rtol": 1e-10},
        )  # fmt: skip
        gain = made["ksp11"][at[0] + 1] / 10.0
        right = made["imot1"][at[0] + 1] * TORQUE
        errors.append(right / (-gain * SPRING_TRUE * made["q1"][at[0]]) - 1.0)
    # what both have in common is the board's: gains of 1e9 where SPRING_TRUE has none
    first, second = first_steps(made, at[0])
    line = 0.5 * first * (first + second) * 0.5 / (0.2 * 0.1333**2)  # h1 (h1 + h2)/2 q''/q
    assert 15.0 * line < abs(errors[0] - errors[1]) < 3.0 * 15.0 * line  # the angle is predicted to as much
    assert abs(errors[1]) < 1e-6


def test_a_current_through_an_inductor_does_not_jump(tmp_path: Path) -> None:
    made, at = jumps(tmp_path, COMMANDS, effects={"motor": "full"})
    i, t, k = made["imot1"], made["time"], at[0]
    assert (i[at + 1] == i[at]).all()
    # behind it backward Euler of L di/dt = u - R i
    share = (t[k + 2] - t[k]) * MOTOR_OHM / MOTOR_H
    high = 0.02 * V_NM * COMMAND_TRUE / TORQUE
    assert i[k + 2] - i[k] == pytest.approx(high * share / (1 + share), rel=1e-4)  # of reltol


def first_steps(made: dict[str, Array], row: int) -> Array:
    """Return the first two steps behind a jump [s]."""
    return np.diff(made["time"][row + 1 : row + 4])


def one_joint() -> Layout:
    """What rows of a carriage with a spring mean."""
    driven = Drive(joints=1, speeds=False, channels=("u1", "ksp11"))
    carriage = Slider(radius_m=0.1333, mass_kg=0.2, direction=(0.0, 1.0), origin_m=(0.0, 0.0))
    return Layout(tuple(columns(driven, ())), driven, CONSTANTS, carriage.pack()[0], one_sided=True)


def rows_of(y: Sequence[float], t: Sequence[float], rule: Sequence[float]) -> tuple[Array, list[str]]:
    names = ["time", "rule", "q1", "imot1", "cmd1"]
    return np.column_stack([t, rule, np.arange(len(t)), y, np.asarray(rule) == 0.0]), names


def test_a_line_is_continued_and_a_ringing_circuit_is_not() -> None:
    t = [0.0, 1.0, 1.1, 1.3, 1.7]
    rows, names = rows_of([0.0, 0.0, 2.1, 2.3, 2.7], t, [1, 1, 0, 1, 2])
    at, right = right_limits(rows, names, ["cmd1"])
    assert at.tolist() == [1]
    np.testing.assert_allclose(right[0], [1.0, 1.0, 1.0, 2.0, 1.0], rtol=1e-14)
    rows[4, 3] = 2.2  # it turns back
    assert right_limits(rows, names, ["cmd1"])[1][0, 3] == 2.1


def test_a_signal_that_is_continuous_keeps_its_value() -> None:
    """One that begins to rise at the instant, as a line, a parabola, or towards an end."""
    t = np.array([0.0, 1.0, 1.1, 1.3, 1.7])
    since = np.maximum(t - 1.0, 0.0)
    for rise in (since, since**2, 1.0 - np.exp(-3.0 * since)):
        rows, names = rows_of((5.0 + rise).tolist(), t.tolist(), [1, 1, 0, 1, 2])
        assert right_limits(rows, names, ["cmd1"])[1][0, 3] == 5.0


@pytest.mark.parametrize("rules", [[1, 1, 0], [1, 1, 0, 0, 1]])
def test_a_lonely_point_is_its_own_limit(rules: list[int]) -> None:
    count = len(rules)
    rows, names = rows_of([0.0, 0.0, 3.0, 7.0, 8.0][:count], [0.0, 1.0, 1.1, 1.2, 1.3][:count], rules)
    at, right = right_limits(rows, names, ["cmd1"])
    assert (at[0], right[0, 3]) == (1, 3.0)
    assert len(at) == rules.count(0)


@pytest.mark.parametrize("chunk", [1, 2, 3, 5, 8])
def test_rows_handled_some_at_a_time_are_the_same(monkeypatch: pytest.MonkeyPatch, chunk: int) -> None:
    """The limits and the works at the seams, in every place of a seam."""
    layout = one_joint()
    rng = np.random.default_rng(7)
    table = rng.normal(size=(23, len(layout.columns)))
    table[:, 0] = np.cumsum(rng.uniform(0.01, 0.02, 23))
    table[:, 1] = rng.choice([0.0, 1.0, 2.0], 23)
    table[:2, 1] = 0.0, 1.0  # a run begins with a point that no step leads to
    whole, ledger = held_signals(table, layout)
    monkeypatch.setattr(signals_module, "_CHUNK", chunk)
    parts, other = held_signals(table, layout)
    assert len(whole["time"]) == 23 + np.count_nonzero(table[1:, 1] == 0.0)
    for name, values in whole.items():
        np.testing.assert_array_equal(parts[name], values, err_msg=name)
    assert other["work_j"] == pytest.approx(ledger["work_j"], rel=1e-12)


def test_a_run_s_other_rows_are_its_accepted_points(tmp_path: Path) -> None:
    """Nothing is drawn between them: a step's polynomial is not asked for."""
    (tmp_path / "law.py").write_text(COMMANDS)
    run = quick(tmp_path, slider(duration_s=0.09, computer={"law": "law.py:Commands"}))
    assert len(run.signals["time"]) == run.stats["points"] + run.stats["discontinuities"]
