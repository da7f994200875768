"""What a run will be, before it runs: effects, circuit model, deck, cost."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

from cosim import effects, plausibility
from cosim.caution import Caution, collected, warn
from cosim.circuits import cache
from cosim.circuits.decks import MOST_NODES, Drive, Tolerances
from cosim.circuits.design_constants import Stated
from cosim.circuits.extraction.design_numbers import kept
from cosim.effects.idle_keys import forgotten, stated_in_vain
from cosim.effects.prediction import predict
from cosim.errors import InputError, Problem, fail
from cosim.loop.dac_channels import drive
from cosim.measures import check_names, tolerances
from cosim.ngspice.child import Child, call
from cosim.ngspice.deck import Deck, load_deck
from cosim.ngspice.expression_names import is_name
from cosim.ngspice.parts import PartSwap
from cosim.scene import Method, PartFile, Scene


@dataclass(frozen=True)
class Plan:
    """A resolved scene, ready to run.

    Attributes
    ----------
    scene, board : the scene and the flattened netlist
    model : circuit model that carries its effects
    circuit : pins that are driven
    tolerances : ngspice's error control
    recorded : nodes written at every point; watched : nodes of which the peak is kept
    choice : how the effects were chosen, JSON-ready, where they were (``effects = "auto"``)
    cautions : what is doubtful about scene and board before anything runs
    trust : whether control blocks and file access may pass

    Examples
    --------
    >>> from cosim.assets import scenes_folder
    >>> from cosim.scene import load_scene
    >>> plan = resolve(load_scene(scenes_folder() / 'slope.toml', ['solver.model=spice']))
    >>> plan.model, plan.board.joints
    ('spice', 2)
    """

    scene: Scene
    board: Deck
    model: str
    circuit: Drive
    tolerances: Tolerances
    recorded: tuple[str, ...]
    watched: tuple[str, ...]
    choice: Mapping[str, Any] = field(default_factory=dict)
    cautions: tuple[Caution, ...] = ()
    trust: bool = False
    _asked: dict[str, Stated] = field(default_factory=dict, repr=False, compare=False)

    def stated(self, child: Child | None = None) -> Stated:
        """Return the design constants that the board states, read by ngspice once a deck, in a child.

        Raises
        ------
        InputError
            For a board that ngspice does not accept, or that lacks a design constant.
        """
        if "stated" not in self._asked:
            known = kept(self.board)
            if known is None:
                known = call(
                    "cosim.circuits.extraction.design_numbers:read",
                    {"board": self.board},
                    time_limit_s=self.scene.solver.time_limit_s,
                    deck=str(self.board.path),
                    child=child,
                )
            self._asked["stated"] = known
        return self._asked["stated"]

    def cost(self) -> dict[str, float]:
        """Predicted points and seconds; see `cosim.effects.prediction.predict`."""
        return predict(self.scene, self.stated(), self.model)

    def extracted(self, child: Child | None = None) -> None:
        """Extract the model `ideal` or `linear`, and with it its order; from the cache if it is there."""
        if self.model != "spice":
            call(
                "cosim.circuits.extraction.extract:extract",
                self._asked_of_board(),
                time_limit_s=self.scene.solver.time_limit_s,
                deck=str(self.board.path),
                child=child,
            )

    def _asked_of_board(self) -> dict[str, Any]:
        solver = self.scene.solver
        return {
            "board": self.board,
            "model": self.model,
            "band_hz": solver.band_hz,
            "tolerance": solver.reduction_tolerance,
        }

    def circuit_states(self) -> int | None:
        """Return the number of the circuit's states; ``None`` for a model that was not extracted yet."""
        if self.model == "spice":
            return self.board.reactances
        if self.model == "ideal":
            return 0
        solver = self.scene.solver
        asked = cache.Asked(self.board.text, self.model, solver.band_hz, solver.reduction_tolerance)
        circuit, _ = cache.load(asked)
        return None if circuit is None else circuit.order

    def _unseen(self) -> list[str]:
        if self.model == "spice":
            return []
        return [f"amplifiers have no outputs in the model {self.model}: headroom needs the model spice"]

    def _unused(self) -> list[str]:
        return (
            ["tolerance is of no use: the effects are stated, not auto"]
            if self.scene.tolerance.measures
            else []
        )

    def as_dict(self) -> dict[str, Any]:
        """JSON-ready, as `cosim plan` prints it and every result stores it."""
        return {
            "model": self.model,
            "board": self.board.board,
            "joints": self.board.joints,
            "deck_digest": self.board.digest,
            "amplifiers": len(self.board.amplifiers),
            "external_sources": self.circuit.sources(),
            "effects": effects.in_force(self.scene, self.stated()),
            "left_out": effects.left_out(self.scene, self.stated()),
            "mechanical_states": 2 * self.scene.joints * (2 if self.scene.effects.shaft else 1),
            "circuit_states": self.circuit_states(),
            "predicted": self.cost(),
            **({"choice": self.choice} if self.choice else {}),
            "notes": [
                *self.board.notes,
                *slower_paths(self.scene),
                *self._unseen(),
                *self._unused(),
                *stated_in_vain(self.scene, effects.EFFECTS),
            ],
            "tolerances": self.tolerances.line(),
        }


def slower_paths(scene: Scene) -> list[str]:
    """Say in words what runs in Python instead of compiled code."""
    notes = []
    if scene.computer.law is not None:
        notes.append(f"control law {scene.computer.law} runs in Python, once per sample")
    if scene.operator.type == "python":
        notes.append(f"operator {scene.operator.file} runs in Python, about three times per time point")
    return notes


def _recorded(scene: Scene) -> tuple[str, ...]:
    """Return the nodes to be recorded, each once, without those that every run records."""
    nodes = tuple(dict.fromkeys(node.lower() for node in scene.record.nodes))
    if not nodes:
        return ()
    strange = [node for node in scene.record.nodes if not is_name(node)]
    if strange:
        file = scene.file_name
        raise InputError(
            Problem("is not the name of a node", file=file, key="record.nodes", value=node)
            for node in strange
        )
    from cosim.loop.columns import columns  # brings compiled code along, which a plan has no other need of

    known = columns(drive(scene), (), shafts=scene.effects.shaft)
    return tuple(node for node in nodes if node not in known)


def _placed(problem: Problem, scene: Scene) -> Problem:
    """Name the scene's file and key in what the loader says of a part that the scene swaps."""
    if problem.file is not None or problem.key not in scene.device.parts:
        return problem
    return replace(problem, file=scene.file_name, key=f"device.parts.{problem.key}")


def swaps(scene: Scene) -> dict[str, PartSwap | str]:
    """Return the replacements for parts of the shelf, as `load_deck` takes them."""
    return {
        name: PartSwap(part.file, part.subckt, part.pins, part.dialect.value)
        if isinstance(part, PartFile)
        else part
        for name, part in scene.device.parts.items()
    }


def resolve(scene: Scene, *, trust: bool = False, board: Deck | None = None) -> Plan:
    """Resolve a scene: choose the circuit model, flatten the board, decide what is driven.

    Parameters
    ----------
    scene
        What is asked for.
    trust
        Whether control blocks and file access may pass.
    board
        The scene's own board, from another plan with the same effects in the netlist.

    Raises
    ------
    InputError
        For a board that does not fit the scene, or effects that its model cannot carry.

    Examples
    --------
    >>> from cosim.assets import scenes_folder
    >>> from cosim.scene import load_scene
    >>> resolve(load_scene(scenes_folder() / 'slope.toml')).board.joints
    2
    """
    with collected() as cautions:
        plan = _resolved(scene, trust, board)
    return replace(plan, cautions=tuple(cautions))


def _resolved(scene: Scene, trust: bool, board: Deck | None) -> Plan:
    check_names(scene)
    tolerances(scene)
    _check_chosen(scene)
    effects.check(scene)
    try:
        board = board or _loaded(scene, trust, scene.device.values)
    except InputError as error:
        raise InputError(_placed(problem, scene) for problem in error.problems) from error
    if board.joints != scene.joints:
        fail(
            f"the board has {board.joints} joint(s), the linkage {scene.joints}",
            file=scene.file_name,
            key="device.board",
            value=str(scene.device.board),
        )
    _check_path(scene)
    model = effects.circuit_model(scene)
    warn(*plausibility.of_plan(scene, board, model, partial(_unedited, scene, trust)))
    warn(
        *(
            Caution("key-unused", text, "switch the effect on, state that it is off, or take the key out")
            for text in forgotten(scene, effects.EFFECTS)
        )
    )
    _check_stops(scene, model)
    solver = scene.solver
    recorded = _recorded(scene)
    watched: tuple[str, ...] = ()
    if model == "spice":
        watched = tuple(dict.fromkeys(a.out_node for a in board.amplifiers if a.out_node not in recorded))
    if len(recorded) + len(watched) > MOST_NODES:
        fail(
            f"too many nodes: {len(watched)} outputs of amplifiers are watched anyway",
            file=scene.file_name,
            key="record.nodes",
            value=f"{len(recorded)} nodes",
            allowed=f"<= {MOST_NODES - len(watched)}",
        )
    return Plan(
        scene=scene,
        board=board,
        model=model,
        circuit=drive(scene),
        tolerances=Tolerances(solver.rtol, solver.method.value, solver.charge_tolerance_c),
        recorded=recorded,
        watched=watched,
        trust=trust,
    )


def _loaded(scene: Scene, trust: bool, values: Mapping[str, str]) -> Deck:
    return load_deck(
        scene.device.board,
        levels=effects.levels(scene),
        parts=swaps(scene),
        overrides=values,
        features=effects.features(scene),
        temperature_c=effects.temperature_c(scene),
        trust=trust,
    )


def _unedited(scene: Scene, trust: bool) -> Deck:
    """Return the board as its files have it; cautions come from the edited one alone."""
    with collected(forward=False):
        return _loaded(scene, trust, {})


def _check_chosen(scene: Scene) -> None:
    """Refuse effects that are still to be chosen: the scene would run without any."""
    if scene.effects.auto:
        fail(
            "the effects are still to be chosen: `cosim run` does so and keeps the choice as scene.toml "
            "in its result; `cosim plan` shows what it would try",
            file=scene.file_name,
            key="effects",
            value="auto",
        )


def _check_path(scene: Scene) -> None:
    computer = scene.computer
    springless = computer.method is Method.DISCRETE or (
        computer.method is Method.COMBINED and computer.analog_stiffness_n_per_m == 0.0
    )
    if computer.law is None and computer.command_path.value == "u" and springless:
        fail(
            "with all spring gains zero u makes no torque; without an analog spring the path must be cmd",
            file=scene.file_name,
            key="computer.command_path",
            value="u",
            allowed="cmd",
        )


def _check_stops(scene: Scene, model: str) -> None:
    kind = scene.device.linkage.value
    table = scene.device.chain if kind == "chain" else scene.device.slider
    if table is None or table.stop_restitution is None or not scene.effects.end_stops:
        return
    reason = "there is no stop: give stops_rad" if not table.stops_rad else ""
    if model == "spice":
        reason = "the model spice does not locate impacts: leave it out, or use the models ideal or linear"
    if reason:
        file, key = scene.file_name, f"device.{kind}.stop_restitution"
        fail(reason, file=file, key=key, value=table.stop_restitution)
