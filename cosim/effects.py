"""Effects: what a scene may switch on, where it lives, and what it costs when it is there.

An effect is asked for, or it is not there. `in_force` and `left_out` are what `cosim plan` prints; the
levels of the netlist's parts follow from them, nothing else picks a level.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from cosim.errors import InputError, Problem
from cosim.scene import CircuitModelName, Scene


@dataclass(frozen=True)
class Effect:
    """One effect of `[effects]`.

    Attributes
    ----------
    name : key in `[effects]`
    null : its null form, as the scene spells it
    on : what it can be instead, the usual value first
    home : where it lives ('netlist', 'linkage', 'computer', 'potentiometer')
    models : circuit models that can carry it below its level `full`, where it has levels
    cost : what it adds where it is in force, in words
    at_full : circuit models that can carry its level `full`
    size : a-priori size, as a function of the scene, in words with a number and its source
    """

    name: str
    null: str | bool
    on: tuple[str | bool, ...]
    home: str
    models: frozenset[str]
    cost: str
    size: Callable[[Scene], str]
    at_full: frozenset[str] = frozenset({"spice"})

    def value(self, scene: Scene) -> Any:
        """Return the setting of the scene: a word or a truth value."""
        value = getattr(scene.effects, self.name)
        return getattr(value, "value", value)

    def carriers(self, scene: Scene) -> frozenset[str]:
        """Return the circuit models that can carry the scene's setting."""
        if not self.is_in_force(scene):
            return _ALL
        return self.at_full if self.value(scene) == "full" else self.models

    def is_in_force(self, scene: Scene) -> bool:
        """Whether the scene asks for more than the null form."""
        return bool(self.value(scene) != self.null)


_ALL = frozenset({"ideal", "linear", "spice"})
_DYNAMIC = frozenset({"linear", "spice"})


def _opamp(scene: Scene) -> str:
    return "53 ns at 3 MHz times noise gain, 1 us in the difference amplifier; slew and rails at level full"


def _driver(scene: Scene) -> str:
    return "0.16 us at 1 MHz times noise gain; slew, rails and current limit at level full"


def _drive(scene: Scene) -> str:
    return "voltage drive brakes with kt² gear²/R; current drive does not, and has no L/R lag"


def _track(scene: Scene) -> str:
    return "up to 2.6 kΩ of track and wiper before the follower: no load, no error"


def _vca(scene: Scene) -> str:
    return "0.16 us at 1 MHz; level full: 2 % of full scale total error (AD633 data sheet)"


def _motor(scene: Scene) -> str:
    return "L/R = 0.3 ms; back-EMF kt^2 gear^2 / R = 0.02 N m s/rad at a joint"


def _pot(scene: Scene) -> str:
    rad = scene.device.potentiometer.noise_rad
    k = scene.computer.analog_stiffness_n_per_m
    return f"{rad * 0.1333 * 1e3:.2g} mm and {rad * 0.1333 * k:.2g} N at a reach of 133 mm"


def _encoder(scene: Scene) -> str:
    encoder = scene.computer.encoder
    step = 6.283185307 / (encoder.pulses_per_rev * encoder.decoding)
    return f"{step * 1e3 / 8:.3g} mrad at the joint with a gear of 8"


def _dac(scene: Scene) -> str:
    return "1.45 mrad a step of u at 12 bits and ±10 V; settling and skew as stated"


def _delay(scene: Scene) -> str:
    lag = (scene.computer.delay_periods + scene.computer.delay_fraction) * scene.computer.period_s
    return f"{lag * 1e3:.3g} ms: passivity needs K t_d more damping (Colgate and Schenkel, with delay)"


def _gravity(scene: Scene) -> str:
    device = scene.device
    mass = sum(device.chain.masses_kg) if device.chain else device.slider.mass_kg if device.slider else 0.0
    return f"{mass * 9.81:.2g} N of weight"


def _coriolis(scene: Scene) -> str:
    return "m l v²/r², a few mN at 0.1 m/s"


def _viscous(scene: Scene) -> str:
    return "bearings only, as stated in viscous_n_m_s"


def _coulomb(scene: Scene) -> str:
    device = scene.device
    torque = (
        max(device.chain.coulomb_n_m) if device.chain else device.slider.coulomb_n_m if device.slider else 0.0
    )
    return f"{torque / 0.1333:.2g} N at a reach of 133 mm"


#: Every effect, in the order in which a plan lists them.
EFFECTS = (
    Effect(
        "opamp",
        "ideal",
        ("gbw", "full"),
        "netlist",
        _DYNAMIC,
        "one state an op-amp (gbw), three (full)",
        _opamp,
    ),
    Effect(
        "vca",
        "ideal",
        ("gbw", "full"),
        "netlist",
        _DYNAMIC,
        "one state a multiplier, n^2 springs and dampers",
        _vca,
    ),
    Effect(
        "driver_level",
        "ideal",
        ("gbw", "full"),
        "netlist",
        _DYNAMIC,
        "one state a driver (gbw), two (full)",
        _driver,
    ),
    Effect(
        "motor",
        "ideal",
        ("full", "emf"),
        "netlist",
        _ALL,
        "back-EMF couples speeds; full adds one state a motor",
        _motor,
        at_full=_DYNAMIC,
    ),
    Effect("driver", "voltage", ("current",), "netlist", _ALL, "one state for its compensation", _drive),
    Effect("potentiometer", "ideal", ("full",), "netlist", _ALL, "track and wiper resistance", _track),
    Effect(
        "pot_noise",
        "none",
        ("white", "peak_to_peak", "static", "position"),
        "potentiometer",
        _ALL,
        "one point each 1 / (2 bandwidth)",
        _pot,
    ),
    Effect("encoder", False, (True,), "computer", _ALL, "nothing", _encoder),
    Effect("dac", False, (True,), "computer", _ALL, "one point a sample when settling", _dac),
    Effect("delay", False, (True,), "computer", _ALL, "one restart a sample when fractional", _delay),
    Effect("gravity", False, (True,), "linkage", _ALL, "nothing", _gravity),
    Effect("coriolis", False, (True,), "linkage", _ALL, "nothing", _coriolis),
    Effect("viscous", False, (True,), "linkage", _ALL, "nothing", _viscous),
    Effect("coulomb", False, (True,), "linkage", _ALL, "short steps near rest", _coulomb),
)


def in_force(scene: Scene) -> list[dict[str, Any]]:
    """List what the scene asks for, JSON-ready: name, value, home, cost, size."""
    return [_row(effect, scene) for effect in EFFECTS if effect.is_in_force(scene)]


def left_out(scene: Scene) -> list[dict[str, Any]]:
    """List what the scene leaves in its null form, JSON-ready, with its a-priori size."""
    return [_row(effect, scene) for effect in EFFECTS if not effect.is_in_force(scene)]


def _row(effect: Effect, scene: Scene) -> dict[str, Any]:
    return {
        "name": effect.name,
        "value": effect.value(scene),
        "home": effect.home,
        "models": sorted(effect.carriers(scene)),
        "cost": effect.cost,
        "size": effect.size(scene),
    }


def circuit_model(scene: Scene) -> str:
    """Return the circuit model that the scene forces, or the cheapest that carries its effects.

    Nodes inside the board exist in `spice` only.

    Raises
    ------
    InputError
        When the forced model cannot carry an effect in force, or a node to be recorded; all at once.
    """
    forced = scene.solver.model
    file = str(scene.file) if scene.file else None
    if forced is CircuitModelName.AUTO:
        for model in ("ideal", "linear"):
            if not scene.record.nodes and all(model in effect.carriers(scene) for effect in EFFECTS):
                return model
        return "spice"
    problems = [
        Problem(
            f"the model {forced.value} cannot carry this effect",
            file=file,
            key=f"effects.{effect.name}",
            value=effect.value(scene),
            allowed=f"{effect.null}, or the model {' or '.join(sorted(effect.carriers(scene)))}",
        )
        for effect in EFFECTS
        if forced.value not in effect.carriers(scene)
    ]
    if forced is not CircuitModelName.SPICE and scene.record.nodes:
        nodes = ", ".join(scene.record.nodes)
        problems.append(
            Problem(
                "nodes inside the board exist in the model spice only",
                file=file,
                key="record.nodes",
                value=nodes,
            )
        )
    if problems:
        raise InputError(problems)
    return forced.value


def levels(scene: Scene) -> dict[str, str]:
    """Return the levels of the netlist's parts by role, as `load_deck` takes them."""
    effects = scene.effects
    return {
        "opamp": effects.opamp.value,
        "vca": effects.vca.value,
        "driver": effects.driver.value,
        "driver_level": effects.driver_level.value,
        "motor": effects.motor.value,
        "potentiometer": effects.potentiometer.value,
    }
