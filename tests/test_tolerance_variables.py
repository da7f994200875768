"""Which component draws what: each placed one its own, lots and networks together, defaults of the scene."""

import json
import subprocess
from pathlib import Path

import numpy as np
import pytest
from support import ROOT
from toleranced_boards import DIFFAMP, PRESS, SUMMER, board, read, values

from cosim import cli
from cosim.caution import collected
from cosim.errors import InputError
from cosim.ngspice.deck import PartSwap, load_deck
from cosim.plan import resolve
from cosim.scene import load_scene
from cosim.tolerance.random_variables import Tolerances
from cosim.tolerance.scene_variables import tolerances


def deviation(drawn_tolerances: Tolerances, key: str) -> np.ndarray:
    place = drawn_tolerances.keys.index(key)
    return values(drawn_tolerances)[key] / drawn_tolerances.components[place].nominal - 1.0


def spring(drawn_tolerances: Tolerances) -> list[np.ndarray]:
    return [deviation(drawn_tolerances, f"rsp{pair}") for pair in ("11", "12", "21", "22")]


SPRING = ".param r_sum_spring=24.3k $ tol=1%"


def test_four_parts_from_a_bag_are_four_draws(tmp_path: Path) -> None:
    result = read(tmp_path)
    drawn = np.array(spring(result))
    assert np.abs(drawn).max() <= 0.01
    assert np.abs(np.corrcoef(drawn) - np.eye(4)).max() < 5 / np.sqrt(4000)
    assert "lot" not in " ".join(result.variables)
    of = result.components[result.keys.index("rsp12")]
    assert (Path(of.file).name, of.line, of.nominal, of.unit) == ("summer.cir", 3, 24300.0, "Ohm")
    # the tolerance is that of the element although its subcircuit hands the value on
    assert result.components[result.keys.index("xdiff1.r11")].nominal == 10e3


@pytest.mark.parametrize("named", ["r_ilim", "opa548_ilim"])
def test_what_follows_from_a_part_s_resistor_is_no_draw_of_its_own(named: str) -> None:
    """The driver's limit of current follows from r_ilim, which has a tolerance; the scene may give it one."""
    own = f'tolerance.components."xdrv1.xop:{named}"="5%"'
    scene = load_scene(PRESS, ["effects.driver_limit=true", own])
    keys = tolerances(scene, board=resolve(scene).board).keys
    assert [key for key in keys if "ilim" in key] == [f"xdrv1.xop:{named}", "xdrv2.xop:r_ilim"]


def test_lot_is_shared_and_dev_is_not(tmp_path: Path) -> None:
    """Deviations are lot + dev: their covariance is the lot's variance."""
    result = read(tmp_path, (SUMMER, "24.3k $ tol=1%", "24.3k $ lot=5% dev=1%"))
    drawn = np.array(spring(result))
    lot, dev = (0.98659 * tol / 3 for tol in (0.05, 0.01))
    together = np.cov(drawn)
    assert together[0, 1] == pytest.approx(lot**2, rel=0.1)
    assert together[0, 0] - together[0, 1] == pytest.approx(dev**2, rel=0.1)
    assert result.components[result.keys.index("rsp11")].lots == ("lot:r_sum_spring",)


def test_match_is_shared_within_an_instance_or_on_the_board(tmp_path: Path) -> None:
    net = (DIFFAMP, "r_diff_in=10.0k $ tol=1%", "r_diff_in=10.0k $ tol=1% match=net1 dev=0.1%")
    result = read(tmp_path / "a", net)
    a, b, other = (deviation(result, key) for key in ("xdiff1.r11", "xdiff1.r13", "xdiff2.r11"))
    assert np.abs(a - b).max() <= 0.002 * (1 + 1e-9)
    assert np.abs(np.corrcoef(a, other)[0, 1]) < 5 / np.sqrt(4000)
    value = (net[0], net[1], net[2].replace("net1", "board:net1"))
    result = read(tmp_path / "b", value)
    assert np.abs(deviation(result, "xdiff1.r11") - deviation(result, "xdiff2.r13")).max() <= 0.002 * (
        1 + 1e-9
    )
    exact = (net[0], net[1], "r_diff_in=10.0k $ tol=1% match=net1")
    result = read(tmp_path / "c", exact)
    assert np.array_equal(deviation(result, "xdiff1.r11"), deviation(result, "xdiff1.r13"))


def test_a_network_that_shares_nothing_is_refused(tmp_path: Path) -> None:
    """Without a size to share, matched parts would be drawn as independent ones."""
    net = (DIFFAMP, "r_diff_in=10.0k $ tol=1%", "r_diff_in=10.0k $ match=net1 dev=0.1%")
    with pytest.raises(InputError) as caught:
        read(tmp_path / "a", net)
    (problems,) = caught.value.problems
    assert (Path(problems.file or "").name, problems.line) == ("diffamp.cir", 2)
    assert "tol=1% match=net1 dev=0.1%" in str(problems)
    scene = tmp_path / "press.toml"
    text = PRESS.read_text().replace("../netlists", (ROOT / "netlists").as_posix())
    line = text.count("\n") + 2
    names = ("xdiff1.r11", "xdiff1.r13")

    def board_with(tolerance: str) -> Path:
        rows = "".join(f'"{name}" = "{tolerance}"\n' for name in names)
        scene.write_text(f"{text}[tolerance.components]\n{rows}")
        return scene

    with pytest.raises(InputError) as caught:
        tolerances(load_scene(board_with("match=net1 dev=0.1%")))
    assert [(p.file, p.line) for p in caught.value.problems] == [(str(scene), line), (str(scene), line + 1)]
    result = tolerances(load_scene(board_with("tol=1% match=net1 dev=0.1%")))
    a, b = (deviation(result, name) for name in names)
    assert 0.0 < np.abs(a - b).max() <= 0.002 * (1 + 1e-9)
    assert np.abs(a).max() > 0.005


def test_parts_vary_one_by_one(tmp_path: Path) -> None:
    result = read(tmp_path)
    keys = [key for key in result.keys if key.endswith(":motor_r")]
    assert keys == ["xdrv1.xmotor:motor_r", "xdrv2.xmotor:motor_r"]
    assert not np.array_equal(*(values(result)[key] for key in keys))


def test_functions_draw_as_the_netlist_says(tmp_path: Path) -> None:
    """A function in a .param is drawn by each part that uses it; one in a value by that element."""
    result = read(
        tmp_path,
        (SUMMER, "r_sum_fb=10.0k $ tol=1%", "r_sum_fb=agauss(10k,100,3) $"),
        ("board2.cir", "Rcmd1 cmd1 sum1 {r_sum_cmd}", "Rcmd1 cmd1 sum1 {2*unif(10k,0.05)}"),
    )
    a, b = (values(result)[f"xsum{j}.r31"] for j in (1, 2))
    assert np.std(a) == pytest.approx(100 / 3, rel=0.05)
    assert abs(np.corrcoef(a, b)[0, 1]) < 5 / np.sqrt(4000)
    drawn = values(result)["rcmd1"]
    assert (19e3 <= drawn.min() < 19.05e3, 20.95e3 < drawn.max() <= 21e3) == (True, True)


def test_an_edited_value_keeps_its_grade(tmp_path: Path) -> None:
    result = read(tmp_path, overrides=("device.values.xdiff1.r12=165k", "device.values.r_sum_fb=9.09k"))
    for key, nominal in (("xdiff1.r12", 165e3), ("xsum1.r31", 9090.0), ("xdiff2.r12", 169e3)):
        of = result.components[result.keys.index(key)]
        assert (of.nominal, of.distribution) == (nominal, "Gaussian +-1% = 3 sigma, cut")


def test_the_scene_gives_defaults_and_exceptions() -> None:
    scene = load_scene(
        PRESS,
        ['tolerance.mass="lot=2% dev=1%"', "tolerance.k_t=10%", "tolerance.gbw=30%", "tolerance.resistors=5%",
         "tolerance.components.rsp12=0.1%", "tolerance.components.device.chain.lengths_m=0.2%",
         "tolerance.offset=100%"],
    )  # fmt: skip
    result = tolerances(scene)
    by_name = {each.key: each for each in result.components}
    assert by_name["rsp12"].distribution == "Gaussian +-0.1% = 3 sigma, cut"
    assert by_name["rsp11"].distribution == "Gaussian +-1% = 3 sigma, cut"  # the netlist knows better
    assert by_name["scene:device.chain.lengths_m[1]"].nominal == 0.1
    assert by_name["xdrv2.xmotor:motor_k"].nominal == 0.04
    assert by_name["xangle1.xop:tl072_gbw"].unit == "Hz"
    assert by_name["scene:device.chain.masses_kg[0]"].lots == by_name["scene:device.chain.masses_kg[1]"].lots
    assert result.idle == ("offset",)  # no offset is in force


def test_what_the_scene_gives_is_drawn_by_every_joint_link_and_mass() -> None:
    """Each entry of a list is a part of its own: no two of them move together."""
    scene = load_scene(
        PRESS,
        ["effects.viscous=true", "effects.coulomb=true", "device.chain.coulomb_n_m=[0.01, 0.01]",
         *(f"tolerance.{name}=10%" for name in ("k_t", "link_length", "mass", "friction"))],
    )  # fmt: skip
    result = tolerances(scene)
    pairs = [
        *(
            f"scene:device.chain.{name}"
            for name in ("lengths_m", "masses_kg", "viscous_n_m_s", "coulomb_n_m")
        ),
    ]
    keys = [*(f"{pair}[{joint}]" for pair in pairs for joint in (0, 1)),
            "xdrv1.xmotor:motor_k", "xdrv2.xmotor:motor_k"]  # fmt: skip
    drawn = np.array([deviation(result, key) for key in keys])
    assert np.abs(np.corrcoef(drawn) - np.eye(len(keys))).max() < 5 / np.sqrt(4000)
    assert drawn.std(axis=1) == pytest.approx(0.98659 * 0.1 / 3, rel=0.05)


def test_scale_errors_offsets_and_linearity_in_units_of_their_numbers() -> None:
    """A multiplier's number counts in per cent of its gain; it and an offset deviate about zero."""
    scene = load_scene(
        PRESS,
        ["effects.vca_gain_error=true", "effects.opamp_offset=true", "effects.pot_linearity=true",
         "device.potentiometer.linearity_rad=0.01", "tolerance.vca_gain=2%", "tolerance.offset=100%",
         "tolerance.pot_linearity=10%"],
    )  # fmt: skip
    result = tolerances(scene)
    assert result.idle == ()
    drawn, of_one = values(result), 0.98659 / 3
    for key, middle, size in (
        ("xksp12.xmul:ad633_scale", 0.0, 2.0),  # %
        ("xdiff1.xop:tl072_vos", 0.0, 3e-3),  # V
        ("scene:device.potentiometer.linearity_rad", 0.01, 1e-3),
    ):
        sigma = of_one * size
        assert drawn[key].mean() == pytest.approx(middle, abs=5 * sigma / np.sqrt(4000)), key
        assert drawn[key].std() == pytest.approx(sigma, rel=0.05), key
    assert not np.array_equal(drawn["xksp12.xmul:ad633_scale"], drawn["xksp11.xmul:ad633_scale"])


def test_capacitors_without_a_tolerance_take_that_of_their_class(tmp_path: Path) -> None:
    bare = ("blocks/differentiator.cir", "c_der_in=1u $ tol=5% ;", "c_der_in=1u $")
    result = read(tmp_path, bare, overrides=("tolerance.capacitors=20%",))
    a, b, known = (deviation(result, key) for key in ("xder1.c21", "xder2.c21", "xder1.c22"))
    assert a.std() == pytest.approx(0.98659 * 0.2 / 3, rel=0.05)
    assert known.std() == pytest.approx(0.98659 * 0.05 / 3, rel=0.05)
    assert abs(np.corrcoef(a, b)[0, 1]) < 5 / np.sqrt(4000)


def test_a_network_without_a_size_takes_that_of_its_class(tmp_path: Path) -> None:
    """`match=net1 dev=0.1%` and `resistors = "2%"`: 2 % in common, 0.1 % each."""
    net = (DIFFAMP, "r_diff_in=10.0k $ tol=1%", "r_diff_in=10.0k $ match=net1 dev=0.1%")
    result = read(tmp_path, net, overrides=("tolerance.resistors=2%",))
    a, b, other = (deviation(result, key) for key in ("xdiff1.r11", "xdiff1.r13", "xdiff2.r11"))
    together = np.cov(a, b)
    assert together[0, 1] == pytest.approx((0.98659 * 0.02 / 3) ** 2, rel=0.1)
    assert 0.0 < np.abs(a - b).max() <= 0.002 * (1 + 1e-9)
    assert np.abs(np.corrcoef(a, other)[0, 1]) < 5 / np.sqrt(4000)


def test_values_that_may_be_changed_become_preferred_ones(tmp_path: Path) -> None:
    result = read(tmp_path, overrides=("tolerance.series=E96", "device.values.r_diff_fb=168.1k"))
    assert result.components[result.keys.index("xdiff1.r12")].nominal == 169e3


def test_all_that_is_wrong_is_reported_with_file_and_line(tmp_path: Path) -> None:
    with pytest.raises(InputError) as caught:
        read(
            tmp_path,
            (SUMMER, "24.3k $ tol=1%", "24.3k $ tol=120%"),
            (SUMMER, "r_sum_damper=6.19k $ tol=1%", "r_sum_damper=6.19k $ lot=-5% dev=1%"),
            (DIFFAMP, "r_diff_fb=169k $ tol=1%", "r_diff_fb=169k $ tol=1% match=net7 dev=1% metal"),
            ("board2.cir", "Rcmd1 cmd1 sum1 {r_sum_cmd}", "Rcmd1 cmd1 sum1 {r_sum_cmd} $ match=lone dev=1%"),
            overrides=("tolerance.components.rsp13=1%",),
        )
    problems = {(Path(p.file or "").name, p.line) for p in caught.value.problems}
    assert {("summer.cir", 3), ("summer.cir", 4), ("diffamp.cir", 3), ("press.toml", None)} <= problems
    text = str(caught.value)
    for each in (
        "more tolerance than value",
        "negative",
        "'metal' is no part",
        "alone in the network",
        "rsp21",
    ):
        assert each in text


def test_what_the_scene_says_wrong_is_reported_at_the_scene(tmp_path: Path) -> None:
    """It named the netlist's line, where nothing is wrong, and a blank in the place of a unit."""
    scene = tmp_path / "press.toml"
    text = PRESS.read_text().replace("../netlists", (ROOT / "netlists").as_posix())
    rows = '[tolerance]\nk_t = "120% uniform"\n[tolerance.components]\nrsp11 = "match=net tol=1%"\n'
    scene.write_text(text + rows)
    with pytest.raises(InputError) as caught:
        tolerances(load_scene(scene))
    first = text.count("\n") + 2
    assert {(p.file, p.line) for p in caught.value.problems} == {(str(scene), first), (str(scene), first + 2)}
    assert "alone in the network" in str(caught.value)
    assert "motor_k = 0.04, uniform" in str(caught.value)


def test_a_shape_before_its_tolerance_is_refused(tmp_path: Path) -> None:
    """It was taken for words: a sorted resistor came out as one whose middle is there."""
    with pytest.raises(InputError) as caught:
        read(tmp_path, (SUMMER, "24.3k $ tol=1%", "24.3k $ sorted(inner=0.1%) tol=1%"))
    assert [(Path(p.file or "").name, p.line) for p in caught.value.problems] == [("summer.cir", 3)]
    assert "stands before the tolerance" in str(caught.value)


def test_a_histogram_outside_the_project_takes_trust(tmp_path: Path) -> None:
    (tmp_path / "lot.csv").write_text("percent\n-1\n1\n")
    rows = (SUMMER, "24.3k $ tol=1%", "24.3k $ histogram=../../lot.csv")
    with pytest.raises(InputError, match="lies outside the project's folder"):
        read(tmp_path, rows)
    scene = load_scene(PRESS, [f"device.board={tmp_path / 'netlists' / 'board2.cir'}"])
    assert np.unique(np.sign(deviation(tolerances(scene, trust=True), "rsp11"))).tolist() == [-1.0, 1.0]


def test_of_a_function_in_a_formula_no_unit_is_told(tmp_path: Path) -> None:
    """A hundredth was told to be 0.01 Ohm of 10 kOhm."""
    for number, (value, text) in enumerate(
        (
            ("{10k*(1+flat(0.01))}", "uniform +-0.01 in its formula"),
            ("{mc(10k,0.01)}", "uniform +-100 Ohm"),
            ("aunif(10k,100)", "uniform +-100 Ohm"),
        )
    ):
        drawn = read(tmp_path / str(number), (SUMMER, "r_sum_fb=10.0k $ tol=1%", f"r_sum_fb={value} $"))
        one = drawn.components[drawn.keys.index("xsum1.r31")]
        assert one.distribution == text
        assert np.abs(deviation(drawn, "xsum1.r31")).max() == pytest.approx(0.01, rel=0.01)


RNOM = ".param grade={third*2} third=0.02 rnom={5k*2}"


@pytest.mark.parametrize(
    ("written", "meant"),
    [
        ("{mc(rnom,grade)}", "{mc(10k,0.04)}"),
        ("{mc(10k,{grade/4})}", "{mc(10k,0.01)}"),
        ("gauss(rnom,grade,3)", "gauss(10k,0.04,3)"),
        ("agauss(10k,grade*rnom,3)", "agauss(10k,400,3)"),
        ("aunif(10k,third*rnom)", "aunif(10k,200)"),
        ("{unif(rnom,third)}", "{unif(10k,0.02)}"),
        ("limit(rnom,third*rnom)", "limit(10k,200)"),
        ("{10k*(1+flat(third))}", "{10k*(1+flat(0.02))}"),
        ("{10k*(1+gauss(grade/4))}", "{10k*(1+gauss(0.01))}"),
    ],
)
@pytest.mark.parametrize("behind", [False, True])
def test_a_function_s_argument_may_be_a_constant_parameter(
    tmp_path: Path, written: str, meant: str, behind: bool
) -> None:
    """LTspice's usual {mc(10k,tol)}, wherever the parameter stands: as the number written out."""

    def drawn(name: str, value: str) -> Tolerances:
        line = f".param r_sum_fb={value}"
        rows = f"{line}\n{RNOM}" if behind else f"{RNOM}\n{line}"
        return read(tmp_path / name, (SUMMER, ".param r_sum_fb=10.0k $ tol=1%", rows))

    one, other = drawn("written", written), drawn("meant", meant)
    told, expected = ([(c.key, c.nominal, c.distribution) for c in of.components] for of in (one, other))
    assert told == expected
    assert "xsum1.r31" in one.keys
    assert {k: v.tobytes() for k, v in values(one).items()} == {
        k: v.tobytes() for k, v in values(other).items()
    }


def test_a_function_s_parameter_is_that_of_its_subcircuit_and_of_set(tmp_path: Path) -> None:
    """An instance's value counts before a default, that before the board's; ``--set`` sets the board's."""
    part = ".param tol=0.05\n.subckt pulled a b rnom=20k tol=0.5\nR1 a b {mc(rnom,tol)}\n.ends\n"
    placed = (
        "Xone cmd1 0 pulled tol=0.01\nXtwo cmd1 0 pulled tol={tol}\nXthree cmd1 0 pulled\n"
        "Rfour cmd1 0 {mc(10k,tol)}\n"
    )
    edits = [(first, more + first) for first, more in ((".subckt board2 ", part), ("Rcmd1 cmd1 ", placed))]
    read(tmp_path, *(("board2.cir", old, new) for old, new in edits))
    found = []
    for more in ([], ["device.values.tol=0.1"]):
        scene = load_scene(PRESS, [f"device.board={tmp_path / 'netlists' / 'board2.cir'}", *more])
        of = {c.key: c.distribution for c in tolerances(scene).components}
        found.append([of[key] for key in ("xone.r1", "xtwo.r1", "xthree.r1", "rfour")])
    amounts = [["200", "1000", "1e+04", "500"], ["200", "2000", "1e+04", "1000"]]
    assert found == [[f"uniform +-{amount} Ohm" for amount in row] for row in amounts]


@pytest.mark.parametrize("varying", ["0.05 $ tol=10%", "{unif(0.05,0.1)}", "{2*inner}", "{nowhere}"])
def test_a_function_of_what_is_drawn_is_refused(tmp_path: Path, varying: str) -> None:
    rows = f".param r_sum_fb={{mc(10k,grade/2)}}\n.param inner={{flat(0.1)}}\n.param grade={varying}"
    with pytest.raises(InputError, match="or made of parameters that do not vary") as caught:
        read(tmp_path, (SUMMER, ".param r_sum_fb=10.0k $ tol=1%", rows))
    assert {Path(p.file or "").name for p in caught.value.problems} == {"summer.cir"}
    assert all(p.line for p in caught.value.problems)


@pytest.mark.parametrize(
    "value",
    [
        "gauss(10k,(0.05),3)",
        "unif(10k,(1+1)/100)",
        "limit(10k,min(1k,2k))",
        "agauss(10k,(1k),3)",
        "mc(10k,(0.1))",
    ],
)
def test_a_function_that_would_keep_its_nominal_value_is_refused(tmp_path: Path, value: str) -> None:
    """ngspice's reader takes the first argument of each; three of these were drawn as nothing, in silence."""
    with pytest.raises(InputError, match="or made of parameters that do not vary"):
        read(tmp_path, (SUMMER, ".param r_sum_fb=10.0k $ tol=1%", f".param r_sum_fb={{{value}}}"))


def test_five_per_cent_of_a_millihenry_is_a_share(tmp_path: Path) -> None:
    """Taken as an absolute sigma it once made 47 % of all inductors negative."""
    result = read(
        tmp_path,
        (
            "board2.cir",
            "Rcmd1 cmd1 sum1 {r_sum_cmd}",
            "Rcmd1 cmd1 sum0 {r_sum_cmd}\nLcmd1 sum0 sum1 1m $ tol=5%",
        ),
    )
    drawn = values(result, 20_000)["lcmd1"]
    assert (drawn.min() >= 0.95e-3, drawn.max() <= 1.05e-3) == (True, True)


def test_plain_ngspice_reads_what_has_tolerances(tmp_path: Path) -> None:
    """A tolerance stands behind a comment sign: ngspice sees the nominal value."""
    deck = tmp_path / "divider.cir"
    deck.write_text(
        "divider\n.param r=10k $ lot=5% dev=1% uniform\nV1 in 0 1\nR1 in out {r}\nR2 out 0 {r} $ tol=1%\n"
        ".op\n.print op v(out)\n.end\n"
    )
    output = subprocess.run(
        ["ngspice", "-b", deck], capture_output=True, text=True, check=True, timeout=60
    ).stdout
    assert "5.000000e-01" in output


def test_list_prints_every_variable(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["mc", str(PRESS), "--list", "--json"]) == 0
    out = json.loads(capsys.readouterr().out)
    assert len(out["components"]) == 36
    assert {"key", "nominal", "unit", "distribution", "lots", "file", "line"} == set(out["components"][0])
    assert cli.main(["mc", str(PRESS), "--list"]) == 0
    text = capsys.readouterr().out
    assert "rsp12" in text
    assert "summer.cir:3" in text
    assert (
        cli.main(["mc", str(PRESS), "--set", "tolerance.components.r_sum_spring=lot=5% dev=1%", "--list"])
        == 0
    )
    (line,) = (row for row in capsys.readouterr().out.splitlines() if row.startswith("rsp11 "))
    assert "lot:r_sum_spring" in line


def test_check_prints_them_and_what_is_wrong(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    wrong = board(tmp_path, (SUMMER, "24.3k $ tol=1%", "24.3k $ tol=120%"))
    assert cli.main(["check", str(wrong), "--level", "ideal"]) == 2
    assert "summer.cir:3: more tolerance than value" in capsys.readouterr().out
    assert cli.main(["check", str(ROOT / "netlists/board1.cir"), "--level", "ideal", "--json"]) == 0
    out = json.loads(capsys.readouterr().out)["checks"][0]["tolerances"]
    assert "xdiff1.r11" in {row["key"] for row in out}


def test_the_halves_of_a_dual_op_amp_have_a_lot(tmp_path: Path) -> None:
    """Said on the lines of the parts: what the scene gives op-amps is shared, `dev` is each half's own."""
    half = "xop inp inn vcc vee out tl072"
    dual = f"{half} $ match=dual dev=1%\nxspare inp inn vcc vee o2 tl072 $ match=dual dev=1%\nrl o2 0 1k"
    deck = load_deck(board(tmp_path, (DIFFAMP, half, dual)), levels={"opamp": "gbw"})
    result = tolerances(load_scene(PRESS, ["tolerance.gbw=30%"]), board=deck)
    a, b, other = (
        deviation(result, f"{path}:tl072_gbw") for path in ("xdiff1.xop", "xdiff1.xspare", "xdiff2.xop")
    )
    assert 0.0 < np.abs(a - b).max() <= 0.02 * (1 + 1e-9)
    assert abs(np.corrcoef(a, other)[0, 1]) < 5 / np.sqrt(4000)
    assert np.abs(a).max() > 0.2


#: A vendor's op-amp whose elements, and those of a subcircuit of its own, have tolerances or not.
INSIDE = """\
.subckt amp 1 2 3 4 5
R9 1 2 10meg
G1 0 6 1 2 1m $ tol=6%
R1 6 0 100meg
C1 6 0 30p
E1 7 0 VALUE={V(6)} $ tol=1%
X1 7 5 stage
.ends
.subckt stage in out
R2 in mid 50 $ tol=3% ; Ohm
R3 mid out 1
.ends
"""


def test_a_tolerance_inside_a_part_is_drawn_or_told(tmp_path: Path) -> None:
    file = tmp_path / "amp.lib"
    file.write_text(INSIDE)
    scene = load_scene(PRESS, ["tolerance.resistors=1%"])
    deck = load_deck(scene.device.board, parts={"opamp": PartSwap(file, "amp", "1 2 3 4 5")})
    with collected() as cautions:
        drawn = values(tolerances(scene, board=deck))
    inside = {key for key in drawn if ".xop." in key and "xangle1" in key}
    # what states none has none: a default is of the resistors on the board
    assert inside == {"xangle1.xop.g1", "xangle1.xop.x1.r2"}
    assert np.std(drawn["xangle1.xop.g1"]) == pytest.approx(1e-3 * 0.06 / 3.0, rel=0.05)
    assert np.std(drawn["xangle1.xop.x1.r2"]) == pytest.approx(50.0 * 0.03 / 3.0, rel=0.05)
    assert abs(np.corrcoef(drawn["xangle1.xop.g1"], drawn["xangle2.xop.g1"])[0, 1]) < 0.1
    told = [caution for caution in cautions if caution.code == "tolerance-undrawn"]
    assert told
    assert all("amp.lib:6: the tolerance of e1 in the part amp" in caution.text for caution in told)
