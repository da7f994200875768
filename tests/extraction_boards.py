"""Small boards for the tests of extraction, and what ngspice says of them without it."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cosim.circuits.linear_circuit import LinearCircuit, channel_names
from cosim.ngspice.child import Child, call, start_early
from cosim.ngspice.deck import Deck, load_deck
from cosim.ngspice.simulator import Simulator

NETLISTS = Path(__file__).parents[1] / "netlists"

_HEAD = """* board of one joint, every stage a formula
.param v_fs=10
.param dac_v=10
.csparam v_fs={v_fs}
.csparam dac_v={dac_v}
.subckt mul x y w
vpx x xi 0
vpy y yi 0
vpz zi 0 0
Bw w 0 V=v(xi)*v(yi)/10+v(zi)
.ends mul
"""
_PINS = ".subckt board pot1 vel1 u1 ksp11 ksd11 cmd1 imot1 vcc vee\n"
#: Spring: X = u - pot. Damper: X of a differentiator with a corner at 1000 rad/s. Output: the sum, 1 A/V.
SPRING = "Ex x 0 u1 pot1 1"
DAMPER = "Cy pot1 ya 1u\nRy ya 0 1k\nEy y 0 0 ya 1"
MULTIPLIERS = "xs x ksp11 ws mul\nxd y ksd11 wd mul"
SUM = "Bi imot1 0 V=v(ws)+v(wd)+v(cmd1)-0.01*v(vel1)"


def board(folder: Path, *, spring: str = SPRING, damper: str = DAMPER, multipliers: str = MULTIPLIERS,
          output: str = SUM, top: str = "", overrides: Mapping[str, str] | None = None) -> Deck:  # fmt: skip
    """A board of one joint from the lines of its stages."""
    path = folder / "board.cir"
    path.write_text(
        _HEAD + top + "\n" + _PINS + "\n".join([spring, damper, multipliers, output, ".ends board"]) + "\n"
    )
    return load_deck(path, overrides=overrides)


def shipped(joints: int, level: str, driver: str = "voltage", **more: Any) -> Deck:
    """One of the boards that come with the program, all parts at one level."""
    return load_deck(
        NETLISTS / f"board{joints}.cir",
        levels={
            "opamp": level,
            "vca": level,
            "driver": driver,
            "driver_level": level,
            "motor": "emf" if level == "ideal" else "full",
            "potentiometer": "full" if level == "full" else "ideal",
        },
        **more,
    )


_child: list[Child] = []


def in_child(target: str, payload: Mapping[str, Any], on_progress: Callable[..., None] | None = None) -> Any:
    """Call a function in a process that all tests share; a failed call ends it."""
    if not _child:
        _child.append(start_early("cosim.circuits.extraction.extract"))
    try:
        return call(target, dict(payload), child=_child[0], time_limit_s=120.0, on_progress=on_progress)
    except Exception:
        _child.clear()
        raise


def extract(deck: Deck, model: str = "linear", **more: Any) -> LinearCircuit:
    """Extract without the cache, unreduced unless asked for."""
    payload = {"board": deck, "model": model, "band_hz": 0.0, "tolerance": 0.0, "cache": False} | more
    circuit = in_child("cosim.circuits.extraction.extract:extract", payload)
    assert isinstance(circuit, LinearCircuit)
    return circuit


def entire_board(payload: dict[str, Any], report: Any) -> tuple[NDArray[np.float64], NDArray[np.complex128]]:
    """In a child: imot_i of the whole board in one `.ac`, a pin driven, the others at given voltages.

    The deck is written out here; nothing of the extraction is used.
    """
    deck: Deck = payload["board"]
    volts: dict[str, float] = payload["volts"]
    driven: str = payload["driven"]
    lines = ["whole board", *deck.text.splitlines()[1:], f"Xboard {' '.join(deck.pins)} {deck.board}"]
    supplies = {"vcc": 15.0, "vee": -15.0}
    for pin in deck.pins:
        if not pin.startswith("imot"):
            held = supplies.get(pin, volts.get(pin, 0.0))
            lines.append(f"V_{pin} {pin} 0 dc {held!r} ac {int(pin == driven)}")
    simulator = Simulator()
    simulator.load("\n".join([*lines, ".end"]) + "\n", lines=deck.lines)
    simulator.command("ac " + payload.get("sweep", "dec 31 0.1 100meg"))
    outputs = [np.asarray(simulator.vector(f"imot{i + 1}"), complex) for i in range(deck.joints)]
    return np.real(simulator.vector("frequency")), np.stack(outputs, axis=1)


def step_response(payload: dict[str, Any], report: Any) -> NDArray[np.float64]:
    """In a child: time and imot1 [points, 2] of a transient in which pins follow the given source lines."""
    deck: Deck = payload["board"]
    sources: dict[str, str] = payload["sources"]
    lines = ["step", *deck.text.splitlines()[1:], f"Xboard {' '.join(deck.pins)} {deck.board}"]
    supplies = {"vcc": "15", "vee": "-15"}
    for pin in deck.pins:
        if not pin.startswith("imot"):
            lines.append(f"V_{pin} {pin} 0 {supplies.get(pin, sources.get(pin, '0'))}")
    lines += [
        ".options reltol=1e-7 abstol=1e-15 vntol=1e-12 chgtol=1e-20 method=gear",
        ".save v(imot1)",
        ".end",
    ]
    simulator = Simulator()
    simulator.load("\n".join(lines) + "\n", lines=deck.lines)
    simulator.command(payload["tran"])
    return np.stack(
        [np.asarray(simulator.vector("time"), float), np.asarray(simulator.vector("imot1"), float)], axis=1
    )


#: Values of the shipped board that random boards change, by driver.
_VALUES = {
    "r_diff_in": 10e3, "r_diff_fb": 169e3, "c_der_in": 1e-6, "r_der_fb": 100e3, "r_der_in": 1.58e3,
    "c_der_fb": 1e-9, "r_sum_fb": 10e3, "r_sum_spring": 24.3e3, "r_sum_damper": 6.19e3, "r_sum_cmd": 20e3,
    "motor_r": 5.0, "motor_l": 1.5e-3,
}  # fmt: skip
_DRIVERS = {
    "voltage": {"r_drv_in": 10e3, "r_drv_fb": 20e3},
    "current": {"r_drv_in": 13.7e3, "r_drv_fb": 2.8e3, "r_sense": 0.511, "rc_drv": 124e3, "cc_drv": 2.2e-9},
}


def random_board(seed: int) -> Deck:
    """Board of one joint: resistors, capacitors times 10^U(-1, 1), bandwidths 1e4 to 1e8 Hz."""
    rng = np.random.default_rng(seed)
    driver = ("voltage", "current")[seed % 2]
    values = {name: repr(v * 10 ** rng.uniform(-1, 1)) for name, v in (_VALUES | _DRIVERS[driver]).items()}
    for name in ("tl072_gbw", "opa548_gbw", "ad633_bw"):
        values[name] = repr(10 ** rng.uniform(4, 8))
    return shipped(1, ("gbw", "gbw", "full")[seed % 3], driver, overrides=values)


def networks_and_truth(payload: dict[str, Any], report: Any) -> list[Any]:
    """In a child: networks fitted to the usual sweep, and all paths at other frequencies, for each board."""
    from cosim.circuits.extraction.measured_model import SWEEP, networks
    from cosim.circuits.extraction.path_measurement import Session

    rows = []
    for deck in payload["boards"]:
        session = Session(deck)
        rows.append((networks(session.measure(SWEEP), str(deck.path)), session.measure("dec 31 0.1 100meg")))
    return rows


#: Stated for the unreduced model: 1e-9 of the path's maximum from 0.1 Hz to 100 MHz.
STATED = 1e-9


def differences(deck, circuit, volts):
    """Largest error of each driven pin's path to each motor against one `.ac` of the whole board."""
    n = deck.joints
    pins = [f"{kind}{j + 1}" for kind in ("pot", "u", "cmd", "vel") for j in range(n)]
    held = dict(zip(channel_names(n), volts.tolist(), strict=True))
    worst = []
    for k, pin in enumerate(pins):
        hz, truth = in_child("extraction_boards:entire_board", {"board": deck, "volts": held, "driven": pin})
        mine = circuit.response(2j * np.pi * hz, volts)[:, :, k]
        peak = np.abs(truth).max(axis=0)
        worst.append(float((np.abs(mine - truth).max(axis=0) / np.where(peak > 1e-12, peak, 1.0)).max()))
    return np.array(worst)
