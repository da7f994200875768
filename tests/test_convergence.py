"""Models at which ngspice stops: what is tried, what is told, and what is never blamed."""

from pathlib import Path

import pytest
from support import quick, slider

from cosim.caution import Caution, collected
from cosim.circuits.spice import Tolerances
from cosim.errors import InputError, NoOperatingPoint, Problem, SimulationError, StepTooSmall
from cosim.loop.convergence import Aid, aided
from cosim.ngspice.dcpath import has_dc_path
from cosim.ngspice.words import operating_point_problem

ASKED = Tolerances(1e-4, "trap", 1e-9)


def refused(aid: Aid) -> str:
    raise NoOperatingPoint(Problem("no DC operating point: here"))


@pytest.mark.parametrize(
    ("enough", "said"),
    [
        (lambda aid: True, ""),
        (lambda aid: aid.plain, "plain sources"),
        (lambda aid: aid.tolerances.rtol >= 1e-3, "solver.rtol = 0.001"),
        (lambda aid: aid.tolerances.method == "gear", 'solver.method = "gear"'),
        (lambda aid: bool(aid.lines), "gmin"),
    ],
)
@pytest.mark.parametrize("kind", [NoOperatingPoint, StepTooSmall])
def test_the_first_step_that_helps_is_told(enough, said, kind) -> None:
    def attempt(aid: Aid) -> Aid:
        if not enough(aid):
            raise kind(Problem("no DC operating point: here") if kind is NoOperatingPoint else "steps vanish")
        return aid

    with collected(forward=False) as cautions:
        aid = aided(ASKED, attempt)
    told = [caution for caution in cautions if caution.code == "convergence-aided"]
    assert len(told) == bool(said)
    assert all(isinstance(caution, Caution) and said in caution.text for caution in told)
    assert (aid.words == ()) == (not said)


def test_what_no_step_helps_is_told_with_all_that_was_tried() -> None:
    with pytest.raises(NoOperatingPoint, match=r"here; tried in vain: .*plain sources.*rtol.*gear.*gmin"):
        aided(ASKED, refused)


@pytest.mark.parametrize("error", [InputError("a slip"), SimulationError("a crash"), ValueError("ours")])
def test_other_errors_are_no_reason_to_try_again(error: Exception) -> None:
    count = 0

    def attempt(aid: Aid) -> None:
        nonlocal count
        count += 1
        raise error

    with pytest.raises(type(error)):
        aided(ASKED, attempt)
    assert count == 1


#: An indicator beside the amplifier jumps by 8 uV at each iteration of Newton's method, always away from
#: where it is: that is at rest at rtol 1e-3 (vntol 10 uV), and not at 1e-4 (1 uV) at voltages below 70 mV.
JUMPY = """\
.subckt jumpy 1 2 3 4 5
ga 0 x 1 2 1m
ra x 0 200meg
ca x 0 53p
eo y 0 x 0 1
ro y 5 100
rp 3 4 10k
bz z 0 v=v(5)+8u*(0.5-u(v(z)-v(5)))
rz z 0 1meg
.ends
"""


def test_a_model_that_stops_at_the_default_tolerance_runs_and_says_why(tmp_path: Path) -> None:
    (tmp_path / "jumpy.lib").write_text(JUMPY)
    part = {"file": str(tmp_path / "jumpy.lib"), "subckt": "jumpy", "pins": "1 2 3 4 5"}
    run = quick(tmp_path, slider(duration_s=0.05, device={"parts": {"opamp": part}}))
    told = [caution for caution in run.warnings if caution.code == "convergence-aided"]
    assert len(told) == 1
    assert "solver.rtol = 0.001" in told[0].text


# --- what is a floating node --------------------------------------------------------------------------

DECK = """\
title
Vin in 0 1
xb in out board
.subckt board a b
R1 a n1 1k
C1 n1 lone 1n
I1 0 pushed 1m
G1 0 held held 0 1m
G2 0 steered a 0 1m
B1 0 bent i=1m*v(bent)
Q1 n1 a emitter qn
xp a b part
.subckt part p q
J1 p q inner jn
D1 p anode dn
C9 hidden q 1p
.ends
.ends
""".splitlines()


@pytest.mark.parametrize(
    ("node", "tied"),
    [
        ("in", True), ("xb.n1", True), ("xb.lone", False), ("xb.pushed", False), ("xb.held", True),
        ("xb.steered", False), ("xb.bent", True), ("xb.emitter", True), ("out", True), ("xb.xp.inner", True),
        ("xb.xp.anode", True), ("xb.xp.hidden", False), ("unheard_of", True),
    ],
)  # fmt: skip
def test_paths_to_ground(node: str, tied: bool) -> None:
    assert has_dc_path(DECK, node) is tied


SAID = [
    "Warning: singular matrix:  check node xboard.xop.12",
    "Note: Transient op started",
    "Error: Transient op failed, timestep too small",
]


def test_a_floating_node_is_told_only_where_one_floats() -> None:
    floating = operating_point_problem(SAID, lambda node: False)
    assert "floating node: xboard.xop.12 has no DC path" in str(floating)
    assert not isinstance(floating, NoOperatingPoint)
    lost = operating_point_problem(SAID, lambda node: True)
    assert isinstance(lost, NoOperatingPoint)
    assert "floating" not in str(lost)
    assert "singular at xboard.xop.12" in str(lost)
