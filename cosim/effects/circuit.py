"""Effects of the circuit: the levels of its parts."""

from __future__ import annotations

from cosim.effects.effect import ALL, DYNAMIC, Effect
from cosim.scene import Scene


def _opamp(scene: Scene) -> str:
    return "53 ns at 3 MHz times noise gain, 1 us in the difference amplifier; slew and rails at level full"


def _vca(scene: Scene) -> str:
    return "0.16 us at 1 MHz; level full: 2 % of full scale total error (AD633 data sheet)"


def _driver(scene: Scene) -> str:
    return "0.16 us at 1 MHz times noise gain; slew, rails and current limit at level full"


def _motor(scene: Scene) -> str:
    return "L/R = 0.3 ms; back-EMF kt^2 gear^2 / R = 0.02 N m s/rad at a joint"


def _drive(scene: Scene) -> str:
    return "voltage drive brakes with kt² gear²/R; current drive does not, and has no L/R lag"


def _track(scene: Scene) -> str:
    return "up to 2.6 kΩ of track and wiper before the follower: no load, no error"


#: In the order in which a plan lists them.
CIRCUIT = (
    Effect(
        "opamp",
        "ideal",
        ("gbw", "full"),
        "netlist",
        DYNAMIC,
        "one state an op-amp (gbw), three (full)",
        _opamp,
    ),
    Effect(
        "vca",
        "ideal",
        ("gbw", "full"),
        "netlist",
        DYNAMIC,
        "one state a multiplier, n^2 springs and dampers",
        _vca,
    ),
    Effect(
        "driver_level",
        "ideal",
        ("gbw", "full"),
        "netlist",
        DYNAMIC,
        "one state a driver (gbw), two (full)",
        _driver,
    ),
    Effect(
        "motor",
        "ideal",
        ("full", "emf"),
        "netlist",
        ALL,
        "back-EMF couples speeds; full adds one state a motor",
        _motor,
        at_full=DYNAMIC,
    ),
    Effect("driver", "voltage", ("current",), "netlist", ALL, "one state for its compensation", _drive),
    Effect("potentiometer", "ideal", ("full",), "netlist", ALL, "track and wiper resistance", _track),
)
