"""Hard cases of circuits alone: stiffness, scale, noise, slew, loops, and what has no answer."""

from __future__ import annotations

import math
from collections.abc import Callable
from decimal import Decimal, localcontext
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from cosim.accuracy.hard_cases.coupled_motion import _SPRING as _SPRING_GAIN
from cosim.accuracy.hard_cases.coupled_motion import _STATED
from cosim.accuracy.hard_cases.hard_case import ALL, OWN, RADIUS, CaseRunner, HardCase, slider
from cosim.assets import netlists_folder
from cosim.errors import CosimError
from cosim.loop.linear.matrix_phi import phi_functions

__all__ = ["CASES"]

_BOLTZMANN = 1.380649e-23


_SPRING = """
from cosim.loop.userlaw import Command
class Spring:
    def control(self, sample):
        return Command(u_rad=0 * sample.q_rad, stiffness=[[1.0]])
"""


def _bandwidth(what: str) -> Callable[[CaseRunner, str], float]:
    """Return what finds steps or current of 100 s of rest in gravity, amplifiers a thousand times faster."""

    def find(runner: CaseRunner, model: str) -> float:
        outcomes = []
        for hz in ("1e5", "1e8"):
            tables = slider(
                duration_s=100.0, device={"values": {"tl072_gbw": hz}, "slider": {"viscous_n_m_s": 5e-2}},
                computer={"law": "law.py:Spring"},
                effects={"opamp": "gbw", "gravity": True, "viscous": True},
                solver={"coupling_tolerance_rad": 1e-10, "max_step_s": 0.1},
            )  # fmt: skip
            outcomes.append(runner.run(tables, model, _SPRING))
        slow, fast = outcomes
        if what == "steps":
            return float(fast.stats["points"]) / float(slow.stats["points"])
        return float(0.04 * 8.0 * np.asarray(fast.signals["imot1"])[-1] / (9.81 * 0.2 * RADIUS))

    return find


def _follower(runner: CaseRunner, model: str) -> float:
    (out,) = runner.deck("follower\nVin in 0 1\nE1 out 0 in out 1e6\nR1 out 0 1k\n.end\n", "op", "out")
    return float(np.real(out[-1]))


def _tiny_capacitor(runner: CaseRunner, model: str) -> float:
    """Return the time constant [s] that the phase at its corner shows."""
    hz = 1e3 / (2 * math.pi)
    deck = "1 fF\nVin in 0 dc 0 ac 1\nR1 in out 1e12\nC1 out 0 1e-15\n.end\n"
    (out,) = runner.deck(deck, f"ac lin 1 {hz!r} {hz!r}", "out")
    return float(-out[0].imag / out[0].real) / (2 * math.pi * hz)


def _equal_poles(runner: CaseRunner, model: str) -> float:
    """Return the largest relative error of t exp(-t) on its flanks and at its level peak."""
    worst, apart = 0.0, 1e-8
    for t in (0.25, 0.5, 1.0, 2.0, 4.0, 16.0):
        exact = math.exp(-t) * -math.expm1(-apart * t) / apart
        for count in (0, 1):
            got = phi_functions(np.array([[-1.0, 0.0], [1.0, -1.0 - apart]]), t, count)[0][1, 0]
            worst = max(worst, abs(float(got) / exact - 1.0))
    return worst


#: Poles of a chain [rad/s]: its eigenvectors are well conditioned, or so poor that modes have to be split.
_APART, _TWINS = ("3", "2e3", "5e5", "6e7"), ("3", "3.00000001", "5e5", "6e7")


def _large_norm(h: float, rates: tuple[str, ...], runner: CaseRunner, model: str) -> float:
    """Return the largest relative error of a chain of poles up to 6e7 rad/s, against 60 digits."""
    a = np.zeros((4, 4))
    for i, rate in enumerate(map(float, rates)):
        a[i, i] = -rate
        if i:
            a[i, i - 1] = rate
    phi = phi_functions(a, h, 1)[0]
    worst = 0.0
    with localcontext() as context:
        context.prec = 60
        nodes = [-Decimal(rate) * Decimal(h) for rate in rates]
        for row in range(4):
            exact = sum(
                node.exp() / math.prod((node - other for other in nodes[: row + 1] if other != node),
                                       start=Decimal(1))
                for node in nodes[: row + 1]
            )  # fmt: skip
            exact *= math.prod((-node for node in nodes[1 : row + 1]), start=Decimal(1))
            worst = max(worst, abs(phi[row, 0] / float(exact) - 1.0))
    return worst


def _subnormal(runner: CaseRunner, model: str) -> float:
    """Largest change of what a swing of 1e-307 rad ends with, over one of 1e-3 rad; nothing is not linear."""
    ends = []
    for size in (1e-3, 1e-307):
        tables = slider(
            duration_s=0.04, device={"start": {"q_rad": [size]}}, computer={"period_s": 0.01},
            operator={"type": "hand", "mass_kg": 0.0, "stiffness_n_per_m": 50.0, "damping_n_s_per_m": 0.0,
                      "waypoints_s_m": [[0.0, 0.0, 0.0]]},
            effects={"operator_dynamics": True},
        )  # fmt: skip
        signals = runner.run(tables, model).signals
        ends.append(np.array([signals["q1"][-1], signals["v1"][-1], len(signals["time"]) * size]) / size)
    return float(np.abs(ends[1] / ends[0] - 1.0).max())


def _two_capacitors(what: str) -> Callable[[CaseRunner, str], float]:
    """Return what finds the common voltage, or the heat over C V^2/4, of 1 uF at 1 V and 1 uF at 0 V."""

    def find(runner: CaseRunner, model: str) -> float:
        worst = 0.0
        for ohms in (1e-2, 1.0, 1e2):
            tau = ohms * 0.5e-6
            deck = (
                f"two capacitors\nC1 a 0 1u ic=1\nC2 b 0 1u ic=0\nR1 a b {ohms!r}\n"
                f".options reltol=1e-6 chgtol=1e-18 vntol=1e-10 abstol=1e-14 method=trap\n.end\n"
            )
            t, a, b = (
                np.real(v)
                for v in runner.deck(deck, f"tran {tau / 100!r} {20 * tau!r} 0 {tau / 100!r} uic",
                                    "time", "a", "b")
            )  # fmt: skip
            if what == "voltage":
                got = float(b[-1]) / 0.5
            else:
                got = float(np.trapezoid((a - b) ** 2 / ohms, t)) / (1e-6 / 4)
            worst = max(worst, abs(got - 1.0))
        return worst

    return find


def _kt_over_c(ohms: float, runner: CaseRunner, model: str) -> float:
    """Return the noise [V rms] of 1 nF across a resistor at 300 K, from its density to 1e4 corners."""
    deck = f"kT/C\n.option temp=26.85\nVin in 0 dc 0 ac 1\nR1 in out {ohms!r}\nC1 out 0 1n\n.end\n"
    corner = 1.0 / (2 * math.pi * ohms * 1e-9)
    hz, density = runner.deck(
        deck, f"noise v(out) Vin dec 200 {corner / 1e4!r} {corner * 1e4!r}", "noise1.frequency",
        "noise1.onoise_spectrum",
    )  # fmt: skip
    return math.sqrt(float(np.trapezoid(np.real(density) ** 2, np.real(hz))))


def _slew(runner: CaseRunner, model: str) -> float:
    """Amplitude of a follower of a slow op-amp at 20 kHz, over SR/(4 f); its slew rate is 0.5 V/us."""
    hz, rate = 20e3, 0.5e6
    text = (Path(netlists_folder()) / "parts" / "ua741.lib").read_text(encoding="utf-8")
    data, part = (text.split(f".lib {name}\n")[1].split(f".endl {name}")[0] for name in ("data", "gbw"))
    data = "\n".join(row.partition(" $")[0] for row in data.split("\n"))
    data = data.replace("opamp_slew=0", "opamp_slew=1")
    deck = (
        f"slew\n{data}{part.partition(chr(10))[2]}"
        f"Vcc vcc 0 15\nVee vee 0 -15\nVin in 0 sin(0 50 {hz!r})\nx1 in out vcc vee out ua741\n"
        "Rl out 0 100k\n.options reltol=1e-5\n.end\n"
    )
    step = 1 / hz / 400
    (out,) = runner.deck(deck, f"tran {step!r} {42 / hz!r} {40 / hz!r} {step!r}", "out")
    return float(np.ptp(np.real(out))) / 2 / (rate / (4 * hz))


def _feedback(gain: float, runner: CaseRunner, model: str) -> float:
    deck = f"loop\nVin u 0 1\nRu u 0 1k\nB1 a 0 V=v(u)+{gain!r}*v(a)\nRa a 0 1k\n.end\n"
    (out,) = runner.deck(deck, "op", "a")
    return float(np.real(out[-1])) * (1.0 - gain)


def _loop_of_one(runner: CaseRunner, model: str) -> float:
    return runner.refusal(lambda: _feedback(1.0, runner, model), "singular")


def _refused(file: str, line: str, words: str) -> Callable[[CaseRunner, str], float]:
    """Return what finds whether a board with a line more in a block is refused with these words."""

    def find(runner: CaseRunner, model: str) -> float:
        place = runner.netlists({file: lambda text: text.replace(".ends", f"{line}\n.ends", 1)})
        tables = slider(device={"board": str(place / "board1.cir")}, duration_s=0.1)
        return runner.refusal(lambda: runner.run(tables, model), words)

    return find


def inputs_exchanged(text: str) -> str:
    """Return a block's netlist with the two inputs of its first op-amp exchanged."""
    rows = text.split("\n")
    at = next(k for k, row in enumerate(rows) if row.startswith("xop "))
    words = rows[at].split()
    words[1], words[2] = words[2], words[1]
    rows[at] = " ".join(words)
    return "\n".join(rows)


def _swapped(runner: CaseRunner, model: str) -> float:
    """Whether a follower with the inputs of its op-amp exchanged is called unstable."""
    place = runner.netlists({"blocks/angle.cir": inputs_exchanged})
    tables = slider(
        device={"board": str(place / "board1.cir")}, duration_s=0.1, solver={"max_step_s": 1e-3},
        effects={"opamp": "gbw"} if model != "ideal" else {},
    )  # fmt: skip
    return runner.refusal(lambda: runner.run(tables, model), "unstable")


_KICK = """
from cosim.loop.userlaw import Command
class Kick:
    def control(self, sample):
        return Command(torque_n_m=[0.6 if sample.tick == 2 else 0.0])
"""


def _hangs(amps: float, code: str, words: str, runner: CaseRunner, model: str) -> float:
    """Whether it is said that a kick of 9 V has let an output go where it stays.

    A source drives the summing node once the output is below -3 V, and drives nothing about 0 V: there are
    two solutions, and Newton finds the one that time integration has left.
    """
    line = "R31 sum out {r31}"
    hang = f"Bhang 0 sum I={amps!r}/(1+exp(4*(V(out)+3)))"
    place = runner.netlists({"blocks/summer.cir": lambda text: text.replace(line, f"{line}\n{hang}")})
    tables = slider(
        duration_s=0.15,
        device={"board": str(place / "board1.cir"), "slider": {"mass_kg": 1e3}},
        computer={"law": "law.py:Kick", "method": "discrete", "analog_stiffness_n_per_m": None,
                  "period_s": 0.025},
        effects={"opamp": "full", "vca": "gbw", "driver": "voltage", "driver_level": "gbw", "motor": "full"},
        solver={"coupling_tolerance_rad": 1e-7},
    )  # fmt: skip
    warnings = runner.run(tables, model, _KICK).warnings
    return float(any(each == code and words in text and "xsum1.xop" in text for each, text in warnings))


def _in_band(interval: float, runner: CaseRunner, model: str) -> float:
    """Return the power below 100 Hz of a potentiometer's noise over that of its density, drawn so often."""
    density, hz, seconds = 1e-10, 100.0, 2.0  # rad^2/Hz
    bandwidth = 0.5 / interval
    tables = slider(
        duration_s=seconds, device={"potentiometer": {
            "noise_rad": math.sqrt(density * bandwidth), "noise_bandwidth_hz": bandwidth}},
        effects={"pot_noise": "white"}, solver={"coupling_tolerance_rad": 1e-6},
    )  # fmt: skip
    s = runner.run(tables, model).signals
    at = np.arange(round(seconds / interval)) * interval
    noise = np.interp(at, s["time"], np.asarray(s["pot1"]) - np.asarray(s["q1"]))
    lines = np.fft.rfft(noise)[1 : round(hz * seconds) + 1] * interval
    power = 2 * float((np.abs(lines) ** 2).sum()) / seconds**2
    return power / (1.5 * density * hz)  # straight lines between ticks keep two thirds of a mean square


def _edge(values: dict[str, str], words: tuple[str, ...], *, undamped: bool = False) -> HardCase:
    """Return the case of a part's data at the edge of numbers: the exact limit, or an error with these words.

    The circuit's spring of 100 N/m and damper of 1 N s/m move 0.2 kg for half a swing. What has a limit is
    `undamped`: a differentiator without its capacitor, with which the carriage ends as far on the other side.
    """
    half = math.pi * math.sqrt(0.2 * RADIUS**2 / (100 * RADIUS**2 * _SPRING_GAIN / _STATED))

    def find(runner: CaseRunner, model: str) -> float:
        tables: dict[str, Any] = slider(
            duration_s=half, device={"values": values, "start": {"q_rad": [-0.01]}},
            computer={"period_s": half, "analog_damping_n_s_per_m": 1.0},
            wall={"point_m": [0.0, 0.0], "normal": [0.0, 1.0]},
            effects={"opamp": "gbw", "differentiator": "corner"}, solver={"coupling_tolerance_rad": 1e-7},
        )  # fmt: skip
        try:
            ran = runner.run(tables, model)
        except CosimError as error:
            return float(any(word in str(error) for word in words))
        return float(undamped and abs(ran.signals["q1"][-1] - 0.01) < 1e-5)

    description = ", ".join(f"{name} = {value}" for name, value in values.items())
    reason = "a capacitor of 1 uF leaves 7.0 of 10 mrad, none 10; amplifiers of 3 MHz feed 4e-7 rad"
    return HardCase(
        f"data at the edge, {description}", 57, "the limit or a named error (1)", 1.0,
        dict.fromkeys(("linear", "spice"), 0.0), reason if undamped else "nothing else is an answer", find,
        broken="stated values are not used",
    )  # fmt: skip


CASES = (
    HardCase("amplifiers of 1e8 Hz, 100 s", 1, "steps over those at 1e5 Hz", 1.0, {"linear": 0.2},
             "the list's own; the step does not depend on the circuit's poles", _bandwidth("steps"),
             broken="steps of a thousandth of the board's fastest pole: no end in a minute"),
    HardCase("amplifiers of 1e8 Hz, 100 s, weight", 1, "torque of the motor over the weight's", 1.0,
             {"linear": 1e-9}, "the list's own", _bandwidth("torque"), broken="gravity 0.1 % too weak"),
    HardCase("follower of gain 1e6", 2, "output for 1 V [V]", 1e6 / (1e6 + 1), {"spice": 1e-14},
             "a matrix of four entries: rounding, 1e-16 each", _follower, broken="1e6 is read as 1e5"),
    HardCase("1 fF on 1 TOhm", 3, "time constant [s]", 1e-3, {"spice": 1e-12},
             "the list's own, 1e-9 of it", _tiny_capacitor,
             broken="1 TOhm from every node to ground"),
    HardCase("poles 1 and 1 + 1e-8", 4, "largest error of t exp(-t), relative", 0.0, {"linear": 1e-13},
             "scaling and squaring: the few products of 1e-16 that a norm of 8 takes, doubled by each",
             _equal_poles, broken="eigenvectors in spite of their condition: 8e-9"),
    *(HardCase(f"matrix exponential, norm {6e7 * h:g}", 6, "largest error, relative", 0.0, {"linear": 1e-9},
               "the list's own", partial(_large_norm, h, _APART), broken="h (1 + 1e-8)")
      for h in (1e-6, 1e-3, 1.0)),
    HardCase("matrix exponential, norm 6e+07, twin slow poles", 6, "largest error, relative", 0.0,
             {"linear": 1e-9}, "the list's own", partial(_large_norm, 1.0, _TWINS),
             broken="fast poles are not split off: 3.5e-9; SciPy's own for triangular matrices: 8e-9"),
    HardCase("subnormal signals", 7, "change of the scaled answer", 0.0, dict.fromkeys(OWN, 1e-8),
             "1e-307 has 1e-15 of its digits left 1e-8 below it", _subnormal,
             broken="what is below 1e-300 rad starts at 0"),
    *(HardCase(f"two capacitors joined, {what}", 8, "largest error, relative", 0.0, {"spice": 1e-3},
               "hundred trapezoids a time constant: (1/100)^2/12 of it, and its first step by Euler",
               _two_capacitors(what), broken="a capacitor 1 % too large") for what in ("voltage", "heat")),
    *(HardCase(f"kT/C, 1 nF on {ohms:g} Ohm", 9, "noise [V rms]", math.sqrt(_BOLTZMANN * 300.0 / 1e-9),
               {"spice": 1e-4 * 2.035e-6},
               "half the power beyond 1e-4 and 1e4 corners, (4/pi) 1e-4; trapezoids of 200 a decade: 1e-5",
               partial(_kt_over_c, ohms),
               broken="the deck's temperature is dropped: 300.15 K") for ohms in (1e3, 1e6)),
    *(HardCase(f"noise drawn every {1e6 * interval:g} us", 10, "power below 100 Hz over its density's", 1.0,
               {"linear": 0.23, "spice": 0.23},
               "200 lines of two normal numbers each: 99.9 % within 3.3/sqrt(200)",
               partial(_in_band, interval),
               broken="values not scaled for the straight lines between them")
      for interval in (1e-3, 1e-4)),
    HardCase("output latched within a run", 49, "said with the amplifier (1)", 1.0, {"spice": 0.0},
             "1.4 mA through 10k ask for 14 V, more than there is",
             partial(_hangs, 1.4e-3, "output-latched", ""), broken="nothing is looked at"),
    HardCase("operating point that time integration has left", 49, "said with the amplifier (1)", 1.0,
             {"spice": 0.0}, "0.8 mA through 10k are 8 V; Newton finds 0 V",
             partial(_hangs, 0.8e-3, "operating-point-left", "-7.99 V"),
             broken="within the supply all is well"),
    HardCase("slew limit, large sine", 38, "amplitude over SR/(4 f)", 1.0, {"spice": 0.01},
             "0.16 us of each 25 us the input is inside the output's range", _slew,
             broken="a slew limit 2 % too high"),
    *(HardCase(f"algebraic loop of gain {gain:g}", 35, "output times (1 - g)", 1.0, {"spice": 1e-6},
               "Newton's steps end at reltol 1e-3 of a linear equation: after one of them it is exact",
               partial(_feedback, gain),
               broken="gains of sources 0.1 % too small") for gain in (0.5, -3.0, 2.0, 10.0)),
    HardCase("algebraic loop of gain 1", 35, "refused (1)", 1.0, {"spice": 0.0}, "it has no answer",
             _loop_of_one, broken="the row that became singular is not named"),
    HardCase("floating node", 41, "refused by name (1)", 1.0, dict.fromkeys(ALL, 0.0),
             "its voltage is anything", _refused("blocks/diffamp.cir", "C77 adrift 0 1n", "adrift"),
             broken="floating nodes are not named"),
    HardCase("loop of voltage sources", 41, "refused by name (1)", 1.0,
             dict.fromkeys(ALL, 0.0), "its current is anything",
             _refused("blocks/diffamp.cir", "V77 held 0 1\nV78 held 0 2", "loop of voltage sources"),
             broken="loops are not looked for"),
    HardCase("inputs of an op-amp exchanged", 48, "called unstable (1)", 1.0,
             dict.fromkeys(("linear", "spice"), 0.0), "its pole is at +2e7 rad/s", _swapped,
             broken="the runner lets an unstable verdict pass (spice; the extraction refuses, too)"),
    *(_edge({"tl072_gbw": value}, ("tl072_gbw", "gbw")) for value in ("0", "1e-320", "1e300")),
    _edge({"r_diff_fb": "0"}, ("R12", "R14")),
    _edge({"r_diff_fb": "1e15"}, ("r_diff_fb", "unstable", "operating point")),
    *(_edge({"c_der_in": value}, ("c_der_in",), undamped=True) for value in ("0", "1e-18")),
)  # fmt: skip
