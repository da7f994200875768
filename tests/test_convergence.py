"""Models at which ngspice stops: what is tried, what is told, and what is never blamed."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support import SCENES, quick, simulate, slider

from cosim.caution import Caution, collected
from cosim.circuits.decks import Tolerances
from cosim.circuits.operating_point import LOOSE, STEPPING, AtRest
from cosim.errors import Crawl, InputError, NoOperatingPoint, Problem, SimulationError, StepTooSmall
from cosim.loop.spice.convergence import ITERATIONS, MICROAMPERE, Aid, aided
from cosim.loop.state import PATIENCE
from cosim.ngspice.dcpath import has_dc_path, in_voltage_loop
from cosim.ngspice.messages import operating_point_problem
from cosim.ngspice.simulator import Simulator
from cosim.plan import resolve
from cosim.results import Run
from cosim.scene import load_scene

ASKED = Tolerances(1e-4, "trap", 1e-9)


def refused(aid: Aid) -> str:
    raise NoOperatingPoint(Problem("no DC operating point: here"))


@pytest.mark.parametrize(
    ("enough", "note"),
    [
        (lambda aid: True, ""),
        (lambda aid: aid.plain, "plain sources"),
        (lambda aid: MICROAMPERE in aid.lines, "currents to 1 uA"),
        (lambda aid: aid.tolerances.rtol >= 1e-3, "solver.rtol = 0.001"),
        (lambda aid: aid.tolerances.method == "gear", 'solver.method = "gear"'),
        (lambda aid: STEPPING in aid.lines, "gmin"),
    ],
)
@pytest.mark.parametrize("kind", [NoOperatingPoint, StepTooSmall, Crawl])
def test_the_first_step_that_helps_is_reported(enough, note, kind) -> None:
    def attempt(aid: Aid) -> Aid:
        if not enough(aid):
            raise kind(Problem("no DC operating point: here") if kind is NoOperatingPoint else "steps vanish")
        return aid

    with collected(forward=False) as cautions:
        aid = aided(ASKED, attempt)
    rows = [caution for caution in cautions if caution.code == "convergence-aided"]
    assert len(rows) == bool(note)
    assert all(isinstance(caution, Caution) and note in caution.text for caution in rows)
    assert (aid.words == ()) == (not note)


def test_what_no_step_helps_is_reported_with_all_that_was_tried() -> None:
    with pytest.raises(
        NoOperatingPoint, match=r"here; tried in vain: .*plain sources.*1 uA.*rtol.*gear.*gmin"
    ):
        aided(ASKED, refused)


@pytest.mark.parametrize("crawls", [lambda aid: True, lambda aid: aid.plain], ids=["asked", "plain"])
def test_what_crawls_with_every_aid_is_let_crawl_with_the_fewest(crawls) -> None:
    tried: list[Aid] = []

    def attempt(aid: Aid) -> Aid:
        tried.append(aid)
        if not crawls(aid):
            raise NoOperatingPoint(Problem("no DC operating point: here"))
        if not aid.patient:
            raise Crawl("it crawls")
        return aid

    with collected(forward=False) as cautions:
        done = aided(ASKED, attempt)
    fewest = next(aid for aid in tried if crawls(aid))
    assert done == replace(fewest, patient=True)
    assert tried.index(done) == len(tried) - 1
    assert len(cautions) == bool(fewest.words)


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


#: An amplifier that has no difficulty; what stands beside it in its subcircuit has.
AMPLIFIER = """\
ga 0 x 1 2 1m
ra x 0 200meg
ca x 0 53p
eo y 0 x 0 1
ro y 5 100
rp 3 4 10k
"""


def with_model(tmp_path: Path, beside: str, **tables: Any) -> dict[str, Any]:
    """Return the tables of a slider of 0.05 s whose op-amps are `AMPLIFIER` with these elements beside it."""
    (tmp_path / "model.lib").write_text(f".subckt model 1 2 3 4 5\n{AMPLIFIER}{beside}.ends\n")
    part = {"file": str(tmp_path / "model.lib"), "subckt": "model", "pins": "1 2 3 4 5"}
    device = {"parts": {"opamp": part}, **tables.pop("device", {})}
    return slider(duration_s=0.05, device=device, **tables)


def aid_of(run: Run) -> Caution:
    """Return the one caution that says what helped."""
    (caution,) = (each for each in run.warnings if each.code == "convergence-aided")
    return caution


#: An indicator beside the amplifier jumps by 8 uV at each iteration of Newton's method, always away from
#: where it is: that is at rest at rtol 1e-3 (vntol 10 uV), and not at 1e-4 (1 uV) at voltages below 70 mV.
JUMPY = """\
bz z 0 v=v(5)+8u*(0.5-u(v(z)-v(5)))
rz z 0 1meg
"""


def test_a_model_that_stops_at_the_default_tolerance_runs_and_says_why(tmp_path: Path) -> None:
    assert "solver.rtol = 0.001" in aid_of(quick(tmp_path, with_model(tmp_path, JUMPY))).text


#: An ammeter inside that jumps by 20 nA at each iteration, as the rounding of a volt on a microohm does: that
#: is at rest where currents count from 1 uA on, and neither at rtol 1e-4 (100 pA) nor at 1e-3 (1 nA).
LOUD = """\
vi z 0 0
bi 0 z i=0.5*i(vi)+10n*(0.5-u(i(vi)))
"""


def test_a_model_whose_currents_are_noisy_runs_at_the_tolerance_that_the_scene_asks(tmp_path: Path) -> None:
    aid = aid_of(quick(tmp_path, with_model(tmp_path, LOUD)))
    assert "currents to 1 uA" in aid.text
    assert "rtol" not in aid.text + aid.advice


#: A square beside the amplifier, w = 2 in^2, whose equation atan(w - 2 in^2) = 0 Newton's method solves from
#: within 1.39 V only and from farther away diverges. No conductance to ground helps, for w is the voltage of
#: a source, and no stepping of all sources: without supplies v(z) has no value (`NO_POINT`).
NEAR_ONLY = """\
bw w 0 v=v(w)-atan(v(w)-2*v(1)*v(1))
rw w 0 1k
bz z 0 v=u(5-v(3)+v(4))*u(0.5-v(z))
rz z 0 1meg
"""


def test_an_operating_point_that_only_pins_stepped_from_zero_find(tmp_path: Path) -> None:
    # with a back-EMF: its viscosity is measured first, at external sources that no stepping reaches
    tables = with_model(tmp_path, NEAR_ONLY, device={"start": {"q_rad": [0.5]}}, effects={"motor": "emf"})
    aid = aid_of(quick(tmp_path, tables))
    assert "stepped from zero" in aid.text
    assert "rtol" not in aid.text + aid.advice


#: As the last one, but it jumps in a quarter of all trial instants, as rounding errors do between gains far
#: apart (a zero made of gains 1e6 and 1e-6, say): three steps in four double, one fails and is cut to an
#: eighth, so that the steps neither recover nor vanish.
CRAWLING = JUMPY.replace("8u*(0.5-u(v(z)-v(5)))", "8u*(0.5-u(v(z)-v(5)))*u(sin(1e14*time)-0.7)")


def test_a_model_that_crawls_at_the_default_tolerance_runs_from_the_start_and_says_why(
    tmp_path: Path,
) -> None:
    runs = [quick(tmp_path, with_model(tmp_path, CRAWLING)) for _ in range(2)]
    for run in runs:
        aid = aid_of(run)
        assert "crawls" in aid.text
        assert "solver.rtol = 0.001" in aid.text
        assert "0.12 %" in aid.advice
    first, second = (np.asarray(run.signals["time"]) for run in runs)
    assert first[0] == 0.0
    assert first[-1] == pytest.approx(0.05)
    assert (np.diff(first) > 0).all()
    assert first.tobytes() == second.tobytes()
    assert runs[0].samples["time"].tobytes() == runs[1].samples["time"].tobytes()


@pytest.mark.few(6)
@pytest.mark.parametrize("scene", sorted(SCENES.glob("*.toml")), ids=lambda file: file.stem)
@pytest.mark.parametrize(
    "more",
    [(), ("effects.component_noise=true", "duration_s=0.5"), ("solver.rtol=1e-6",)],
    ids=["", "noise", "fine"],
)
def test_a_shipped_scene_at_every_level_stays_far_from_a_crawl(scene: Path, more: tuple[str, ...]) -> None:
    full = [f"effects.{part}=full" for part in ("opamp", "vca", "driver_level")]
    plan = resolve(load_scene(scene, ("solver.model=spice", *full, *more)))
    run = simulate(plan.scene)
    # component noise adds sources, and so calls: what is counted is at least the iterations
    iterations = run.stats["source_calls"] / len(plan.circuit.sources())
    assert iterations < PATIENCE * ITERATIONS * plan.cost()["points"] / 3
    assert "convergence-aided" not in [caution.code for caution in run.warnings]


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


LINES = [
    "Warning: singular matrix:  check node xboard.xop.12",
    "Warning: singular matrix:  check nodes v.xboard.vpx#branch and xboard.x",
    "doAnalyses: iteration limit reached",
]


def test_a_floating_node_is_reported_only_where_one_floats() -> None:
    floating = operating_point_problem(LINES, lambda node: "12" not in node, lambda element: False)
    assert "floating node: xboard.xop.12 has no DC path" in str(floating)
    assert not isinstance(floating, NoOperatingPoint)
    lost = operating_point_problem(LINES, lambda node: True, lambda element: False)
    assert isinstance(lost, NoOperatingPoint)
    assert "floating" not in str(lost)
    assert "loop" not in str(lost)
    assert "singular at xboard.xop.12" in str(lost)
    looped = operating_point_problem(LINES, lambda node: True, lambda element: element == "v.xboard.vpx")
    assert "loop of voltage sources or inductors through v.xboard.vpx" in str(looped)


def test_warnings_of_an_analysis_that_converged_are_none() -> None:
    assert operating_point_problem(LINES[:2], lambda node: False, lambda element: True) is None


LOOPS = """\
title
V1 a 0 1
V2 a 0 2
V3 b 0 1
R3 b a 1k
xb a b board
.subckt board p q
L1 p n 1m
E1 n q p q 1
V4 q m 0
R4 m 0 1k
B1 m c v=v(p)
B2 c m i=v(p)
.ends
""".splitlines()


@pytest.mark.parametrize(
    ("element", "loop"),
    [
        ("v1", True), ("v2", True), ("v3", True), ("l.xb.l1", True), ("e.xb.e1", True),  # 0-a-n-b-0
        ("v.xb.v4", False), ("b.xb.b1", False), ("v.xb.unheard_of", True),
    ],
)  # fmt: skip
def test_loops_of_voltage_sources(element: str, loop: bool) -> None:
    assert in_voltage_loop(LOOPS, element) is loop


# --- a deck that is helped to its operating point -----------------------------------------------------


class Lost:
    """ngspice that finds an operating point only once it has heard what it waits for."""

    def __init__(self, wanted: str) -> None:
        self.wanted, self.heard = wanted, list[str]()

    def load(self, lines: Sequence[str]) -> None:
        self.heard.append(f"load {' '.join(lines)}".strip())

    def command(self, command: str) -> None:
        self.heard.append(command)
        if command == "op" and self.wanted not in self.heard:
            raise NoOperatingPoint(Problem("here"))


@pytest.mark.parametrize(
    ("wanted", "aid"),
    [
        ("op", ""),
        ("reset", ""),
        (f"load {LOOSE}", "to 10 uV"),
        (f"load {LOOSE} {STEPPING}", "gmin = 1e-10 S"),
    ],
)
def test_a_deck_is_read_again_and_stepped_with_all_that_was_altered(wanted: str, aid: str) -> None:
    ngspice = Lost(wanted)
    circuit = AtRest(ngspice, ngspice.load)  # type: ignore[arg-type]
    circuit.parameters({"r": 2.0})
    circuit.alter("v1 dc", 3.0)
    ngspice.heard.clear()
    circuit.analyse("op")
    assert aid in circuit.aid
    assert bool(circuit.aid) == bool(aid)
    if wanted != "op":
        assert ngspice.heard[-4:] == ["alterparam r = 2.0", "reset", "alter v1 dc = 3.0", "op"]


def test_a_deck_that_nothing_helps_is_left_as_it_was() -> None:
    ngspice = Lost("nothing")
    circuit = AtRest(ngspice, ngspice.load)  # type: ignore[arg-type]
    circuit.alter("v1 dc", 3.0)
    with pytest.raises(NoOperatingPoint, match="here"):
        circuit.analyse("op")
    assert circuit.aid == ""
    assert ngspice.heard[-3:] == ["load", "reset", "alter v1 dc = 3.0"]


#: v(z) is 1 where it is below one half, and 0 above: no voltage is right.
NO_POINT = "t\nV1 a 0 1\nR1 a 0 1k\nB1 z 0 v=u(0.5-v(z))\nR2 z 0 1k\n.end\n"


@pytest.mark.parametrize("command", ["op", "ac lin 1 1 1", "dc v1 0 1 0.5", "tran 1u 1m"])
def test_where_there_is_no_operating_point_ngspice_says_so_and_lives_on(command: str) -> None:
    simulator = Simulator()
    simulator.load(NO_POINT)
    with pytest.raises(NoOperatingPoint):
        simulator.command(command)
    # no transient from zero in its place, which may never end and leaves the library in ruins
    assert not any("ransient op" in line for line in simulator.notes)
    simulator.load("t\nV1 a 0 dc 0 ac 1\nR1 a b 1k\nC1 b 0 1u\n.end\n")
    simulator.command("ac lin 1 159.15494309189535 159.15494309189535")
    assert simulator.vector("b")[0] == pytest.approx(0.5 - 0.5j, rel=1e-9)
