"""What `plan` predicts of points and time at any period, and for an operator in Python."""

from pathlib import Path

import pytest
from support import SCENES, shared_child, simulate

from cosim.plan import Plan, resolve
from cosim.scene import load_scene

IDEAL = ("opamp=ideal", "vca=ideal", "driver_level=ideal", "motor=emf", "differentiator=ideal")


def shipped(name: str, *changes: str) -> Plan:
    """Plan a shipped scene, its board's numbers known."""
    plan = resolve(load_scene(SCENES / f"{name}.toml", changes))
    plan.stated(shared_child())
    return plan


#: Over the range, and where the price of a sample begins to fall; some among the fast tests.
PERIODS = [
    pytest.param(name, period, id=f"{name}, {1e3 * period:g} ms",
                 marks=() if name in ("press", "slope") and period < 0.003 else pytest.mark.slow)
    for name in ("press", "drop", "slope", "slope_combined", "slope_discrete", "slope_joint_pd")
    for period in (0.001, 0.003, 0.01, 0.03, 0.1)
]  # fmt: skip


@pytest.mark.few(6)
@pytest.mark.parametrize(("name", "period_s"), PERIODS)
@pytest.mark.parametrize("model", ["ideal", "linear", "spice"])
def test_points_are_within_a_factor_of_two_from_1_to_100_ms(
    tmp_path: Path, name: str, period_s: float, model: str
) -> None:
    null = [f"effects.{setting}" for setting in IDEAL] if model == "ideal" else []
    plan = shipped(name, f"solver.model={model}", f"computer.period_s={period_s!r}", *null)
    ratio = plan.cost()["points"] / simulate(plan.scene, tmp_path / "run").stats["points"]
    print(f"{ratio:.2f}")
    assert 0.5 < ratio < 2.0


PUSH = """
class Push:
    def force(self, t, r, v):
        return -200.0 * r[0], -200.0 * (r[1] - 0.15) - 2.0 * v[1]
"""


@pytest.mark.slow
@pytest.mark.parametrize("model", ["linear", "spice"])
def test_an_operator_in_python_is_priced(tmp_path: Path, model: str) -> None:
    """Against the built-in hand in `spice`, by which the machine's speed is known."""
    (tmp_path / "push.py").write_text(PUSH)
    by_python = f"operator={{type='python',file='{tmp_path}/push.py:Push'}}"

    def ratio(*more: str) -> float:
        plan = shipped("press", *more)
        best = min(simulate(plan.scene).stats["cpu_s"] for _ in range(3))
        return plan.cost()["seconds"] / best

    machine = ratio("solver.model=spice")
    mine = ratio(f"solver.model={model}", "effects.operator_dynamics=false", by_python)
    assert 0.5 < mine / machine < 2.0
