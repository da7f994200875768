"""Ways by which a netlist or a stored result tried to get out of its circuit; each would leave a file behind.

ngspice runs here in this process, outside the sandbox: nothing but the choke point is between it and a shell.
"""

import json
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cosim.errors import InputError
from cosim.export import command as to_run
from cosim.export.scene_deck import _deck as exported
from cosim.ngspice import deck_file
from cosim.ngspice.aliases import Aliases
from cosim.ngspice.allowed_commands import spelled
from cosim.ngspice.deck import load_deck
from cosim.ngspice.gate import admit
from cosim.ngspice.lines import Line
from cosim.ngspice.simulator import Simulator
from cosim.plan import resolve
from cosim.scene import load_scene

PROJECT = Path(__file__).parent / "data" / "ngspice" / "project"
ROOT = Path(__file__).parent.parent


@pytest.fixture(autouse=True)
def empty_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Any:
    """Work in an empty folder; whatever a test leaves there besides its project has escaped."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("M", "owned")
    yield
    assert [path.name for path in tmp_path.iterdir() if path.name != "p"] == []


def test_a_name_is_a_program_where_nothing_stands_before_ngspice(tmp_path: Path) -> None:
    """What the rest of this file prevents."""
    (tmp_path / "p").mkdir()
    code = (
        "from cosim.ngspice.simulator import Simulator\n"
        "s = Simulator(); s.load('t\\nR1 a 0 1\\nV1 a 0 1\\n')\n"
        "for c in (b'print @r`touch${IFS}one`[i]', b'save v(a`touch${IFS}two`)', b'print a>three'):\n"
        "    s._library.api.ngSpice_Command(c)\n"
    )
    subprocess.run([sys.executable, "-c", code], cwd=tmp_path / "p", check=True, env=_environment())
    assert {"one", "two", "three"} & {path.name for path in (tmp_path / "p").iterdir()}


def _environment() -> dict[str, str]:
    import os

    return {**os.environ, "PYTHONPATH": str(ROOT)}


ODD = [
    "`touch$IFS$M`", "a`>owned`", "x>owned", "x>>owned", "x>&owned", "x<owned", "x|tee", "x&", "$M",
    "o$x", "$(touch)", "!!", "!1", "^a^b", "~", "@r1[i]", "@x", "#branch", "a#b", "%M", "%v", "a\\b",
    "in+", "in-", "/Net-(U1-Pad1)", "a.b", "x1.y", "a[0]", "[0]", "<0>", "and", "not", "all", "gt",
    "temper", "hertz", "v", "i", "pi", "const", "über", "Ω", "0x", "1", "*x", "*ng_script", "*#", "+",
    "-x", "?", "n1", "sub1", "mod1", "none", "echo", "_", "a:b", "a|b", "nul", "null", "POLY", "params:x",
]  # fmt: skip


@pytest.mark.parametrize("name", ODD)
def test_odd_names_are_names(name: str) -> None:
    """Elements, nodes, models, subcircuits and instances of odd names, by every command that we send."""
    simulator = Simulator()
    simulator.load(
        "\n".join(
            [
                "*ng_script",
                f".model m{name} d(is=1e-30)",
                f".subckt s{name} {name} q{name}",
                f"R{name} {name} in{name} 1k",
                f"Rb{name} in{name} q{name} 1k",
                f"D{name} q{name} 0 m{name}",
                ".ends",
                f"V{name} {name} 0 dc 1 ac 1",
                f"X{name} {name} q{name} s{name}",
                f"Rl{name} q{name} 0 2k",
                f"E{name} e{name} 0 value={{2*v({name},q{name})+(v({name})>0?1:0)+0*i(v{name})}}",
                f"F{name} f{name} 0 v{name} 1",
                f"Rf{name} f{name} 0 1k",
                f"Re{name} e{name} 0 1k",
                f".save v({name}) v(q{name}) v(e{name}) v(f{name}) v(x{name}.in{name})",
            ]
        )
    )
    simulator.command("op")
    inner = f"x{name}.in{name}"
    # 1 V over 1k + 1k + 2k: 0.25 mA
    assert simulator.vector(name)[0] == 1.0
    assert simulator.vector(f"q{name}")[0] == pytest.approx(0.5, rel=1e-6)
    assert simulator.vector(inner)[0] == pytest.approx(0.75, rel=1e-6)
    assert simulator.vector(f"e{name}")[0] == pytest.approx(2.0, rel=1e-6)
    assert simulator.vector(f"f{name}")[0] == pytest.approx(0.25, rel=1e-6)  # 0.25 mA out of V's plus node
    low = name.lower()
    assert {low, f"q{low}", f"e{low}", f"f{low}", inner.lower()} == set(simulator.vector_names())
    simulator.command(f"alter v{name} dc = 2")
    simulator.command(f"alter @r.x{name}.r{name}[resistance] = 3000")
    simulator.command("delete all")
    simulator.command(f"save v({name}) v(q{name})")
    simulator.command("op")
    assert simulator.vector(f"q{name}")[0] == pytest.approx(2 / 3, rel=1e-6)  # 2 V over 3k + 1k + 2k
    value = simulator.command(f"print @rl{name}[resistance]")[0]
    assert value.split("=")[-1].strip() == "2.000000e+03"
    assert f"@rl{low}[resistance]" in value
    simulator.command("delete all")
    simulator.command("destroy all")
    simulator.command(f"noise v(q{name}) v{name} dec 1 1 10 1")
    simulator.command("setplot noise1")
    assert simulator.vector(f"onoise_rl{name}")[0] > 0
    assert f"onoise_r.x{low}.r{low}_thermal" in simulator.vector_names()


@pytest.mark.parametrize("name", ["time", "frequency"])
def test_a_node_of_the_name_of_a_scale_is_kept_apart_from_it(name: str) -> None:
    simulator = Simulator()
    simulator.load(f"t\nV1 {name} 0 dc 3 ac 2\nR1 {name} 0 1k\n")
    simulator.command("tran 1u 10u" if name == "time" else "ac lin 1 5 5")
    assert sorted(simulator.vector_names()) == sorted([name, f"v({name})", "v1#branch"])
    assert simulator.vector(f"v({name})")[-1] == (3 if name == "time" else 2)
    assert simulator.vector(name)[-1] == pytest.approx(10e-6 if name == "time" else 5.0)


ROWS = [
    ".control", ".exec touch owned", "*ng_script\n.control\nshell touch owned\n.endc",
    "shell touch owned", ".csparam y=`touch${IFS}owned`", ".csparam y", ".csparam y=$M",
    ".param y=`touch owned`", ".param y=$M", '.param tp="filesource"', '.param tp="touch owned"',
    ".model fs {tp} (amploffset=[0])", '.model fs filesource(file "/etc/passwd" amploffset=[0])',
    ".model fs 'tp' (is=1)", ".model fs $M (is=1)", '.model d9 d_source(input_file="/dev/zero")',
    ".model d9 d_source(x=1)", ".model d9 d_process(x=1)", ".model d9 d_state(x=1)",
    ".model d9 d_cosim(x=1)", ".model d9 table2d(x=1)", ".model d9 table3d(x=1)",
    ".model d9 ako:d8 filesource(x=1)", ".model d9 d(is=`touch`)", ".model d9 file_source(x=1)",
    ".model d9", ".options sourcepath=/etc", ".options filetype=ascii", ".options rawfile=owned",
    ".options interp `touch`", ".func f(x) {`touch owned`}", ".func f(x) {$M}", "R9 a 0 {`touch`}",
    "R9 a 0 $M", 'R9 a 0 "1k"', "V9 a 0 pwl file=owned", "V9 a 0 pwl(0 0) file = 'x'", "B9 a 0 v=`touch`",
    "B9 a 0 v=v(`touch owned`)", "B9 a 0 v=@r1[i]", "E9 a 0 value={v(a) $M}",
    "E9 a 0 table {v(a)} = \\owned", "N9 a b osdi", "P9 a b c", "Y9 a 0 b 0 m", "X9 a b {sub}",
    "X9 a b 'sub'", ".nodeset v(a)=`touch`", ".temp `touch`", ".global {x}", ".if (`touch`)\n.endif",
    ".hdl x.va", ".load x", ".write owned", ".wrdata owned", ".pre_osdi x.osdi", ".sav all", "=x", "@x",
    "`touch owned`", "> owned",
]  # fmt: skip


@pytest.mark.parametrize("row", ROWS)
def test_rows_that_are_refused(tmp_path: Path, row: str) -> None:
    """By the reader where it sees them, and by the gate whoever brings them."""
    with pytest.raises(InputError):
        Simulator().load(f"t\nR1 a 0 1k\nV1 a 0 1\n{row}\n")
    shutil.copytree(PROJECT, tmp_path / "p")
    board = tmp_path / "p" / "board.cir"
    block = board.parent / "blocks" / "stage.cir"
    block.write_text(block.read_text().replace("\n.ends", f"\n{row}\n.ends", 1))
    with pytest.raises(InputError):
        load_deck(board)


BREAKS = ["\n", "\r", "\x0b", "\x0c", "\x1c", "\x1d", "\x1e", "\x85", "\u2028", "\u2029", "\0", "\x1b"]


@pytest.mark.parametrize("end", BREAKS)
def test_one_row_is_one_line(tmp_path: Path, end: str) -> None:
    tail = f"{end}.control{end}shell touch owned{end}.endc"
    with pytest.raises(InputError):
        Simulator().load(f"t\nV1 a 0 1\nR1 a 0 1k{tail}\n")
    shutil.copytree(PROJECT, tmp_path / "p")
    for value in (f"10k{tail}", f"{{10k{tail}}}", f"'10k{tail}'"):
        with pytest.raises(InputError):
            load_deck(tmp_path / "p" / "board.cir", overrides={"r_fb": value})
    aliases = Aliases()
    for command in (f"op{end}shell touch owned", f"save v(a){end}op", f"save v(a{end}b)"):
        if end != "\x1e" or "save" in command:
            with pytest.raises((ValueError, InputError)):
                spelled(command, aliases)


COMMANDS = [
    "shell touch owned", "!touch owned", "source x", "write owned", "wrdata owned a", "load x",
    "codemodel x.cm", "pre_osdi x", "osdi x", "set x=`touch owned`", "set program=x", "unset x",
    "let a=1", "echo x", "op > owned", "op ; shell touch owned", "op | tee", "op `touch owned`",
    "tran 1u 1m ; op", "tran `touch` 1", "ac dec 1 1 $M", "alter v1 = `touch`", "alter v1 dc = 1 ; op",
    "alter @v1[`touch`] = 1", "alterparam x`touch` = 1", "alterparam x = $M", "print a > owned",
    "print $M", "print `touch owned`", "setplot `touch`", "setplot new", "noise v(a) v1 dec 1 1 $M",
    "dc v1 0 1 `touch`", "delete `touch`", "stop when time > `touch`", "quit", "exit", "history",
    "alias a b", "cd /", "python x", "version -s x", "hardcopy owned", "snsave owned", "iplot a",
    "set ngbehavior=`touch`", "edit", "sndprint owned", "pyplot a", "gnuplot owned a", "plot a",
    "xgraph owned a",
]  # fmt: skip


@pytest.mark.parametrize("command", COMMANDS)
def test_commands_that_are_not_sent(command: str) -> None:
    simulator = Simulator()
    simulator.load("t\n.param x=1\nV1 a 0 1\nR1 a 0 1k\n")
    with pytest.raises((ValueError, InputError)):
        simulator.command(command)


def test_legal_expressions_stay_legal() -> None:
    """Conditions, functions that hand nodes on, devices, POLY, mutual inductors, models and switches."""
    simulator = Simulator()
    simulator.load(
        "\n".join(
            [
                "t",
                ".param gain = {2*3} half='1/2'",
                ".csparam gain={gain}",
                ".func twice(x) {2*x}",
                ".func both(a,b) = '(twice(a)+a-b)'",
                "Vin+ in+ 0 dc 2",
                "R1 in+ o$x 1k",
                "R2 o$x 0 {half*2k}",
                "B1 b1 0 v=both(v(in+), V(o$x))",  # 2*2 + (2 - 1)
                "B2 b2 0 v = V(in+) > 0 && i(Vin+) <= 0 ? gain : -1",  # 6
                "B3 0 b3 i={-1m*ternary_fcn(v(in+,o$x)>=1, 1, 0)}",  # -1 V on 1k
                "R3 b3 0 1k",
                "E1 e1 0 POLY(2) (in+,0) (o$x,0) 0 1 10",  # 2 + 10
                "E2 e2 0 in+ o$x 5",  # 5
                "G1 0 g1 poly(1) in+ 0 0 1m",  # 2 V on 1k
                "R4 g1 0 1k",
                "F1 0 f1 POLY(2) Vin+ Vz 0 1k 0",  # -1 mA * 1k = -1 A on 1 Ohm
                "R5 f1 0 1",
                "H1 h1 0 Vin+ 1k",  # -1
                "Vz z 0 0",
                "L1 l1 0 1m",
                "L2 l2 0 1m",
                "K1 L1 L2 0.5",
                "R6 l1 l2 1",
                "S1 in+ s1 in+ 0 sw_x",
                "R7 s1 0 1k",
                ".model sw_x sw vt=1 ron=1m roff=1g",
                "R8 in+ r8 1µ",
                "R9 r8 0 1MEGΩ",
            ]
        )
    )
    simulator.command("op")
    by_name = {
        n: float(np.real(simulator.vector(n)[0])) for n in ("b1", "b2", "b3", "e1", "e2", "g1", "f1", "h1")
    }
    wanted = {"b1": 5.0, "b2": 6.0, "b3": -1.0, "e1": 12.0, "e2": 5.0, "g1": 2.0}
    assert {n: by_name[n] for n in wanted} == pytest.approx(wanted, rel=1e-6)
    # Vin+ feeds R1+R2 (1 mA), S1 through 1k (2 mA), R8 (2 uA)
    assert by_name["f1"] == pytest.approx(-3.002, rel=1e-5)
    assert by_name["h1"] == pytest.approx(-3.002, rel=1e-5)
    assert simulator.constant("gain") == 6.0
    assert simulator.vector("l1")[0] == pytest.approx(0.0, abs=1e-9)


def test_a_stored_board_is_a_strangers(tmp_path: Path) -> None:
    shutil.copytree(PROJECT, tmp_path / "p")
    folder = tmp_path / "p"
    board = load_deck(folder / "board.cir")
    deck_file.save(board, folder)
    assert deck_file.load(folder).text == board.text
    record = json.loads((folder / deck_file.FILE).read_text())
    evil = [
        {"text": "R999 a 0 1k\n.control\nshell touch owned\n.endc"},
        {"text": "R999 a 0 1k\u2028.control"},
        {"text": ".control", "trusted": True},
        {"text": '.model f filesource(file "x")', "trusted": True},
        {"text": ".options sourcepath=/"},
        {"text": "B999 a 0 v=`touch owned`"},
        {"text": ".tran 1 1"},
    ]
    for line in evil:
        changed = {**record, "lines": [*record["lines"], line]}
        text = "".join(each["text"] + "\n" for each in changed["lines"])
        import hashlib

        changed["digest"] = hashlib.sha256(text.encode()).hexdigest()
        (folder / deck_file.FILE).write_text(json.dumps(changed))
        with pytest.raises(InputError):
            deck_file.load(folder)


def test_a_board_of_any_name_has_our_title(tmp_path: Path) -> None:
    shutil.copytree(PROJECT, tmp_path / "p")
    board = tmp_path / "p" / "board.cir"
    text = board.read_text()
    name = next(row.split()[1] for row in text.splitlines() if row.lower().startswith(".subckt"))
    board.write_text(text.replace(f".subckt {name}", ".subckt *ng_script").replace(f".ends {name}", ".ends"))
    deck = load_deck(board)
    assert deck.board == "*ng_script"
    assert admit([line.text for line in deck.lines], deck.lines).rows[0] == "cosim"


def test_names_of_a_deck_for_people_are_readable() -> None:
    rows = ["t", "* a remark", "*# shell touch owned", "Rload in+ out_1 1k", "V1 in+ 0 1", "V`x` b 0 2"]
    deck = admit(rows, readable=True)
    assert deck.rows[1:3] == ["* a remark", "*"]
    assert deck.rows[3] == "rload n1 out_1 1k"
    assert "`" not in "".join(deck.rows)


@pytest.mark.parametrize(
    "node", ["x)\n.control\nshell touch owned\n.endc\n*(", "a\u2028b", "a b", "a;b", '"a"', ""]
)
def test_a_recorded_node_is_a_name(node: str) -> None:
    with pytest.raises(InputError, match=r"record.nodes"):
        resolve(load_scene(ROOT / "scenes" / "press.toml", [f"record.nodes={json.dumps([node])}"]))


def test_an_exported_deck_is_no_script() -> None:
    """Whatever a scene is called and whatever its board names: ``ngspice -b`` runs no command of it."""
    title = "*ng_script\x1b]0;x\x07 `touch owned`"
    plan = resolve(load_scene(ROOT / "scenes" / "press.toml", [f"title={json.dumps(title)}"]))
    assert "xdiff1" in plan.board.text
    odd = [Line(line.text.replace("xdiff1", "x`touch`")) for line in plan.board.lines]
    rows = exported(replace(plan, board=replace(plan.board, lines=tuple(odd))), "a deck", [], [])
    assert rows[0].startswith("cosim export, ")
    assert rows[0].isprintable()
    assert not [row for row in rows[1:] if "`" in row and not row.startswith("* ")]
    assert not [row for row in rows if row.startswith("*#") or row.lower().startswith((".control", "*ng_"))]


def test_the_command_of_an_exported_deck_works_as_printed(tmp_path: Path) -> None:
    deck = tmp_path / "p" / "my deck's $(touch owned).cir"
    deck.parent.mkdir()
    deck.write_text("cosim export, t: x\n* Run with: ngspice -b -D ngbehavior=psa\n.end\n")
    result = to_run(deck)
    echoed = subprocess.run(
        ["/bin/sh", "-c", f"printf '%s\\n' {result}"], capture_output=True, text=True, check=True
    )
    assert echoed.stdout.splitlines() == ["ngspice", "-b", "-D", "ngbehavior=psa", str(deck)]


def test_aliases_change_no_number() -> None:
    """Bit for bit, in every analysis: ngspice orders nodes and elements by their place, not by their name."""
    levels = {
        "opamp": "full",
        "vca": "full",
        "driver_level": "full",
        "motor": "full",
        "potentiometer": "full",
    }
    board = load_deck(ROOT / "netlists" / "board2.cir", levels=levels)
    drive = {pin: "dc 0.3 ac 1" for pin in board.pins if not pin.startswith(("imot", "vcc", "vee"))}
    drive["u1"] = "dc 0.3 ac 1 sin(0.3 1 50)"
    sources = [f"v_{pin} {pin} 0 {value}" for pin, value in drive.items()]
    bench = [
        *sources,
        "vcc vcc 0 15",
        "vee vee 0 -15",
        f"xboard {' '.join(board.pins)} {board.board}",
        ".end",
    ]
    rows = []
    for trusted in (False, True):  # a trusted deck keeps its names
        lines = [Line(line.text, trusted=trusted) for line in board.lines]
        simulator = Simulator()
        simulator.load("\n".join([*(line.text for line in lines), *bench]), lines)
        seen: dict[str, Any] = {}
        noise = "noise v(imot1) v_u1 dec 2 1 1meg 1"
        for analysis in ("op", "ac dec 5 1 10meg", "tran 100u 20m 0 100u", noise):
            simulator.command("destroy all")
            simulator.command(analysis)
            if analysis == noise:
                simulator.command("setplot noise1")
            for name in simulator.vector_names():
                seen[f"{analysis.split()[0]} {name}"] = simulator.vector(name)
        rows.append(seen)
    assert rows[0].keys() == rows[1].keys()
    assert len(rows[0]) > 500
    assert [name for name in rows[0] if not np.array_equal(rows[0][name], rows[1][name])] == []
