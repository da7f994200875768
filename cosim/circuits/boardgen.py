"""Write a board netlist for n joints from the shipped blocks.

The board is the paper's Fig. 3: a difference amplifier, differentiator, summing amplifier and driver per
joint, a spring and a damper multiplier per pair of joints. ``netlists/board1.cir`` and ``board2.cir`` are
this module's output.
"""

from __future__ import annotations

from itertools import product
from pathlib import Path

from cosim.errors import fail

JOINTS = range(1, 7)
"""Joint counts a board can be written for."""

_LINE = 110

_HEAD = """\
* Board for {n} joint{s}: continuous impedance display (Kawai and Yoshikawa 2004, Fig. 3).
* Written by `cosim new --joints {n}`; edit freely, the pins are all that the software relies on.
*
* potj         V, 1 V/rad         angle the potentiometer of joint j sees
* velj         V, 1 V per rad/s   speed of motor j (gear times joint speed), for the back-EMF
* uj           V                  equilibrium of joint j, v_rad per rad
* kspij ksdij  V                  gain of the spring / damper from joint j to motor i, v_fs = full scale
* cmdi         V                  direct torque command, v_nm per N m at the joint
* imoti        V, 1 V/A           current of motor i, output; positive drives joint i positively
* vcc vee      V                  supplies, +-15 V
*
* Parts (tl072, ad633, opa548, motor, potentiometer) and the driver (voltage or current) are chosen outside.
"""

_CONSTANTS = """\
* Design constants: what the computer believes. Plain numbers on purpose: an edited resistor changes what is
* rendered, not these. g_m = 0.4 A/V is the driver: r_drv_fb/r_drv_in/motor_r, or r_drv_fb/r_drv_in/r_sense.
.param v_rad=3.37034 $ V/rad at uj: 20 V/340 deg, as the potentiometer
.param v_fs=10 $ V at kspij, ksdij for full scale
.param k_fs=3.0003 $ N m/rad: v_rad*(r_diff_fb/r_diff_in)*(r_sum_fb/r_sum_spring)*g_m*kt*gear; 169 N/m
.param c_fs=0.06969 $ N m s/rad: v_rad*r_der_fb*c_der_in*(r_sum_fb/r_sum_damper)*g_m*kt*gear; 3.9 N s/m
.param v_nm=15.625 $ V at cmdi per N m at the joint: 1/((r_sum_fb/r_sum_cmd)*g_m*kt*gear)
.param kt=0.04 $ N m/A: assumption, 11 W iron-core motor (0.033-0.047); rated 35 mN m is 0.875 A
.param gear=8 $ motor turns per joint turn
.param i_rated=0.875 $ A, thermal: 0.035 N m/kt, 0.28 N m at the joint
.param i_limit=1.987 $ A, the driver's current limit
.param dac_v=10 $ V, the converters' range is +-dac_v
.param dac_bits=12 $ bit: a step of u is 1.45 mrad
.param w_rated=5.316 $ V at a multiplier's output for rated torque: i_rated/((r_sum_fb/r_sum_spring)*g_m)
.param r_tip=0.1333 $ m, reach at which figures per metre are quoted
"""

_NAMES = [line.split("=")[0].split()[1] for line in _CONSTANTS.splitlines() if line.startswith(".param")]
_BLOCKS = ("angle", "diffamp", "differentiator", "vca", "summer")


def pin_names(n: int) -> list[str]:
    """Return the pins of a board with ``n`` joints, in the order the generator writes them.

    Examples
    --------
    >>> pin_names(1)
    ['pot1', 'vel1', 'u1', 'ksp11', 'ksd11', 'cmd1', 'imot1', 'vcc', 'vee']
    """
    joints = [str(j) for j in range(1, n + 1)]
    pairs = [f"{i}{j}" for i, j in product(joints, joints)]
    groups = [("pot", joints), ("vel", joints), ("u", joints), ("ksp", pairs), ("ksd", pairs)]
    groups += [("cmd", joints), ("imot", joints)]
    return [name + index for name, indices in groups for index in indices] + ["vcc", "vee"]


def _column(j: int) -> list[str]:
    """Return joint j's amplifiers: what every motor needs of this joint, and what drives its own motor."""
    return [
        f"* joint {j}",
        f"xangle{j} pot{j} p{j} vcc vee angle",
        f"xdiff{j} u{j} p{j} x{j} vcc vee diffamp",
        f"xder{j} p{j} y{j} vcc vee differentiator",
        f"Rcmd{j} cmd{j} sum{j} {{r_sum_cmd}}",
        f"xsum{j} sum{j} drv{j} vcc vee summer",
        f"xdrv{j} drv{j} vel{j} imot{j} vcc vee driver",
    ]


def _pair(i: int, j: int) -> list[str]:
    """Return the spring and damper from joint j to motor i."""
    return [
        f"xksp{i}{j} x{j} ksp{i}{j} wsp{i}{j} vcc vee vca",
        f"Rsp{i}{j} wsp{i}{j} sum{i} {{r_sum_spring}}",
        f"xksd{i}{j} y{j} ksd{i}{j} wsd{i}{j} vcc vee vca",
        f"Rsd{i}{j} wsd{i}{j} sum{i} {{r_sum_damper}}",
    ]


def _continued(words: list[str]) -> list[str]:
    """Break a long netlist line with SPICE's ``+``."""
    lines = [""]
    for word in words:
        if len(lines[-1]) + len(word) >= _LINE:
            lines.append("+")
        lines[-1] = f"{lines[-1]} {word}".strip()
    return lines


def board_text(n: int) -> str:
    """Return the netlist of a board with ``n`` joints (1 to 6) as text.

    Raises
    ------
    InputError
        If ``n`` is outside 1 to 6.
    """
    if n not in JOINTS:
        fail("a board has 1 to 6 joints", key="joints", value=n, allowed="1 to 6")
    name = f"board{n}"
    indices = range(1, n + 1)
    lines = _HEAD.format(n=n, s="" if n == 1 else "s").splitlines()
    lines += ["", *_CONSTANTS.splitlines(), *(f".csparam {constant}={{{constant}}}" for constant in _NAMES)]
    lines += ["", *(f".include 'blocks/{block}.cir'" for block in _BLOCKS), ""]
    lines += _continued([".subckt", name, *pin_names(n)])
    for j in indices:
        lines += _column(j)
    for i, j in product(indices, indices):
        lines += ([f"* from joint 1..{n} to motor {i}"] if j == 1 else []) + _pair(i, j)
    return "\n".join([*lines, f".ends {name}"]) + "\n"


def write_board(n: int, path: Path) -> None:
    """Write the board with ``n`` joints to ``path``; its blocks are looked for in ``blocks/`` beside it."""
    path.write_text(board_text(n), encoding="utf-8")
