"""The library's face: commands, vectors, callbacks, errors in ngspice's own words."""

import ctypes
import math
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from cosim.errors import CosimError, InputError, SimulationError
from cosim.ngspice import library
from cosim.ngspice.allowed_commands import end_and_aim_s
from cosim.ngspice.child import call
from cosim.ngspice.deck import Deck, PartSwap, load_deck
from cosim.ngspice.lines import Line
from cosim.ngspice.simulator import STOP_COMMAND, Simulator

DATA = Path(__file__).parent / "data" / "ngspice"
BOARD = DATA / "project" / "board.cir"
REAL = Path(__file__).parent.parent / "netlists"
RC = "an RC\n.param tau=1m\n.csparam tau={tau}\nV1 a 0 external\nR1 a b 1k\nC1 b 0 1u\n.end\n"


@pytest.fixture
def simulator() -> Simulator:
    return Simulator()


def bench(deck: Deck, **volts: float) -> str:
    """Return the deck with every input of the board driven, 0 V where nothing is said."""
    supplies = {"vcc": 15.0, "vee": -15.0}
    drive = {p: volts.get(p, supplies.get(p, 0.0)) for p in deck.pins if not p.startswith("imot")}
    rows = [f"v{pin} {pin} 0 {volt!r}" for pin, volt in drive.items()]
    return deck.text + "\n".join([*rows, f"xboard {' '.join(deck.pins)} {deck.board}", ".end"])


def current(simulator: Simulator, deck: Deck, **volts: float) -> float:
    simulator.load(bench(deck, **volts), deck.lines)
    simulator.command("op")
    return float(simulator.vector("imot1")[0].real)


def test_commands_vectors_and_constants(simulator: Simulator) -> None:
    assert simulator.version >= 39
    simulator.attach(source=lambda name, t: 2.0 if name == "v1" else math.nan)
    simulator.load(RC)
    printed = simulator.command("tran 10u 1m uic")
    assert any("No. of Data Rows" in row for row in printed)
    time, volts = simulator.vector("time"), simulator.vector("b")
    # trapezoidal rule at the default reltol of 1e-3
    assert volts[-1] == pytest.approx(2 * (1 - math.exp(-time[-1] / 1e-3)), rel=1e-3)
    assert simulator.constant("TAU") == 1e-3
    assert simulator.vector_names() == sorted(simulator.vector_names(), key=simulator.vector_names().index)
    assert {"a", "b", "time"} <= set(simulator.vector_names())


def test_an_analysis_of_any_length_ends(simulator: Simulator) -> None:
    """ngspice reads some lengths a rounding shorter than Python: 44 then gave up at the end of one in six."""
    simulator.attach(source=lambda name, t: 1.0)
    simulator.load(RC)
    for length in (10.0 ** np.random.default_rng(1).uniform(-6.0, 1.0, 60)).tolist():
        simulator.command(f"tran {length / 100!r} {length!r} 0 {length / 100!r}")
        assert simulator.vector("time")[-1].real == pytest.approx(length, rel=1e-12)
        simulator.command("destroy")


def test_complex_vectors(simulator: Simulator) -> None:
    simulator.load("an RC\nV1 a 0 dc 0 ac 1\nR1 a b 1k\nC1 b 0 1u\n")
    simulator.command("ac lin 1 159.15494309189535 159.15494309189535")  # the corner, 1/(2 pi R C)
    assert simulator.vector("b")[0] == pytest.approx(0.5 - 0.5j, rel=1e-9)


def test_unknown_vector_and_constant_name_the_nearest(simulator: Simulator) -> None:
    simulator.attach(source=lambda name, t: 0.0)
    simulator.load(RC)
    simulator.command("op")
    with pytest.raises(InputError, match="nearest is v1#branch"):
        simulator.vector("v1#brnch")
    with pytest.raises(InputError, match="nearest is tau"):
        simulator.constant("taw")
    simulator.load("other\nR1 a 0 1\nV1 a 0 1\n")
    with pytest.raises(InputError, match=r"no such \.csparam"):
        simulator.constant("tau")  # an earlier deck's


@pytest.mark.parametrize(
    ("command", "words"),
    [
        ("tran 1u", "TSTOP is invalid"),
        ("print v(nosuch)", "carry out 'print v(nosuch)'"),
        ("print @r1[nosuch]", "no such"),
    ],
)
def test_commands_that_fail_quote_ngspice(simulator: Simulator, command: str, words: str) -> None:
    simulator.attach(source=lambda name, t: 0.0)
    simulator.load(RC, name="rc.cir")
    simulator.command("tran 1u 1m")
    with pytest.raises(SimulationError, match=r"rc.cir") as caught:
        simulator.command(command)
    assert words in str(caught.value)
    simulator.command("op")  # and life goes on


def test_not_one_command(simulator: Simulator) -> None:
    for text in ("", "  ", "op\nop", "frobnicate", "let a = 1", "op; op", "meas tran x find v(b) at=5"):
        with pytest.raises(ValueError, match=r"not (one|a command)"):
            simulator.command(text)


def test_an_exception_in_a_callback_stops_the_run_and_arrives(simulator: Simulator) -> None:
    def sync(time: float, delta: float, old: float, redo: int, loc: int) -> None:
        if time > 0.5e-3:
            raise LookupError("from the control law")

    simulator.attach(source=lambda name, t: 1.0, sync=sync)
    simulator.load(RC)
    with pytest.raises(LookupError, match="from the control law"):
        simulator.command("tran 1u 1m")
    assert simulator.vector("time")[-1] < 0.6e-3
    simulator.attach(source=lambda name, t: 1.0)
    simulator.command("tran 1u 1m")  # no stop is left behind
    assert simulator.vector("time")[-1] == pytest.approx(1e-3, rel=1e-9)


def test_an_exception_in_a_source_arrives(simulator: Simulator) -> None:
    simulator.attach(source=lambda name, t: 1 / 0)
    simulator.load(RC)
    with pytest.raises(ZeroDivisionError):
        simulator.command("op")


def test_a_source_without_an_answer_is_named(simulator: Simulator) -> None:
    simulator.load(RC)
    with pytest.raises(SimulationError, match="v1"):
        simulator.command("op")


class VecValues(ctypes.Structure):
    _fields_ = (("name", ctypes.c_char_p), ("real", ctypes.c_double), ("imag", ctypes.c_double))


class VecValuesAll(ctypes.Structure):
    _fields_ = (
        ("count", ctypes.c_int),
        ("index", ctypes.c_int),
        ("rows", ctypes.POINTER(ctypes.POINTER(VecValues))),
    )


DATA_TYPE = ctypes.CFUNCTYPE(
    ctypes.c_int, ctypes.POINTER(VecValuesAll), ctypes.c_int, ctypes.c_int, ctypes.POINTER(ctypes.c_double)
)
SOURCE_TYPE = ctypes.CFUNCTYPE(
    ctypes.c_int,
    ctypes.POINTER(ctypes.c_double),
    ctypes.c_double,
    ctypes.c_char_p,
    ctypes.c_int,
    ctypes.POINTER(ctypes.c_double),
)


def address(function: Any) -> int:
    value = ctypes.cast(function, ctypes.c_void_p).value
    assert value is not None
    return value


def test_c_callbacks_by_address_breakpoints_and_truncation(simulator: Simulator) -> None:
    shared = np.array([3.0, 0.0])
    times: list[float] = []
    names: list[str] = []
    lengths = np.empty(0, np.int64)

    def source(value: Any, t: float, name: bytes, ident: int, user: Any) -> int:
        value[0] = user[0]
        return 0

    def data(values: Any, count: int, ident: int, user: Any) -> int:
        times.append(values[0].rows[names.index("time")][0].real)
        user[1] += 1
        for place in lengths:
            ctypes.c_int.from_address(int(place)).value = 1
        return 0

    def init(calls: list[str]) -> None:
        nonlocal lengths
        names[:] = calls
        times.clear()
        shared[1] = 0
        lengths = simulator.length_addresses()

    kept = DATA_TYPE(data), SOURCE_TYPE(source)
    simulator.attach(data=address(kept[0]), source=address(kept[1]), init=init, user=shared.ctypes.data)
    simulator.load(RC)
    set_breakpoint = ctypes.CFUNCTYPE(ctypes.c_bool, ctypes.c_double)(simulator.set_breakpoint_address())
    assert set_breakpoint(math.pi * 1e-4)
    assert set_breakpoint(math.e * 1e-4)
    simulator.command("tran 1u 1m 0 100u")
    assert set(names) == {"time", "a", "b", "v1#branch"}
    for wanted in (math.pi * 1e-4, math.e * 1e-4):  # a breakpoint is met to rounding
        assert min(abs(t - wanted) for t in times) < 1e-15
    assert shared[1] == len(times) > 20
    assert lengths.size == len(names)
    assert simulator.vector("time").size == 1  # all but one place were forgotten
    assert times[-1] == pytest.approx(1e-3, rel=1e-9)


def test_a_compiled_callback_can_stop_the_run(simulator: Simulator) -> None:
    command = ctypes.CFUNCTYPE(ctypes.c_int, ctypes.c_char_p)(simulator.command_address())

    def data(values: Any, count: int, ident: int, user: Any) -> int:
        if values[0].index == 50:
            command(STOP_COMMAND)
        return 0

    kept = DATA_TYPE(data)
    simulator.attach(data=address(kept), source=lambda name, t: 1.0)
    simulator.load(RC)
    with pytest.raises(SimulationError, match="interrupted"):
        simulator.command("tran 1u 1m")
    assert simulator.vector("time").size == 52  # the points 0 to 50, and the one at which it stopped


def test_progress_tells_the_simulated_time() -> None:
    seen: list[float] = []

    class Enough(Exception):
        pass

    def on_time(t: float) -> None:
        seen.append(t)
        if len(seen) == 2:
            raise Enough

    simulator = Simulator(on_time)
    simulator.load("oscillator\nV1 a 0 sin(0 1 1k)\nR1 a b 1k\nC1 b 0 1u\n")
    with pytest.raises(Enough):
        simulator.command("tran 1u 100")  # would take a minute
    assert 0 <= seen[0] < seen[1] < 50


def lines_of(text: str) -> list[Line]:
    return [Line(row, "user.cir", number) for number, row in enumerate(text.split("\n"), 1)]


@pytest.mark.parametrize(
    ("deck", "line", "words"),
    [
        ("t\nV1 a 0 1\nR1 a 0 1k zork=3", 3, "unknown parameter (zork)"),
        ("t\n.subckt foo a b\nR1 a b 1k zork=3\n.ends\nX1 c 0 foo\nV1 c 0 1", 3, "unknown parameter (zork)"),
        ("t\nV1 a 0 1\nX2 a b nosuch", 3, "unknown subckt"),
        ("t\n.subckt foo a b\nX1 a b bar\n.ends\nX1 c 0 foo\nV1 c 0 1", 3, "unknown subckt"),
        ("t\n.subckt foo a b\nR1 a b 1k\n.ends\nX7 c foo\nV1 c 0 1", 5, "Too few parameters"),
        ("t\nB1 a 0 v=foo(v(a)\nR1 a 0 1k", 2, "syntax error"),
        ("t\nR1 a 0 1k\nzork a b", 3, "zork a b"),
    ],
)
def test_netlist_errors_name_the_users_line(
    monkeypatch: pytest.MonkeyPatch, deck: str, line: int, words: str
) -> None:
    """In a child: after a deck it refuses, ngspice 39 may abort at any later time (double free)."""
    monkeypatch.syspath_prepend(str(Path(__file__).parent))
    with pytest.raises(InputError) as caught:
        call("ngspice_targets:load", (deck, lines_of(deck)))
    assert words in str(caught.value)
    assert caught.value.problems[0].line == line
    assert caught.value.problems[0].file == "user.cir"


@pytest.mark.parametrize(
    ("deck", "words"),
    [
        ("t\nV1 a 0 1\nR1 a 0 1k\nC1 a mid 1n\nC2 mid 0 1n", "floating node: mid has no DC path to ground"),
        ("t\nV1 a 0 1\nR1 a 0 1k\nG1 0 lost a 0 1m\nC2 lost 0 1n", "floating node: lost"),
        ("t\nV1 a 0 1\nV2 a 0 2\nR1 a 0 1k", "loop of voltage sources"),
        ("t\nB1 a 0 v=sqrt(-1-time)\nR1 a 0 1", "no DC operating point: Error: -1 out of range for sqrt"),
    ],
)
def test_no_operating_point_is_the_users_error(simulator: Simulator, deck: str, words: str) -> None:
    simulator.load(deck)
    with pytest.raises(InputError) as caught:
        simulator.command("op")
    assert words in str(caught.value)


def test_a_floating_node_inside_the_board_is_named_by_its_path(simulator: Simulator, tmp_path: Path) -> None:
    import shutil

    shutil.copytree(DATA / "project", tmp_path / "p")
    board = tmp_path / "p" / "board.cir"
    board.write_text(board.read_text().replace("R3 cmd1 s 10k", "R3 cmd1 s 10k\nC3 lost s 1n"))
    deck = load_deck(board)
    assert any("lost" in note for note in deck.notes)
    simulator.load(bench(deck), deck.lines)
    with pytest.raises(InputError, match=r"xboard\.lost"):
        simulator.command("op")


def test_a_friction_step_that_ngspice_cannot_take_is_an_error(simulator: Simulator) -> None:
    simulator.load(
        "t\nB1 a 0 V=sgn(time-0.5m+1e-3*v(b))\nR1 a b 1\nB2 0 b I=1e3*sgn(v(a))*sgn(v(b))\nC1 b 0 1p\n"
    )
    with pytest.raises(SimulationError, match=r'time step became too small, trouble with node "b"') as caught:
        simulator.command("tran 1u 1m uic")
    assert caught.value.time_s is not None
    assert "Timestep too small" in (caught.value.last_words or "")


def test_values_that_are_no_numbers_do_not_pass(simulator: Simulator) -> None:
    simulator.load("t\nV1 a 0 1e300\nR1 a 0 1\nE1 bad 0 a 0 1e300\nR2 bad 0 1\n")
    with pytest.raises(CosimError, match=r"no DC operating point|is not a number"):
        _asked(simulator, "op", "bad")


def _asked(simulator: Simulator, analysis: str, vector: str) -> None:
    simulator.command(analysis)
    simulator.vector(vector)


def test_an_operating_point_by_transient_is_no_operating_point(simulator: Simulator, tmp_path: Path) -> None:
    """An op-amp that clips hard before its pole: all methods fail, and ngspice's last resort is wrong."""
    text = (DATA / "vendor" / "pspice.lib").read_text()
    inputs = {"u1": 0.5, "pot1": 0.2, "vel1": -0.3, "ksp11": 4.0, "ksd11": 3.0, "cmd1": 0.7}
    clipped = "LIMIT(V(IN+,IN-)*AOL, V(V-)+1.5, V(V+)-1.5)"
    (tmp_path / "hard.lib").write_text(
        text.replace("V(IN+,IN-)*AOL", clipped).replace(
            "LIMIT(V(MID), -13.5, 13.5)", "IF(V(V+) > 1, V(MID), 0)"
        )
    )
    swap = PartSwap(tmp_path / "hard.lib", "OPA_PS", "in+ in- v+ v- out", "pspice")
    deck = load_deck(BOARD, parts={"opamp": swap})
    with pytest.raises(InputError, match="no DC operating point"):
        current(simulator, deck, **inputs)
    simulator.load(bench(deck, **inputs), deck.lines)
    simulator.command("tran 10u 20m")  # from there a transient analysis does settle
    assert simulator.vector("imot1")[-1] == pytest.approx(by_hand(0.5, 0.2, -0.3, 4.0, 3.0, 0.7), rel=1e-3)


def test_a_second_simulator_takes_over() -> None:
    Simulator().load("one\nV1 a 0 1\nR1 a 0 1\n")
    second = Simulator()
    second.load("two\nV1 b 0 2\nR1 b 0 1\n")
    second.command("op")
    assert second.vector("b")[0] == 2.0


# the small board's gains by hand: x = 2 (u - pot), w = x ksp/10, y = vel ksd/10; the summing amplifier gives
# -(20k/30k)*(w/10k + y/10k + cmd/10k) through the Thevenin of its three 10k: s = (w + y + cmd)/3 behind 10k/3
def by_hand(u: float, pot: float, vel: float, ksp: float, ksd: float, cmd: float) -> float:
    inputs = (2 * (u - pot) * ksp / 10 + vel * ksd / 10 + cmd) / 3
    # non-inverting input sees R13+R14 = 50k behind 10k/3, out = s2/r1*(v)  with v = divider
    at_node = inputs * 50e3 / (50e3 + 10e3 / 3)
    return at_node * (20 / 30) * 0.2


def test_board_renders_what_its_resistors_say(simulator: Simulator) -> None:
    deck = load_deck(BOARD)
    inputs = {"u1": 0.5, "pot1": 0.2, "vel1": -0.3, "ksp11": 4.0, "ksd11": 3.0, "cmd1": 0.7}
    wanted = by_hand(0.5, 0.2, -0.3, 4.0, 3.0, 0.7)
    # gain of the op-amps is 1e6 at noise gains up to 3
    assert current(simulator, deck, **inputs) == pytest.approx(wanted, rel=1e-5)
    edited = load_deck(BOARD, overrides={"r_fb": "20.2k"})
    assert current(simulator, edited, **inputs) != pytest.approx(wanted, rel=1e-3)


@pytest.mark.parametrize(
    "swap",
    [
        "opy",
        PartSwap(DATA / "vendor" / "boyle.lib", "TL072", "1 2 3 4 5"),
        PartSwap(DATA / "vendor" / "boyle.lib", "TL072", "p m vcc vee out", "pspice"),
        PartSwap(DATA / "vendor" / "pspice.lib", "OPA_PS", "in+ in- v+ v- out", "pspice"),
    ],
)
def test_swapped_amplifiers_render_the_same(simulator: Simulator, swap: PartSwap | str) -> None:
    inputs = {"u1": 0.5, "pot1": 0.2, "vel1": -0.3, "ksp11": 4.0, "ksd11": 3.0, "cmd1": 0.7}
    deck = load_deck(BOARD, parts={"opamp": swap})
    # worst loop gain 100,000 over a noise gain of 3; the vendor's model adds 0.1 mV of offset
    assert current(simulator, deck, **inputs) == pytest.approx(
        by_hand(0.5, 0.2, -0.3, 4.0, 3.0, 0.7), rel=1e-3
    )


def test_vendor_model_clips_where_its_data_sheet_says(simulator: Simulator) -> None:
    deck = load_deck(BOARD, parts={"opamp": PartSwap(DATA / "vendor" / "boyle.lib", "TL072", "1 2 3 4 5")})
    current(simulator, deck, u1=10.0)
    out = next(a.out_node for a in deck.amplifiers if a.path == "xboard.xdiff1.xop")
    assert 13.0 < simulator.vector(out)[0].real < 14.0  # asked for 20 V; 1.5 V from the 15 V rail, typical


def test_pspice_mode_does_not_change_our_own_parts(simulator: Simulator) -> None:
    levels = {
        "opamp": "full",
        "vca": "full",
        "driver_level": "full",
        "motor": "full",
        "potentiometer": "full",
    }
    deck = load_deck(REAL / "board1.cir", levels=levels)
    plain = bench(deck, u1=0.1, ksp11=5.0, vel1=1.0, ksd11=2.0, cmd1=0.3)
    values = []
    for text in (plain, plain.replace("\n", "\n*@ ngbehavior=psa\n", 1)):
        simulator.load(text)
        simulator.command("op")
        values.append(simulator.vector("imot1")[0].real)
    assert values[0] == values[1]
    assert abs(values[0]) > 0.01


def test_dialect_that_was_not_declared_is_ngspices_error(simulator: Simulator) -> None:
    with pytest.raises(InputError, match=r"pspice.lib"):
        load_deck(
            BOARD, parts={"opamp": PartSwap(DATA / "vendor" / "pspice.lib", "OPA_PS", "in+ in- v+ v- out")}
        )


def test_real_boards_have_an_operating_point_at_every_level(simulator: Simulator) -> None:
    for file in ("board1.cir", "board2.cir"):
        for level in ("ideal", "gbw", "full"):
            for drive in ("voltage", "current"):
                levels = {
                    "opamp": level,
                    "vca": level,
                    "driver_level": level,
                    "driver": drive,
                    "motor": "ideal",
                }
                deck = load_deck(REAL / file, levels=levels)
                # the direct command of 0.1 N m alone: i = 0.1/(kt gear), whatever the level within 2 %
                # (E96 rounding below 0.1 %, offsets of the full level some mV of 1.6 V)
                amps = current(simulator, deck, cmd1=0.1 * 15.625)
                assert amps == pytest.approx(0.1 / (0.04 * 8), rel=0.02), (file, level, drive)


def test_constants_of_a_deck_behind_an_analysis() -> None:
    """ngspice writes `.csparam` to the current plot, which an analysis leaves behind as its own."""
    deck = "deck\nv1 a 0 1\nr1 a 0 1k\n.param x={value}\n.csparam {name}={{x}}\n.end\n"
    simulator = Simulator()
    simulator.load(deck.format(value=3, name="first"))
    simulator.command("op")
    simulator.load(deck.format(value=5, name="second"))
    assert simulator.constant("second") == 5.0


def test_a_data_callback_that_stays_is_not_exchanged() -> None:
    """Every exchange initialises ngspice again, and its code models with it: later points get slower."""
    calls = []

    word = ctypes.POINTER(ctypes.c_int64)

    @ctypes.CFUNCTYPE(ctypes.c_int, ctypes.c_void_p, ctypes.c_int, ctypes.c_int, word)
    def data(values: Any, count: int, ident: int, user: Any) -> int:
        calls.append(user[0])
        return 0

    address = ctypes.cast(data, ctypes.c_void_p).value
    memory = np.array([7, 0], np.int64)
    for _ in range(2):
        simulator = Simulator()
        simulator.load(RC)
        simulator.attach(source=lambda name, time: 1.0)
        simulator.command("tran 1u 10u")
        user = memory.ctypes.data
        simulator.attach(data=address, source=lambda name, time: 1.0, user=user, data_stays=True)
        simulator.command("tran 1u 10u")
    inside = [value for value in calls if value == 7]
    outside = [value for value in calls if value == 0]
    assert len(inside) + len(outside) == len(calls)
    assert outside, "the callback stayed for the second simulator's first analysis"
    simulator._library.attach(None, None, None, None, None)
    simulator._library._stays = False
    simulator.attach()


@pytest.mark.parametrize(
    ("command", "end", "short"),
    [
        ("tran 1m 2", 2.0, True),
        ("tran 1m 2 0 1m uic", 2.0, True),
        (
            "tran 1.2e-09 0.001 0.00099 1.2e-09 uic",
            1e-3,
            False,
        ),  # least step 1.2e-20 s, four roundings 9e-19 s
        ("op", math.inf, False),
    ],
)
def test_a_last_step_aims_at_what_ngspice_takes_for_the_end(command: str, end: float, short: bool) -> None:
    assert end_and_aim_s(command) == (end, end - 4 * 2.0**-52 * end if short else end)


def test_a_library_that_pyspice_cannot_open_is_not_tried_under_another_name(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """PySpice has declared its functions by then: the second name would end in an error about these."""
    tried: list[str] = []

    def failing() -> None:
        tried.append(failing.LIBRARY_PATH)  # type: ignore[attr-defined]
        raise OSError("too many open files")

    monkeypatch.setattr(library, "_candidates", lambda: ["libc.so.6", "libm.so.6"])
    monkeypatch.setattr(library.ctypes, "CDLL", lambda name: SimpleNamespace(ngSpice_Init_Sync=None))
    with pytest.raises(InputError, match="cannot be opened by PySpice: too many open files"):
        library.Library._open(failing, None)
    assert tried == ["libc.so.6"]


def test_every_node_that_ngspice_names_can_be_read() -> None:
    """Also those that it adds to a source with a formula: reading them ended a run's second attempt."""
    simulator = Simulator()
    simulator.load(
        "t\nV1 a 0 1\nX1 a b amp\nR1 b 0 1k\n.subckt amp p q\nE_gain q 0 VALUE={2*V(p)}\n.ends\n.end\n"
    )
    simulator.command("op")
    names = [name for name in simulator.vector_names() if "#" not in name]
    assert any(name.startswith("x1.e_gain_int") for name in names)
    assert all(np.isfinite(simulator.vector(name)).all() for name in names)
    assert float(np.real(simulator.vector("b")[0])) == pytest.approx(2.0, rel=1e-9)


def test_a_library_whose_interface_is_declared_already_opens():
    """PySpice declares it once a process and refuses a second time, as it did in one of thousands of runs."""
    from PySpice.Spice.NgSpice.Shared import NgSpiceShared, ffi

    class Opened(NgSpiceShared):
        def _init_ngspice(self, send_data):
            pass

    first = library.opened()
    again = library.Library._open(Opened, ffi)
    assert ffi.cast("void *", again.ngSpice_Circ) == ffi.cast("void *", first.api.ngSpice_Circ)


def test_an_interface_that_was_declared_in_part_is_refused():
    from cffi import FFI, CDefError

    part = FFI()
    part.cdef("int ngSpice_Circ(char **);")
    with pytest.raises(CDefError, match="in part only"):
        library._declared(part, library._candidates()[0])


def test_a_library_that_did_not_open_says_why_ever_after(monkeypatch):
    """Not what the second try stumbles over: PySpice's declarations, which can be made once."""

    def no_memory():
        raise MemoryError("no room for a callback")

    for name, value in (("_library", None), ("_refused", None), ("Library", no_memory)):
        monkeypatch.setattr(library, name, value)
    with pytest.raises(MemoryError):
        library.opened()
    with pytest.raises(RuntimeError, match="MemoryError: no room for a callback"):
        library.opened()
