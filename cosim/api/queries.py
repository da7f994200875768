"""Answers without a run: about a held contact, a device, a board."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, TypeAlias

from cosim.api.python_warnings import doubts
from cosim.caution import warn
from cosim.plan import Plan, resolve
from cosim.scene import PotNoise
from cosim.scene.load import SceneLike, load_scene
from cosim.variants import Setting, variants

if TYPE_CHECKING:  # each function imports what it needs: stability does not need the check of a board
    from cosim.analysis.held_contact import HeldContact
    from cosim.analysis.noise_covariance import NoiseCovariance
    from cosim.analysis.stiffness_limits import Limits
    from cosim.checking.check import Check
    from cosim.checking.check_target import Subject
    from cosim.circuits.design_constants import DesignConstants
    from cosim.circuits.linear_circuit import LinearCircuit
    from cosim.ngspice.child import Child
    from cosim.studies.device import DeviceNumbers

__all__ = ["Contact", "Noise", "check", "contact", "device", "noise", "stability"]


@dataclass(frozen=True)
class Contact:
    """A planned scene with what theory needs of its board: the linear circuit, all poles, and constants."""

    plan: Plan
    circuit: LinearCircuit
    constants: DesignConstants

    def held(self) -> HeldContact:
        """Return it with the tip on the wall's point.

        Raises
        ------
        InputError
            Without a wall, or where it is out of reach.
        """
        from cosim.analysis.held_contact import HeldContact

        return HeldContact.at_wall(self.plan.scene, self.constants, self.circuit)


#: What the theory of a held contact takes.
ContactLike: TypeAlias = SceneLike | Plan | Contact


@dataclass(frozen=True)
class Noise:
    """Noise of a held contact, without sampling.

    Attributes
    ----------
    potentiometers : exact second moments under their noise; None where the scene has none
    components_rms_n : force [N] of the board's components along the normal; None without that effect
    components_up_to_hz : band [Hz] in which the components are counted
    """

    potentiometers: NoiseCovariance | None
    components_rms_n: float | None
    components_up_to_hz: float

    def as_dict(self) -> dict[str, Any]:
        """Return every figure, JSON-ready, with the unit at the end of its name."""
        facts = self.potentiometers.as_dict() if self.potentiometers is not None else {}
        if self.components_rms_n is not None:
            facts["component_noise_bandwidth_hz"] = self.components_up_to_hz
            facts["component_force_noise_rms_n"] = self.components_rms_n
        return facts


def contact(scene: ContactLike, *, trust: bool = False, child: Child | None = None) -> Contact:
    """Return a scene's plan, linear circuit and constants; ngspice is asked once for a board.

    Raises
    ------
    InputError
        For a board that ngspice does not accept, or a scene that does not fit it.

    Examples
    --------
    >>> from cosim.assets import scenes_folder
    >>> contact(scenes_folder() / "press.toml").circuit.joints
    2
    """
    if isinstance(scene, Contact):
        return scene
    from cosim.analysis.board_range import of_asked
    from cosim.analysis.extracted import circuit_of
    from cosim.plausibility import of_circuit

    planned = scene if isinstance(scene, Plan) else resolve(load_scene(scene), trust=trust)
    circuit, constants = circuit_of(planned, child=child)
    warn(*of_asked(planned.scene, constants), *of_circuit(circuit, constants))
    return Contact(planned, circuit, constants)


def stability(scene: ContactLike, *, trust: bool = False, child: Child | None = None) -> Limits:
    """Return how stiff the scene's wall may be: exact border, modes, largest passive stiffness.

    The contact is held at the wall's point; eigenvalues are those of the map of one sampling period
    (`cosim.analysis.stability`), passivity is Colgate and Schenkel's with the device's dynamics.

    Raises
    ------
    InputError
        For a scene without a wall, or with a law or an operator in Python.

    Examples
    --------
    >>> from cosim.assets import scenes_folder
    >>> theory = stability(scenes_folder() / "press.toml")
    >>> theory.stability.stable, theory.border.value > theory.stiffness  # N/m
    (True, True)
    """
    from cosim.analysis.stiffness_limits import limits

    with doubts():
        return limits(contact(scene, trust=trust, child=child).held())


def noise(scene: ContactLike, *, trust: bool = False, child: Child | None = None) -> Noise:
    """Return rms force [N] and jitter [m, rad] of a held contact exactly, without a run.

    Raises
    ------
    InputError
        Where scene or noise are not linear about the contact, with the reason; and where there is no noise.

    Examples
    --------
    >>> from cosim.assets import scenes_folder
    >>> from cosim.scene import load_scene
    >>> quiet = load_scene(scenes_folder() / "press.toml")
    >>> loud = quiet.with_values({"effects.pot_noise": "white", "device.potentiometer.noise_rad": 1e-5})
    >>> half = loud.with_values({"device.potentiometer.noise_rad": 5e-6})
    >>> force = [noise(each).as_dict()["force_noise_rms_n"] for each in (loud, half)]
    >>> round(force[0] / force[1], 9)
    2.0
    """
    from cosim.analysis.noise_covariance import noise_covariance
    from cosim.analysis.tip_noise import component_force

    with doubts():
        here = contact(scene, trust=trust, child=child)
        scene, effects = here.plan.scene, here.plan.scene.effects
        covariance = rms = None
        if effects.pot_noise is not PotNoise.NONE or not effects.component_noise:
            covariance = noise_covariance(here.held())
        if effects.component_noise:
            rms = component_force(scene, here.plan.board, child)
        return Noise(covariance, rms, scene.device.component_noise_bandwidth_hz)


def device(scene: ContactLike, *, trust: bool = False, child: Child | None = None) -> DeviceNumbers:
    """Return the four numbers of a device: force [N], stiffness [N/m], damping [N s/m] and workspace [m].

    Raises
    ------
    InputError
        For a scene without a wall, with a law or an operator in Python, or of more than two joints.

    Examples
    --------
    >>> from cosim.assets import scenes_folder
    >>> rating = device(scenes_folder() / "press.toml")
    >>> rating.as_dict()["model"], rating.as_dict()["continuous_n"] > 0
    ('linear', True)
    """
    from cosim.studies.device import device_numbers

    with doubts():
        return device_numbers(contact(scene, trust=trust, child=child).held())


def check(
    target: SceneLike | Subject,
    values: Mapping[str, Any] | None = None,
    *,
    level: str | None = None,
    driver: str | None = None,
    trust: bool = False,
    child: Child | None = None,
) -> Check:
    """Measure a board in ngspice and judge it: constants, headroom, loop margins, delays, noise.

    Parameters
    ----------
    target
        Scene, scene file (``.toml``), board netlist (``.cir``), or what `load_subject` has made of one.
    values
        Other values: name of the netlist, or with a scene also of its keys -> value.
    level
        'ideal', 'gbw' or 'full' for all parts, instead of the scene's effects; 'full' for a board.
    driver
        'voltage' or 'current'; the scene's, or 'voltage' for a board.

    Raises
    ------
    InputError
        When ngspice does not accept the board: syntax, floating node, no operating point.

    Examples
    --------
    >>> from cosim.assets import netlists_folder
    >>> judged = check(netlists_folder() / "board1.cir")
    >>> judged.subject.board.joints, judged.as_dict()["problems"]
    (1, 0)
    """
    from cosim.checking.check import check as measured
    from cosim.checking.check_target import Subject, load_subject

    with doubts():
        if not isinstance(target, Subject):
            settings = [Setting.of(name, [value]) for name, value in (values or {}).items()]
            variant = variants(settings)[0]
            target = load_subject(target, variant, level, driver, trust=trust)
        return measured(target, child=child)
