"""What varies of a scene's device, read from its netlist and from the scene's ``[tolerance]``."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

from cosim.circuits.extraction.alter import netlist
from cosim.errors import InputError, Problem, nearest
from cosim.ngspice.deck import Deck
from cosim.ngspice.expression import split
from cosim.ngspice.lines import number
from cosim.plan import resolve
from cosim.scene import Scene
from cosim.scene.layers import line_of
from cosim.scene.tolerance_table import Tolerance
from cosim.tolerance.distributions import Shape
from cosim.tolerance.eseries import preferred
from cosim.tolerance.grammar import Stated, Wrong, merged, parse
from cosim.tolerance.netlist_tolerances import Board, NetlistComponent, Param, Place, value_of
from cosim.tolerance.random_variables import Component, Tolerances
from cosim.tolerance.scene_numbers import Mechanical, numbers
from cosim.tolerance.value_expression import MOST_NEGATIVE, Recipe, Term

__all__ = ["Component", "Tolerances", "tolerances"]

_CLASSES = {"r": "resistors", "c": "capacitors", "l": "inductors"}
_UNITS = {"r": "Ohm", "c": "F", "l": "H", "v": "V", "i": "A"}
#: Suffix of a part's parameter behind the part's name -> its class in the scene's table.
_PART_CLASSES = {"gbw": "gbw", "vos": "offset", "vosin": "offset", "vosout": "offset", "scale": "vca_gain"}
#: Classes whose deviations are about zero.
_ABOUT_ZERO = ("offset", "vca_gain")
_K_T = "motor_k"
_KNOWN_UNITS = ("Hz", "Ohm", "V", "A", "F", "H", "%", "V/V", "V/s", "N m/A", "rad", "1/K")


def tolerances(scene: Scene | None, *, board: Deck | None = None, trust: bool = False) -> Tolerances:
    """Return what varies of a scene's device: by its netlist, and by the scene's ``[tolerance]``.

    Parameters
    ----------
    scene
        The scene; none: the board's own tolerances alone.
    board
        Its flat deck, where it is at hand.
    trust
        Whether control blocks and file access may pass, and files of histograms lie anywhere.

    Raises
    ------
    InputError
        With all that is wrong with the tolerances, each with file and line.
    """
    if board is None:
        if scene is None:
            raise ValueError("neither scene nor board")
        board = resolve(scene, trust=trust).board
    return _Reader(board, scene, trust).read()


class _Reader:
    """Collects components, random variables and problems."""

    def __init__(self, board: Deck, scene: Scene | None, trust: bool) -> None:
        self._deck, self._scene = board, scene
        self._inside = None if trust else (board.path.parent,)
        self._text = _text(scene)
        self._problems: list[Problem] = []
        self._variables: dict[str, int] = {}
        self._members: dict[str, list[tuple[str, str, int]]] = {}
        self._components: dict[str, Component] = {}
        self._used: set[str] = set()
        table = scene.tolerance if scene is not None else Tolerance()
        self._classes = self._of_scene(table.classes, "")
        self._named = self._of_scene(table.components, "components.")
        self._series = table.series
        self._roles = {part.name: part.role for part in board.parts}

    def read(self) -> Tolerances:
        """Return the tolerances, or raise with every problem."""
        board = Board(netlist(self._deck), self._deck.board, self._named, self._inside)
        seen: list[str] = []
        classes: set[str] = set()
        for place in board.components():
            seen += [place.key, place.key.rpartition(":")[2].rpartition(".")[2]]
            classes.add(self._add(place))
        for each in numbers(self._scene) if self._scene is not None else ():
            seen.append(each.path)
            classes.add(self._add_mechanical(each))
        self._used |= board.used
        self._unknown([*board.top, *seen])
        self._alone()
        self._problems = [*board.problems, *self._problems]
        if self._problems:
            raise InputError(self._problems)
        idle = tuple(name for name in self._classes if name not in classes)
        return Tolerances(tuple(self._components.values()), tuple(self._variables), idle)

    def _add(self, written: NetlistComponent) -> str:
        """Take a component of the board, if it varies; return its class."""
        param, kind = written.value, self._class(written)
        default = self._classes.get(kind)
        if written.kind == ":" and written.key in self._named:
            self._used.add(written.key)
            param = replace(param, stated=self._named[written.key])
        by_class = default is not None and not _outermost(param)
        if default is not None and by_class:
            lot = param.name if written.kind == ":" else f"{kind} of {param.text}"
            param = replace(param, stated=self._about_percent(default, kind), name=lot)
        if written.network is not None and param.stated is not None and not param.stated.match:
            param = replace(param, stated=merged(written.network, param.stated))
        origin = _outermost(param)
        if not origin or written.key in self._components:
            return kind
        recipe = self._recipe(written, param, kind)
        if recipe is not None:
            place = origin[0].place
            where = self._scene_place(kind) if by_class else (place.file, place.line)
            names = (written.key, written.key.rpartition(".")[2], origin[0].name)
            named = [name for name in names if name in self._named]
            where = self._scene_place(f"components.{named[0]}") if named else where
            self._sizeless(origin, where, kind)
            unit = _UNITS.get(written.kind, "") or _unit(param.comment)
            signed = kind in _ABOUT_ZERO or written.kind in "viegfh"
            self._take(written.key, recipe, unit, where, not signed, tuple(each.name for each in origin))
        return kind

    def _about_percent(self, stated: Stated, kind: str) -> Stated:
        """Return the multipliers' gain error in per cent of the gain, which their parameter counts in."""
        if kind != "vca_gain":
            return stated

        def per_cent(shape: Shape | None) -> Shape | None:
            return None if shape is None else replace(shape.scaled(100.0), relative=False)

        return Stated(per_cent(stated.own), per_cent(stated.shared), stated.match)

    def _take(
        self,
        key: str,
        recipe: Recipe,
        unit: str,
        where: tuple[str, int],
        positive: bool,
        names: tuple[str, ...],
    ) -> None:
        if positive and recipe.nominal <= 0.0:
            self._problem(
                f"{key} = {recipe.nominal:g} {unit} cannot have a tolerance: it is not positive", where
            )
            return
        chance = recipe.not_positive() if positive else 0.0
        if chance > MOST_NEGATIVE:
            self._problem(
                f"more tolerance than value: {key} = {f'{recipe.nominal:.6g} {unit}'.strip()}, "
                f"{recipe.text(unit)}, "
                f"is not positive with a probability of {chance:.2g}",
                where,
            )
            return
        variables = list(self._variables)
        used = dict.fromkeys(variables[term.variable] for term in recipe.used())
        shared = tuple(name for name in used if name.startswith(_SHARED))
        self._components[key] = Component(
            key, recipe.nominal, unit, recipe.text(unit), shared, *where, recipe, names
        )

    def _recipe(self, place: NetlistComponent, param: Param, kind: str) -> Recipe | None:
        """Return how a component's value comes about."""
        several = len(_outermost(param)) > 1
        if value_of(param) is None:
            self._problem(
                f"the tolerance of {place.key} cannot be drawn: its value {param.text} is more than "
                "arithmetic; give the tolerance to a plain number",
                (param.place.file, param.place.line),
            )
            return None

        def own(name: str) -> str:
            return f"{place.key}/{name}" if several else place.key

        def made(each: Param) -> Recipe:
            value = value_of(each)
            assert value is not None
            if self._series and place.kind == "r" and number(each.text) is not None:
                value = preferred(value, self._series)
            terms = self._terms(each, place, own(each.name), kind) if each.stated is not None else ()
            names: dict[str, Recipe] = {}
            for call, (middle, shape) in each.calls.items() if each.stated is None else ():
                alone = not several and len(each.calls) == 1
                variable = self._variable(place.key if alone else f"{place.key}/{each.name}.{call[7:]}")
                names[call] = Recipe(middle, terms=(Term(variable, shape),))
            words = tuple(split(each.text) or ())
            if each.stated is None:
                names |= {
                    word: made(each.env[word]) for word in words if word not in names and word in each.env
                }
                if any(recipe.used() for recipe in names.values()):
                    return names[words[0]] if len(words) == 1 else Recipe(value, words, names)
            return Recipe(value, terms=terms, centre=0.0 if kind in _ABOUT_ZERO else None)

        return made(param)

    def _sized(self, param: Param, kind: str) -> Stated | None:
        """Return a parameter's tolerance; a network that states no size has that of its class."""
        default = self._classes.get(kind)
        if param.stated is None or default is None:
            return param.stated
        return merged(param.stated, self._about_percent(default, kind))

    def _terms(self, param: Param, place: NetlistComponent, own: str, kind: str) -> tuple[Term, ...]:
        stated = self._sized(param, kind)
        assert stated is not None
        terms = []
        if stated.shared is not None or stated.match:
            head, _, name = stated.match.rpartition(":")
            # a network of parts is one of the instance that holds them, and one for each of their numbers
            path = place.path.rpartition(".")[0] if place.network is not None else place.path
            name += f":{param.name}" if place.network is not None else ""
            shared = f"match:{head}:{name}" if head else f"match:{path or 'board'}/{name}"
            shared = shared if stated.match else f"lot:{param.name}"
            self._members.setdefault(shared, []).append((place.key, param.place.file, param.place.line))
            if stated.shared is not None:
                terms.append(Term(self._variable(shared), stated.shared))
        if stated.own is not None:
            terms.append(Term(self._variable(own), stated.own))
        return tuple(terms)

    def _variable(self, name: str) -> int:
        return self._variables.setdefault(name, len(self._variables))

    def _class(self, place: NetlistComponent) -> str:
        if place.kind != ":":
            return _CLASSES.get(place.kind, "")
        name = place.key.rpartition(":")[2]
        role = self._roles.get(place.owner)
        if role == "motor":
            return "k_t" if name == _K_T else ""
        return _PART_CLASSES.get(name.removeprefix(f"{place.owner}_"), "") if role else ""

    def _add_mechanical(self, each: Mechanical) -> str:
        name = next((n for n in (each.path, each.path.partition("[")[0]) if n in self._named), None)
        stated = self._named[name] if name is not None else self._classes.get(each.kind)
        if name is not None:
            self._used.add(name)
        if stated is not None:
            key = f"scene:{each.path}"
            param = Param(each.path.partition("[")[0], repr(each.value), {}, Place(), stated)
            terms = self._terms(param, NetlistComponent(key, param, ":", "", ""), key, each.kind)
            where = self._scene_place(f"components.{name}" if name else each.kind)
            self._sizeless([param], where, each.kind)
            self._take(key, Recipe(each.value, terms=terms), each.unit, where, True, (each.path,))
        return each.kind

    def _of_scene(self, table: Mapping[str, float | str], prefix: str) -> dict[str, Stated]:
        """Read the tolerances of a table of the scene."""
        file = self._scene.file if self._scene is not None else None
        stated_by_key: dict[str, Stated] = {}
        for name, value in table.items():
            text = f"{100.0 * value:.12g}%" if isinstance(value, float) else value
            try:
                stated_by_key[name] = parse(text, file.parent if file is not None else None, self._inside)
            except Wrong as wrong:
                where, line = self._scene_place(prefix + name)
                key = f"tolerance.{prefix}{name}"
                self._problems.append(Problem(str(wrong), where or None, key, value, line=line or None))
        return stated_by_key

    def _scene_place(self, name: str) -> tuple[str, int]:
        file = self._scene.file if self._scene is not None else None
        if file is None:
            return "", 0
        return str(file), line_of(self._text, ("tolerance", *name.split("."))) or 0

    def _sizeless(self, origin: list[Param], where: tuple[str, int], kind: str) -> None:
        """Refuse a network that shares nothing: its members would be as independent as without it."""
        for stated in (self._sized(each, kind) for each in origin):
            if stated is not None and stated.match and stated.shared is None:
                form = f"match={stated.match}" + (" dev=0.1%" if stated.own is not None else "")
                self._problem(
                    f"match={stated.match} does not say how much its members deviate together: "
                    f"put tol= before it, as in tol=1% {form}",
                    where,
                )

    def _problem(self, message: str, where: tuple[str, int]) -> None:
        problem = Problem(message, file=where[0] or None, line=where[1] or None)
        if problem not in self._problems:  # one line may be used by many components
            self._problems.append(problem)

    def _unknown(self, known: list[str]) -> None:
        for name in self._named:
            if name not in self._used:
                near = nearest(name, known)
                reason = "nothing that could vary has this name" + (f"; nearest is {near}" if near else "")
                file, line = self._scene_place(f"components.{name}")
                key = f"tolerance.components.{name}"
                self._problems.append(Problem(reason, file or None, key, line=line or None))

    def _alone(self) -> None:
        """Refuse a network with one member: its name is misspelt, or nothing is matched to anything."""
        networks = [name for name in self._members if name.startswith("match:")]
        for name in networks:
            members = self._members[name]
            if len(members) == 1:
                others = [other for other in networks if other != name]
                near = nearest(name, others)
                key, file, line = members[0]
                named = next((each for each in (key, key.rpartition(".")[2]) if each in self._named), None)
                where = self._scene_place(f"components.{named}") if named else (file, line)
                self._problem(
                    f"{key} is alone in the network {name.removeprefix('match:')}"
                    + (f"; nearest is {near.removeprefix('match:')}" if near else ""),
                    where,
                )


_SHARED = ("lot:", "match:")


def _varies(param: Param) -> bool:
    return bool(_outermost(param))


def _outermost(param: Param, depth: int = 0) -> list[Param]:
    """Return the varying parameters that a value is made of, the outermost of each way."""
    if param.varies:
        return [param]
    words = (split(param.text) if depth < 40 else None) or ()
    by_id: dict[int, Param] = {}
    for word in words:
        if word in param.env:
            by_id |= {id(each): each for each in _outermost(param.env[word], depth + 1)}
    return list(by_id.values())


def _unit(comment: str) -> str:
    """Return the unit that a comment begins with."""
    words = comment.partition(";")[2].strip() or comment
    return next(
        (unit for unit in _KNOWN_UNITS if words == unit or words.startswith((f"{unit},", f"{unit};"))), ""
    )


def _text(scene: Scene | None) -> str:
    file = scene.file if scene is not None else None
    try:
        return Path(file).read_text(encoding="utf-8-sig") if file is not None else ""
    except OSError:
        return ""
