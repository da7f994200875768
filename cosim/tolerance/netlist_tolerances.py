"""What varies on a board: the components that its netlist, or the scene's defaults, give a tolerance.

A tolerance belongs to a placed component, not to the name of a value: ``.param r=10k $ tol=1%`` used by four
resistors is four draws. Of several tolerances on the way to an element the outermost counts: the element's
own, that of the instance's line, that of the parameter.
"""

from __future__ import annotations

import re
from collections import ChainMap
from collections.abc import Callable, Iterable, Iterator, Mapping, MutableMapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from cosim.caution import Caution, warn
from cosim.circuits.extraction.alter import walk
from cosim.errors import Problem
from cosim.ngspice.dialect import Dialect
from cosim.ngspice.expression import reduce, split
from cosim.ngspice.lines import Line, assignments, number, tokens
from cosim.ngspice.model_tolerances import deviations
from cosim.ngspice.netlist import Block, Instance, Netlist
from cosim.ngspice.values import as_meant
from cosim.tolerance.distribution_functions import extracted_calls
from cosim.tolerance.distributions import SIGMAS, Shape
from cosim.tolerance.grammar import Stated, Wrong, begins, parse, shape_before

__all__ = ["Board", "NetlistComponent", "Param", "Place"]

_UNITS = {"r": "Ohm", "c": "F", "l": "H", "v": "V", "i": "A"}
_PLACES = {"r": 3, "c": 3, "l": 3, "v": 3, "i": 3, "e": 5, "g": 5, "f": 4, "h": 4}
_NAME = re.compile(r"[a-z_]\w*")
_NAMES = re.compile(r"(?<![\w.])[a-z_]\w*")


@dataclass(frozen=True)
class Place:
    """Where something stands in the netlists."""

    file: str = ""
    line: int = 0


@dataclass(frozen=True)
class Param:
    """A named value: its text, what names in it mean, and its own tolerance."""

    name: str
    text: str
    env: Mapping[str, Param]
    place: Place
    stated: Stated | None = None
    calls: Mapping[str, tuple[float, Shape]] = field(default_factory=dict)
    comment: str = ""

    @property
    def varies(self) -> bool:
        """Whether it deviates by itself, apart from what its expression depends on."""
        return self.stated is not None or bool(self.calls)


@dataclass(frozen=True)
class NetlistComponent:
    """One component: its key, its value as a `Param` that may be an expression, its unit, and its instance.

    `kind` is the letter of an element; ':' for a parameter of an instance. `network` is what the line of a
    placed part says of its match with others: halves of a dual op-amp.
    """

    key: str
    value: Param
    kind: str
    path: str
    owner: str
    network: Stated | None = None


class Board:
    """The components of a flat deck, and the problems of the tolerances that they state.

    Parameters
    ----------
    net, name
        Netlist, and the board's name.
    components
        Tolerances by name before all that the netlist says.
    inside
        Folders that the files of its histograms may lie in, besides that of the netlist; none: anywhere.
    """

    def __init__(
        self,
        net: Netlist,
        name: str,
        components: Mapping[str, Stated],
        inside: Sequence[Path] | None = (),
    ) -> None:
        self.problems: list[Problem] = []
        self.used: set[str] = set()
        self._net, self._name, self._components, self._inside_of = net, name, components, inside
        self.top: dict[str, Param] = {}
        self._models = _models(net.top)
        for _ in self._twice():
            for line in net.top:
                if line.keyword in (".param", ".params"):
                    self.top |= self._stated(line, self.top)

    def components(self) -> Iterator[NetlistComponent]:
        """Yield every element outside the parts, and every parameter of a part with a tolerance."""
        envs: dict[str, MutableMapping[str, Param]] = {}
        for path, block, instance in walk(self._net, self._name):
            outside = envs.get(path.rpartition(".")[0], self.top)
            env = self._inside(block, instance, outside)
            envs[path] = env
            short = path.removeprefix("xboard").removeprefix(".")
            if block.is_part:
                yield from self._of_part(block, short, env, instance)
            else:
                yield from self._of_block(block, short, env)

    def _inside(
        self, block: Block, instance: Instance | None, outside: MutableMapping[str, Param]
    ) -> MutableMapping[str, Param]:
        env: ChainMap[str, Param] = ChainMap({}, self.top)
        for _ in self._twice():
            self._fill(env, block, instance, outside)
        return env

    def _twice(self) -> Iterator[None]:
        """Read parameters twice: a distribution function may name one that stands behind it."""
        before = len(self.problems)
        yield
        del self.problems[before:]
        yield

    def _fill(
        self,
        env: ChainMap[str, Param],
        block: Block,
        instance: Instance | None,
        outside: Mapping[str, Param],
    ) -> None:
        defaults = self._params(block.header, dict(block.params), env)
        given: dict[str, Param] = {}
        if instance is not None:
            texts = assignments(list(instance.extra))
            given = self._params(instance.line, texts, outside)
        for name, default in defaults.items():
            env[name] = self._bought(given.get(name), default)
        for name, param in given.items():
            env.setdefault(name, param)
        for line in block.body:
            if line.keyword in (".param", ".params"):
                env |= self._stated(line, env)

    def _bought(self, given: Param | None, default: Param) -> Param:
        """Return a subcircuit's parameter: another value in place of its default keeps the grade of that."""
        if given is None:
            return default
        if given.varies or number(given.text) is None:
            return given
        grade = default
        while not grade.varies and _NAME.fullmatch(grade.text) and grade.text in grade.env:
            grade = grade.env[grade.text]
        if grade.stated is None or not _relative(grade.stated):
            return given
        return Param(grade.name, given.text, given.env, given.place, grade.stated)

    def _of_block(self, block: Block, path: str, env: Mapping[str, Param]) -> Iterator[NetlistComponent]:
        for line in block.body:
            letter = line.keyword[0]
            if letter in ".x*":
                continue
            key = f"{path}.{line.keyword}".lstrip(".")
            words = tokens(_drawn(line).lower())
            place = _PLACES.get(letter, 0)
            if letter in _PLACES and len(words) > place and not block.local:
                value = self._element(line, words[place:], env, block, key)
                yield NetlistComponent(key, value, letter, path, block.name)
                words = [words[0], *words[place + 1 :]]
            rest = [param for param in self._reached(" ".join(words[1:]), env) if param.varies]
            for param in rest:  # in a formula, a temperature coefficient: one draw for the instance
                yield NetlistComponent(f"{path}:{param.name}", param, ":", path, block.name)

    def _element(
        self, line: Line, words: list[str], env: Mapping[str, Param], block: Block, key: str
    ) -> Param:
        """Return the value of an element whose words from the value on are given."""
        bare = words[0].removeprefix("r=").removeprefix("c=").removeprefix("l=")
        text, calls, wrong = extracted_calls(bare, self._constants(line, env), bool(line.drawn))
        self._problem(wrong, line)
        stated = self._named(key, line.keyword)
        if stated is None:
            stated = self._parse(line)
        text = text.strip("{}'")
        model = self._model(line, words, block)
        if stated is None and model is not None:  # its lot is of all that use the model
            return Param(_shown(model).lower(), text, env, _place(model), _of_model(model))
        return Param(f"{block.name}.{line.keyword}", text, env, _place(line), stated, calls, line.comment)

    def _model(self, line: Line, words: list[str], block: Block) -> Line | None:
        """Return the model with tolerances that an element names behind its value."""
        if line.keyword[0] not in "rcl":
            return None
        models = self._models | _models(block.body)
        return next((models[word] for word in words[1:] if word in models), None)

    def _of_part(
        self, block: Block, path: str, env: Mapping[str, Param], instance: Instance | None
    ) -> Iterator[NetlistComponent]:
        """Yield the parameters outside subcircuits that a part's elements depend on, varying or not.

        Of its elements only those that state a tolerance, or whose model does.
        """
        for line in block.body:
            letter = line.keyword[0]
            place = 0 if block.local else _PLACES.get(letter, 0)
            words = tokens(_drawn(line).lower())
            toleranced = letter not in ".x*" and begins(line.comment) is not None
            if toleranced and not _has_value(words, place):
                warn(_undrawn(line, block))
            elif toleranced or (
                0 < place < len(words) and self._model(line, words[place:], block) is not None
            ):
                key = f"{path}.{line.keyword}"
                value = self._element(line, words[place:], env, block, key)
                yield NetlistComponent(key, value, letter, path, block.name)
        body = " ".join(line.text for line in block.body if line.keyword not in (".param", ".params"))
        seen: set[str] = set()
        stated = self._parse(instance.line) if instance is not None and not instance.extra else None
        network = stated if stated is not None and stated.match else None
        for param in self._reached(body, env, path):
            key = f"{path}:{param.name}"
            known = param.varies or key in self._components
            if param.name not in seen and (known or self._may_vary(param)):
                seen.add(param.name)
                yield NetlistComponent(key, param, ":", path, block.origin.partition("__")[0], network)

    def _may_vary(self, param: Param) -> bool:
        """Whether it is a part's own number: what follows from one that varies is no draw beside it."""
        made_of = self._reached(param.text.lower(), param.env)
        return self.top.get(param.name) is param and not any(each.varies for each in made_of)

    def _reached(self, text: str, env: Mapping[str, Param], path: str = "") -> Iterator[Param]:
        """Yield the parameters that a text depends on; what a varying one is made of does not vary again.

        Of the part at a path those vary, too, that the scene names.
        """
        seen: set[int] = set()
        waiting = [(name, env) for name in _NAMES.findall(text.lower())]
        while waiting:
            name, here = waiting.pop(0)
            param = here.get(name)
            if param is None or id(param) in seen:
                continue
            seen.add(id(param))
            yield param
            if not param.varies and f"{path}:{param.name}" not in self._components:
                waiting += [(inner, param.env) for inner in _NAMES.findall(param.text.lower())]

    def _stated(self, line: Line, env: Mapping[str, Param]) -> dict[str, Param]:
        return self._params(line, assignments(tokens(_drawn(line))[1:]), env)

    def _params(self, line: Line, texts: Mapping[str, str], env: Mapping[str, Param]) -> dict[str, Param]:
        written = self._parse(line) if texts else None
        params = {}
        for name, value in texts.items():
            text, calls, wrong = extracted_calls(value.lower(), self._constants(line, env), bool(line.drawn))
            self._problem(wrong, line)
            stated = self._named(name) or (None if calls else written)
            params[name] = Param(name, text.strip("{}'"), env, _place(line), stated, calls, line.comment)
        return params

    def _constants(self, line: Line, env: Mapping[str, Param]) -> Callable[[str], float | None]:
        """Return what gives the number that an expression of parameters which do not vary comes to.

        A function of a distribution's name that the file itself defines takes numbers only: it is no draw.
        """
        if not line.drawn:
            return number

        def constant(text: str) -> float | None:
            if any(param.varies for param in self._reached(text, env)):
                return None
            return value_of(Param("", text, env, Place()))

        return constant

    def _named(self, *names: str) -> Stated | None:
        for name in names:
            if name in self._components:
                self.used.add(name)
                return self._components[name]
        return None

    def _parse(self, line: Line) -> Stated | None:
        words = begins(line.comment)
        if words is None or line.keyword == ".csparam":
            return None
        unread = shape_before(line.comment)
        if unread:
            self._problem(
                f"{unread} stands before the tolerance, where it does not count: write it behind, or end "
                "words for people with a semicolon",
                line,
            )
            return None
        try:
            return parse(words, Path(line.file).parent if line.file else None, self._inside_of)
        except Wrong as wrong:
            self._problem(str(wrong), line)
            return None

    def _problem(self, message: str, line: Line) -> None:
        if message:
            problem = Problem(message, file=line.file or None, line=line.lineno or None, key=_shown(line))
            if problem not in self.problems:
                self.problems.append(problem)


def _has_value(words: list[str], place: int) -> bool:
    """Whether an element has a value of its own at its place, not a formula's or a polynomial's."""
    if not 0 < place < len(words) or words[3].startswith("poly"):
        return False
    return number(words[place]) is not None or words[place][0] in "{'"


def _undrawn(line: Line, block: Block) -> Caution:
    return Caution(
        "tolerance-undrawn",
        f"{line.file}:{line.lineno}: the tolerance of {line.keyword} in the part {block.name} is not drawn",
        "state it behind a resistor, capacitor, inductor or source with one value, or behind a .param",
    )


def _models(lines: Iterable[Line]) -> dict[str, Line]:
    """Return the models whose elements have tolerances, by name."""
    return {
        tokens(line.text)[1].lower(): line for line in lines if line.keyword == ".model" and deviations(line)
    }


def _of_model(line: Line) -> Stated:
    """Return a model's DEV and LOT; what is GAUSS there is drawn within three standard deviations."""
    shapes = {
        each.kind: Shape("uniform", -each.size, each.size)
        if each.shape == "uniform"
        else Shape("truncated", -SIGMAS * each.size, SIGMAS * each.size, SIGMAS)
        for each in deviations(line)
    }
    return Stated(shapes.get("dev"), shapes.get("lot"))


def _relative(stated: Stated) -> bool:
    return all(shape is None or shape.relative for shape in (stated.own, stated.shared))


def _shown(line: Line) -> str:
    words = tokens(line.text)
    return words[1].partition("=")[0] if words[0].startswith(".") and len(words) > 1 else words[0]


def _place(line: Line) -> Place:
    return Place(line.file, line.lineno)


def _drawn(line: Line) -> str:
    """Return a statement with its distribution functions, unless another value took their place."""
    if line.drawn and as_meant(Line(line.drawn), Dialect.NGSPICE).text == line.text:
        return line.drawn
    return line.text


def value_of(param: Param, depth: int = 0) -> float | None:
    """Return a parameter's nominal value; ``None`` where it is more than arithmetic."""
    known = number(param.text)
    if known is not None:
        return known
    words = split(param.text)
    if words is None or depth > 40:
        return None
    names: dict[str, float] = {name: nominal for name, (nominal, _) in param.calls.items()}
    for word in words:
        if _NAME.fullmatch(word) and word not in names and word in param.env:
            inner = value_of(param.env[word], depth + 1)
            if inner is None:
                return None
            names[word] = inner
    try:
        value = reduce(words, names)
    except (ZeroDivisionError, OverflowError):
        return None
    return None if value is None else float(value)
