"""Each part alone: every level shows the numbers of its data sheet."""

import math
import re
from pathlib import Path

import pytest
from netlist_decks import NETLISTS, measures, parameters, run_program
from support import BOARD1, ROOT, scene_of, slider

from cosim.circuits.design_constants import DesignConstants
from cosim.circuits.extraction.design_numbers import of_deck
from cosim.errors import InputError
from cosim.ngspice.deck import load_deck
from cosim.plan import resolve


@pytest.mark.parametrize("part", ["tl072", "ua741", "opa2134", "ad633", "opa548", "motor", "potentiometer"])
def test_parts_say_their_role_and_have_all_levels(part: str) -> None:
    text = (NETLISTS / "parts" / f"{part}.lib").read_text()
    role = re.match(r"\*@ role=(\w+)(?: out=(\w+) swing=(\w+) noise=(\w+) density=(\w+))?\n", text)
    assert role is not None
    levels = {
        "motor": {"ideal", "emf", "full"},
        "potentiometer": {"ideal", "full"},
    }.get(role[1], {"ideal", "gbw", "full"})
    assert set(re.findall(r"^\.lib (\w+)$", text, re.MULTILINE)) == levels | {"data"}
    pins = {re.sub(r" params:.*", "", line) for line in re.findall(r"^\.subckt (.*)$", text, re.MULTILINE)}
    assert len(pins) == 1, "all levels have the same pins"
    if role[2]:
        assert {role[2], role[4]} <= set(pins.pop().split())
        assert f".param {role[5]}=" in text
        assert f".csparam {role[3]}=" in text


def part_deck(folder: Path, part: str, level: str, circuit: str) -> dict[str, float]:
    deck = folder / "part.cir"
    rails = "Vcc vcc 0 15\nVee vee 0 -15\n"
    deck.write_text(f"a part alone\n.lib 'netlists/parts/{part}.lib' {level}\n{rails}{circuit}\n.end\n")
    return measures(run_program(deck))


@pytest.mark.parametrize("part", ["tl072", "ua741", "opa2134", "opa548"])
def test_op_amp_levels_show_their_data_sheet(part: str, tmp_path: Path) -> None:
    data = {key.removeprefix(f"{part}_"): value for key, value in parameters(f"parts/{part}.lib").items()}
    stage = f"Vin in 0 dc 1 ac 1\nx1 in out vcc vee out {part}\nRl out 0 100k\n"
    dc = ".dc Vin 1 1.1 0.1\n.measure dc out find v(out) at=1"
    assert part_deck(tmp_path, part, "ideal", stage + dc)["out"] == pytest.approx(1, rel=1e-6)

    ac = f".save all\n.ac dec 200 1k 100meg\n.measure ac f3 when vm(out)={1 / math.sqrt(2)} fall=1\n"
    # a follower with one pole is down 3 dB at the gain-bandwidth product; 1e-3 for interpolation
    assert part_deck(tmp_path, part, "gbw", stage + ac)["f3"] == pytest.approx(data["gbw"], rel=1e-3)

    # open loop with 1 uV (and the offset cancelled): the DC gain
    opened = f"Vin in 0 1u\nx1 in 0 vcc vee out {part}\nRl out 0 100k\n.dc Vin 0 2u 1u\n"
    opened += ".measure dc lo find v(out) at=0\n.measure dc hi find v(out) at=1u\n"
    gain = part_deck(tmp_path, part, "gbw", opened)
    assert (gain["hi"] - gain["lo"]) / 1e-6 == pytest.approx(data["aol"], rel=2e-5)  # 1 Ohm into 100 kOhm

    full = part_deck(tmp_path, part, "full", stage + dc)
    assert full["out"] - 1 == pytest.approx(data["vos"], rel=0.02, abs=2 / data["aol"])

    swing = f"Vin in 0 1\nx1 in 0 vcc vee out {part}\nRl out 0 100k\n.dc Vin -1 1 2\n"
    swing += ".measure dc lo find v(out) at=-1\n.measure dc hi find v(out) at=1\n"
    limit = 15 - data["drop"]
    result = part_deck(tmp_path, part, "full", swing)
    assert result["hi"] == pytest.approx(limit, rel=0.01)
    assert result["lo"] == pytest.approx(-limit, rel=0.01)

    rise = 4 / data["sr"]
    slew = f"Vin in 0 pulse(-5 5 {rise} 1n 1n 1 2)\nx1 in out vcc vee out {part}\nRl out 0 100k\n"
    slew += f".options reltol=1e-5\n.tran {rise / 100} {8 * rise}\n"
    slew += ".measure tran a when v(out)=-2 rise=1\n.measure tran b when v(out)=2 rise=1\n"
    crossed = part_deck(tmp_path, part, "full", slew)
    # tanh of at least 3 V over the input stage's linear range sr/(2 pi gbw)
    linear = data["sr"] / (2 * math.pi * data["gbw"])
    assert 4 / (crossed["b"] - crossed["a"]) == pytest.approx(
        data["sr"], rel=0.01 + 2 * math.exp(-2 * 3 / linear)
    )

    bias = f"Vin in 0 0\nRs in p 100k\nx1 p out vcc vee out {part}\n"
    bias += ".dc Vin 0 1 1\n.measure dc p find v(p) at=0\n"
    assert part_deck(tmp_path, part, "full", bias)["p"] == pytest.approx(
        -1e5 * data["ib"], rel=1e-3, abs=1e-9
    )


def test_op_amp_noise_is_its_data_sheet_density(tmp_path: Path) -> None:
    for part in ("tl072", "ua741", "opa2134", "opa548"):
        deck = tmp_path / "noise.cir"
        deck.write_text(
            f"noise of a follower\n.lib 'netlists/parts/{part}.lib' full\nVcc vcc 0 15\nVee vee 0 -15\n"
            f"Vin in 0 dc 0 ac 1\nx1 in out vcc vee out {part}\n"
            ".noise v(out) Vin lin 2 1k 2k\n.print noise all\n.end\n"
        )
        density = float(re.findall(r"^0\s+1\.0+e\+03\s+\S+\s+(\S+)", run_program(deck), re.MULTILINE)[0])
        stated = parameters(f"parts/{part}.lib")[f"{part}_en"]
        assert density == pytest.approx(stated, rel=0.01)  # the followers' gain and the diodes' shot noise


def test_multiplier_levels_show_their_data_sheet(tmp_path: Path) -> None:
    data = parameters("parts/ad633.lib")
    part = "x1 x 0 y 0 w 0 vcc vee ad633\nRl w 0 10k\n"
    sweep = (
        "Vx x 0 5\nVy y 0 -8\n.dc Vx -5 5 5\n.measure dc hi find v(w) at=5\n.measure dc lo find v(w) at=-5\n"
    )
    ideal = part_deck(tmp_path, "ad633", "ideal", part + sweep)
    assert ideal["hi"] == pytest.approx(-4, rel=2e-5)
    assert ideal["lo"] == pytest.approx(4, rel=2e-5)

    ac = "Vx x 0 dc 0 ac 1\nVy y 0 10\n.save all\n.ac dec 200 1k 100meg\n"
    ac += f".measure ac f when vm(w)={1 / math.sqrt(2)} fall=1"
    assert part_deck(tmp_path, "ad633", "gbw", part + ac)["f"] == pytest.approx(data["ad633_bw"], rel=1e-3)

    # small signals see the same pole at level full: at full scale of Y the gain is within 1.5 % of 1
    assert part_deck(tmp_path, "ad633", "full", part + ac)["f"] == pytest.approx(data["ad633_bw"], rel=0.03)

    full = part_deck(tmp_path, "ad633", "full", part + sweep)
    for key in ("hi", "lo"):
        assert abs(full[key] - ideal[key]) < 0.02 * 10, "total error of the data sheet: 2 % of full scale"
        assert abs(full[key] - ideal[key]) > 0.005, "and not an ideal part"
    zero = "Vx x 0 0\nVy y 0 0\n.dc Vx 0 10 10\n.measure dc w find v(w) at=0\n"
    assert part_deck(tmp_path, "ad633", "full", part + zero)["w"] == pytest.approx(
        data["ad633_vosout"], rel=0.01
    )

    jump = "Vx x 0 10\nVy y 0 pulse(-10 10 1u 1n 1n 1 2)\n.options reltol=1e-5\n.tran 10n 4u\n"
    jump += ".measure tran a when v(w)=-5 rise=1\n.measure tran b when v(w)=0 rise=1\n"
    crossed = part_deck(tmp_path, "ad633", "full", part + jump)
    linear = data["ad633_sr"] / (2 * math.pi * data["ad633_bw"])
    # while w crosses from -5 to 0 V at least 10 V are still to go
    assert 5 / (crossed["b"] - crossed["a"]) == pytest.approx(
        data["ad633_sr"], rel=0.01 + 2 * math.exp(-2 * 10 / linear)
    )


def test_motor_levels(tmp_path: Path) -> None:
    data = parameters("parts/motor.lib")
    r, inductance = data["motor_r"], data["motor_l"]
    circuit = ".param kt=0.04\nVp p 0 dc 4 ac 1\nVv vel 0 10\nx1 p 0 vel imot motor\n"
    dc = ".dc Vp 4 5 1\n.measure dc amps find v(imot) at=4\n"
    assert part_deck(tmp_path, "motor", "ideal", circuit + dc)["amps"] == pytest.approx(4 / r, rel=1e-6)
    for level in ("emf", "full"):
        amps = part_deck(tmp_path, "motor", level, circuit + dc)["amps"]
        assert amps == pytest.approx((4 - 0.04 * 10) / r, rel=1e-6)
    ac = f".save all\n.ac dec 200 1 100k\n.measure ac f when vm(imot)={1 / r / math.sqrt(2)} fall=1\n"
    corner = part_deck(tmp_path, "motor", "full", circuit + ac)["f"]
    assert corner == pytest.approx(r / (2 * math.pi * inductance), rel=1e-3)  # interpolation between points


def test_potentiometer_levels(tmp_path: Path) -> None:
    """A loaded wiper: the track's two ends in parallel, a (1 - a) r with a = 1/2 + angle/travel."""
    data = parameters("parts/potentiometer.lib")
    travel = math.radians(340)
    v_rad = 2 * data["pot_vref"] / travel
    for level in ("ideal", "full"):
        for load in (10e3, 1e6):
            circuit = "Va a 0 1\nx1 a open potentiometer\nx2 a loaded potentiometer\n"
            circuit += f"Rl loaded 0 {load}\n.options reltol=1e-8\n.dc Va -2 2 1\n"
            circuit += "".join(
                f".measure dc {name}{k} find v({node}) at={k - 2}\n"
                for name, node in (("o", "open"), ("l", "loaded"))
                for k in range(5)
            )
            result = part_deck(tmp_path, "potentiometer", level, circuit)
            for k in range(5):
                angle = k - 2
                share = 0.5 + angle / travel
                ohms = data["pot_rw"] + data["pot_r"] * share * (1 - share) if level == "full" else 1.0
                assert result[f"o{k}"] == pytest.approx(v_rad * angle, rel=1e-6)
                # 1e-6: six digits printed
                assert result[f"l{k}"] == pytest.approx(v_rad * angle / (1 + ohms / load), rel=2e-6)


# ---- what the files state


def stated(part: str) -> set[str]:
    """Quantities that a part's file hands to the program, without the part's name."""
    text = (ROOT / "netlists" / "parts" / f"{part}.lib").read_text()
    return set(re.findall(rf"^\.csparam {part}_(\w+)=", text, re.MULTILINE))


@pytest.mark.parametrize("part", ["tl072", "ua741", "opa2134", "opa548"])
def test_every_amplifier_states_the_same_list(part: str) -> None:
    own = {"ilim"} if part == "opa548" else set()  # a power op-amp's current limit
    assert stated(part) == {"swing", "gbw", "aol", "sr", "vos", "ib", "en"} | own


def test_a_part_states_every_number_that_the_program_asks_of_its_role() -> None:
    asked: dict[str, set[str]] = {}
    for file in (ROOT / "cosim").rglob("*.py"):
        for role, quantity in re.findall(r'constants\.of\("(\w+)", "(\w+)"\)', file.read_text()):
            asked.setdefault(role, set()).add(quantity)
    assert asked["opamp"] >= {"gbw", "aol"}
    for file in (ROOT / "netlists" / "parts").glob("*.lib"):
        role = re.search(r"role=(\w+)", file.read_text())
        assert role is not None
        assert stated(file.stem) >= asked.get(role[1], set()), file.stem


@pytest.mark.parametrize("part", ["ua741", "opa2134"])
def test_a_plan_with_any_op_amp_has_every_size(tmp_path: Path, part: str) -> None:
    scene = scene_of(tmp_path, slider(device={"parts": {"opamp": part}}))
    plan = resolve(scene).as_dict()
    words = [row["size"]["words"] for row in (*plan["effects"], *plan["left_out"])]
    assert not [text for text in words if "states no" in text]


@pytest.mark.parametrize("value", ["0", "1e-320", "-1", "1e300"])
@pytest.mark.parametrize("name", ["tl072_gbw", "opa548_aol", "ad633_bw", "motor_r", "tl072_sr"])
def test_part_data_at_the_edge_is_refused_by_name(tmp_path: Path, name: str, value: str) -> None:
    """Hard case 57; levels are ideal, so that the netlist itself does not divide by them."""
    numbers = {**dict.fromkeys(DesignConstants.names(), 1.0), name: float(value)}
    board = load_deck(BOARD1)
    with pytest.raises(InputError, match=rf"{name} = .*allowed: 1e-30 to 1e\+30"):
        of_deck(board, numbers)
    with pytest.raises(InputError, match=r"i_limit = .*allowed"):
        of_deck(board, dict.fromkeys(DesignConstants.names(), 1.0) | {"i_limit": float(value)})
