"""Problems with published solutions that nobody here wrote, as decks.

The transistor amplifier of the test set for initial value problem solvers (Lioen and de Swart, CWI 1998; from
Hairer, Lubich and Roche, 1989): an index-1 differential-algebraic system of eight voltages. Its transistors
are written as sources, exactly as the set states them, so that no device model enters.

The ring modulator (Horneber, 1976; problem II-3 of the set): fifteen stiff equations of diodes on stray
capacitors of 2 pF, which ring at 3e7 rad/s; the set's solution is by RADAU with tolerances of 1e-12.
"""

from __future__ import annotations

from cosim.accuracy.hard_cases.hard_case import CaseRunner, HardCase
from cosim.accuracy.hard_cases.published import Published

__all__ = ["CASES"]

#: The set's solution at 0.2 s [V], by PSIDE with tolerances of 1e-14.
_AMPLIFIER = (
    -0.5562145012262709e-2, 0.3006522471903042e1, 0.2849958788608128e1, 0.2926422536206241e1,
    0.2704617865010554e1, 0.2761837778393145e1, 0.4770927631616772e1, 0.1236995868091548e1,
)  # fmt: skip
_START = (0.0, 3.0, 3.0, 6.0, 3.0, 3.0, 6.0, 0.0)
_END_S, _STEP_S = 0.2, 2e-6
_DECK = f"""transistor amplifier
Vb b 0 6
Vin in 0 sin(0 0.1 100)
R0 in n1 1k
C1 n1 n2 1u
R1 n2 0 9k
R2 n2 b 9k
B1 n2 n3 i=0.01*1e-6*(exp((v(n2)-v(n3))/0.026)-1)
B2 n4 n3 i=0.99*1e-6*(exp((v(n2)-v(n3))/0.026)-1)
R3 n3 0 9k
C2 n3 0 2u
R4 n4 b 9k
C3 n4 n5 3u
R5 n5 0 9k
R6 n5 b 9k
B3 n5 n6 i=0.01*1e-6*(exp((v(n5)-v(n6))/0.026)-1)
B4 n7 n6 i=0.99*1e-6*(exp((v(n5)-v(n6))/0.026)-1)
R7 n6 0 9k
C4 n6 0 4u
R8 n7 b 9k
C5 n7 n8 5u
R9 n8 0 9k
.ic {" ".join(f"v(n{k + 1})={v!r}" for k, v in enumerate(_START))}
.options reltol=1e-9 abstol=1e-15 vntol=1e-10 chgtol=1e-18 method=trap
.end
"""


#: The set's solution at 1 ms: voltages 1 to 7 [V], currents 1 to 8 [A].
_RING = (
    -0.2339057358486745e-1, -0.7367485485540825e-2, 0.2582956709291169, -0.4064465721283450,
    -0.4039455665149794, 0.2607966765422943, 0.1106761861269975, 0.2939904342435596e-6,
    -0.2840029933642329e-7, 0.7267198267264553e-3, 0.7929487196960840e-3, -0.7255283495698965e-3,
    -0.7941401968526521e-3, 0.7088495416976114e-4, 0.2390059075236570e-4,
)  # fmt: skip
#: Number of a current -> what drives its inductor [V], series resistance [Ohm], inductance [H].
_BRANCHES = {
    1: ("-v(u1)", 0.0, 4.45), 2: ("-v(u2)", 0.0, 4.45),
    3: ("0.5*v(u1)-v(u3)", 17.3, 5e-4), 4: ("-0.5*v(u1)+v(u4)", 17.3, 5e-4),
    5: ("0.5*v(u2)-v(u5)", 17.3, 5e-4), 6: ("-0.5*v(u2)+v(u6)", 17.3, 5e-4),
    7: ("-v(u1)+v(in1)", 50.0 + 36.3, 2e-3), 8: ("-v(u2)", 600.0 + 36.3, 2e-3),
}  # fmt: skip
#: Number of a voltage -> its capacitor [F], and the current into it [A].
_NODES = {
    1: (1.6e-8, "i(vs1)-0.5*i(vs3)+0.5*i(vs4)+i(vs7)-v(u1)/25k"),
    2: (1.6e-8, "i(vs2)-0.5*i(vs5)+0.5*i(vs6)+i(vs8)-v(u2)/25k"),
    3: (2e-12, "i(vs3)-v(d1)+v(d4)"), 4: (2e-12, "-i(vs4)+v(d2)-v(d3)"),
    5: (2e-12, "i(vs5)+v(d1)-v(d3)"), 6: (2e-12, "-i(vs6)-v(d2)+v(d4)"),
    7: (1e-8, "-v(u7)/50+v(d1)+v(d2)-v(d3)-v(d4)"),
}  # fmt: skip
_DIODES = {
    1: "v(u3)-v(u5)-v(u7)-v(in2)", 2: "-v(u4)+v(u6)-v(u7)-v(in2)",
    3: "v(u4)+v(u5)+v(u7)+v(in2)", 4: "-v(u3)-v(u6)+v(u7)+v(in2)",
}  # fmt: skip
_RING_END_S, _RING_STEP_S = 1e-3, 1.2e-9


def _ring_deck() -> str:
    rows = ["ring modulator", "Vin1 in1 0 sin(0 0.5 1k)", "Vin2 in2 0 sin(0 2 10k)"]
    rows += [f"Bd{k} d{k} 0 V=40.67286402e-9*(exp(17.7493332*({volts}))-1)" for k, volts in _DIODES.items()]
    for k, (drive, ohms, henry) in _BRANCHES.items():
        through = f"a{k} b{k}" if ohms else f"a{k} a{k}x"
        rows += [f"Ba{k} a{k} 0 V={drive}", f"L{k} {'b' if ohms else 'a'}{k} c{k} {henry!r} ic=0"]
        rows += [f"R{k} {through} {ohms!r}"] if ohms else []
        rows.append(f"Vs{k} c{k} 0 0")
    for k, (farad, current) in _NODES.items():
        rows += [f"C{k} u{k} 0 {farad!r} ic=0", f"Bu{k} 0 u{k} I={current}"]
    rows.append(".options reltol=1e-6 abstol=1e-15 vntol=1e-9 chgtol=1e-20 method=trap gmin=1e-18 maxord=2")
    return "\n".join([*rows, ".end\n"])


_AMPLIFIER_RUN = Published(_DECK, _END_S, tuple(f"n{k}" for k in range(1, 9)), _AMPLIFIER)


def _ring_run() -> Published:
    names = (*(f"u{k}" for k in _NODES), *(f"vs{k}#branch" for k in _BRANCHES))
    return Published(_ring_deck(), _RING_END_S, names, _RING, keep_from_s=0.99 * _RING_END_S, uic=True)


def _amplifier(runner: CaseRunner, model: str) -> float:
    return _AMPLIFIER_RUN.error(runner, _STEP_S)


def _amplifier_bound(runner: CaseRunner, model: str) -> float:
    return _AMPLIFIER_RUN.error_over_bound(runner, 10 * _STEP_S)


def _modulator(runner: CaseRunner, model: str) -> float:
    return _ring_run().error(runner, _RING_STEP_S)


def _modulator_bound(runner: CaseRunner, model: str) -> float:
    return _ring_run().error_over_bound(runner, 2 * _RING_STEP_S)


CASES = (
    HardCase(
        "transistor amplifier, published solution", 61, "largest error, mixed norm", 0.0, {"spice": 1e-5},
        "trapezoids of 2 us on junctions of 80 Ohm and 2 uF: (h/tau)^2/12 = 1.3e-5 of what moves so fast",
        _amplifier, broken="currents of sources 1 % too large: 6.7e-5",
    ),
    HardCase(
        "transistor amplifier, bound of a twin", 61, "error over bound", 0.0, {"spice": 1.0},
        "half the step is a twin as that of a run: its bound is not below the error", _amplifier_bound,
        broken="OWN_MARGIN 1.0 instead of 2.5: 1.34",
    ),
    HardCase(
        "ring modulator, published solution", 61, "largest error, mixed norm", 0.0, {"spice": 1e-3},
        "the issue's own; trapezoids of 1.2 ns on 3e7 rad/s: (0.04)^2/12 of a phase", _modulator, slow=True,
        broken="currents of sources 3 % too large: 6.6e-3",
    ),
    HardCase(
        "ring modulator, bound of a twin", 61, "error over bound", 0.0, {"spice": 1.0},
        "half the step is a twin as that of a run: its bound is not below the error", _modulator_bound,
        slow=True, broken="OWN_MARGIN 0.5 instead of 2.5: 1.91",
    ),
)  # fmt: skip
