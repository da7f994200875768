"""What is fuzzed within one process: readers of all that comes from a disk or a command line."""

import os
import re
import shutil
import signal
import time
import warnings
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from types import FrameType
from typing import Any

import hypothesis
from hypothesis import HealthCheck, Phase, configuration, given, settings
from hypothesis import strategies as st

from cosim.assets import netlists_folder, scenes_folder
from cosim.comparisons.sweep import parse_range
from cosim.errors import CosimError
from cosim.ngspice import deck_file
from cosim.ngspice.deck import load_deck
from cosim.plan import resolve
from cosim.results import Run, json_text, read_csv
from cosim.scene import load_scene
from cosim.scene.schema import SceneTables
from cosim.storage.checkpoint import Points
from cosim.storage.rawfile import read_raw
from cosim.studies.study import load_study
from cosim.terminal import printable
from cosim.variants import parse_settings, variants

from .inputs import TOKENS, damaged, mutated, numbers, scene_keys, values

ROOT = Path(__file__).resolve().parents[2]
#: One input may take so long [s of this process]: readers take milliseconds.
LIMIT_S = 10.0
#: An error is for reading: it echoes no file.
LONGEST_ERROR = 20_000


class Hang(Exception):
    """One input took longer than `LIMIT_S`."""


@dataclass(frozen=True)
class Target:
    """A reader: its inputs, and the attempt to read one; refusals are `CosimError`."""

    name: str
    inputs: st.SearchStrategy[Any]
    attempt: Callable[[Any], object]


@dataclass(frozen=True)
class Outcome:
    """How many inputs were accepted and refused, and the slowest of them [s]."""

    accepted: int
    refused: int
    slowest_s: float


def exercise(target: Target, seed: int, cases: int, home: Path) -> Outcome:
    """Feed a target; whatever is no `CosimError`, takes too long or says too much is raised, shrunk."""
    configuration.set_hypothesis_home_dir(home)
    counts: Counter[str] = Counter()
    slowest = 0.0

    @hypothesis.seed(seed)
    @settings(
        max_examples=cases,
        database=None,
        deadline=None,
        suppress_health_check=list(HealthCheck),
        phases=(Phase.generate, Phase.shrink),
        print_blob=False,
    )
    @given(target.inputs)
    def once(value: Any) -> None:
        nonlocal slowest
        begun = time.perf_counter()
        try:
            with _limit(), warnings.catch_warnings():
                warnings.simplefilter("error")  # a number that overflows in silence is a defect
                target.attempt(value)
            counts["accepted"] += 1
        except CosimError as error:
            counts["refused"] += 1
            check_words(printable(str(error)))
        slowest = max(slowest, time.perf_counter() - begun)

    once()
    return Outcome(counts["accepted"], counts["refused"], slowest)


def check_words(text: str) -> None:
    """Fail for an error that a terminal would obey, or that nobody would read to its end."""
    assert len(text) < LONGEST_ERROR, f"an error of {len(text)} characters: {text[:300]}"
    odd = re.search(r"[\x00-\x08\x0b-\x1f\x7f\x80-\x9f]", text)
    assert odd is None, f"an error with the control character {odd[0]!r}: {text[:300]!r}"
    assert "Traceback" not in text, text


@contextmanager
def _limit() -> Iterator[None]:
    def stop(signum: int, frame: FrameType | None) -> None:
        raise Hang(f"longer than {LIMIT_S:g} s")

    before = signal.signal(signal.SIGVTALRM, stop)  # CPU time: a busy machine is no hang
    signal.setitimer(signal.ITIMER_VIRTUAL, LIMIT_S)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_VIRTUAL, 0.0)
        signal.signal(signal.SIGVTALRM, before)


class Project:
    """A device's folder of its own, whole again behind every attempt."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        shutil.copytree(netlists_folder(), folder / "netlists")
        shutil.copytree(scenes_folder(), folder / "scenes")
        self.scenes = sorted((folder / "scenes").glob("*.toml"))
        self.studies = sorted((folder / "scenes" / "paper").glob("[0-9]*.toml"))
        tops = [folder / "netlists" / name for name in ("board1.cir", "board2.cir")]
        self.netlists = [*tops, *sorted((folder / "netlists").glob("[bp]*/*.*"))]
        self.netlists = [path for path in self.netlists if path.suffix in (".cir", ".lib")]

    @contextmanager
    def holding(self, path: Path, text: str | bytes) -> Iterator[None]:
        """Put other content into a file for the length of the block."""
        data = path.read_bytes()
        path.write_bytes(text if isinstance(text, bytes) else text.encode("utf-8", "surrogatepass"))
        try:
            yield
        finally:
            path.write_bytes(data)


def readers(folder: Path, result: Path) -> list[Target]:
    """Return the targets; `folder` is for their files, `result` a stored result to damage."""
    project = Project(folder / "project")
    for name in ("home", "result"):
        (folder / name).mkdir(exist_ok=True)
    return [_scenes(project), _netlists(project), _settings(project), _ranges(), _studies(project),
            _results(folder / "copy", result), _raw(folder / "a.raw", result), _csv(folder / "a.csv", result),
            _points(folder / "points.jsonl")]  # fmt: skip


def _planned(scene: Path, overrides: tuple[str, ...] = ()) -> None:
    json_text(resolve(load_scene(scene, overrides)).as_dict())


def _scenes(project: Project) -> Target:
    texts = [path.read_text(encoding="utf-8") for path in project.scenes]
    place = project.folder / "scenes" / "fuzzed.toml"

    def attempt(text: str) -> None:
        place.write_bytes(text.encode("utf-8", "surrogatepass"))
        _planned(place)

    return Target("scenes", mutated(texts), attempt)


def _netlists(project: Project) -> Target:
    contents = {path: path.read_text(encoding="utf-8") for path in project.netlists}
    levels = st.sampled_from(("ideal", "gbw", "full"))

    def case(path: Path) -> st.SearchStrategy[Any]:
        return st.tuples(st.just(path), mutated([contents[path]]), levels)

    def attempt(given: tuple[Path, str, str]) -> None:
        path, text, level = given
        name = "board1.cir" if path.name == "board1.cir" else "board2.cir"
        roles = {"opamp": level, "vca": level, "driver_level": level, "driver": "voltage"}
        with project.holding(path, text):
            load_deck(project.folder / "netlists" / name, levels=roles, root=project.folder)

    return Target("netlists", st.sampled_from(project.netlists).flatmap(case), attempt)


def _settings(project: Project) -> Target:
    form = re.compile(r"(?im)^(?:\.param\s+)?([rcx]\w+|\w+(?==))")
    named = {name for path in project.netlists for name in form.findall(path.read_text(encoding="utf-8"))}
    names = [*sorted(named), "xdiff1.r11", "xsum1.xop.x", "xdiff9.r1", "x.y.z"]
    keys = [*scene_keys(project.scenes), *_schema_keys(), *names]
    name = st.one_of(st.sampled_from(keys), st.sampled_from(TOKENS), st.text(max_size=8))

    def attempt(given: tuple[Path, list[tuple[str, str]]]) -> None:
        scene, pairs = given
        for variant in variants(parse_settings([f"{key}={value}" for key, value in pairs]))[:2]:
            _planned(scene, variant.overrides)

    plausible = st.tuples(st.sampled_from([*names, *keys]), numbers())
    pairs = st.lists(st.one_of(plausible, plausible, st.tuples(name, values())), min_size=1, max_size=2)
    return Target("settings", st.tuples(st.sampled_from(project.scenes), pairs), attempt)


def _schema_keys() -> list[str]:
    """Dotted keys of the schema, one table deep."""
    rows = []
    for table, field in SceneTables.model_fields.items():
        fields = getattr(field.annotation, "model_fields", {})
        rows += [table, *(f"{table}.{key}" for key in fields)]
    return rows


def _ranges() -> Target:
    part = st.one_of(values(), st.sampled_from(("lin", "log", "3", "10000", "99999999999")))
    text = st.lists(part, max_size=5).map(lambda parts: "r_sum_spring=" + ":".join(parts))
    return Target("ranges", text, parse_range)


def _studies(project: Project) -> Target:
    texts = [path.read_text(encoding="utf-8") for path in project.studies]
    place = project.folder / "scenes" / "paper" / "fuzzed.toml"

    def attempt(text: str) -> None:
        place.write_bytes(text.encode("utf-8", "surrogatepass"))
        load_study(place)

    return Target("studies", mutated(texts), attempt)


def _results(copy: Path, result: Path) -> Target:
    names = [path.name for path in sorted(result.iterdir()) if path.is_file() and path.suffix != ".parquet"]

    def attempt(given: tuple[str, bytes]) -> None:
        name, content = given
        if copy.exists():
            shutil.rmtree(copy)
        shutil.copytree(result, copy, copy_function=os.link)
        (copy / name).unlink()
        (copy / name).write_bytes(content)
        deck_file.load(copy)
        Run.load(copy)

    def case(name: str) -> st.SearchStrategy[Any]:
        content = (result / name).read_bytes()
        broken = damaged([content])
        if name.endswith((".json", ".toml")):
            broken = st.one_of(
                broken, mutated([content.decode()]).map(lambda text: text.encode("utf-8", "replace"))
            )
        return st.tuples(st.just(name), broken)

    return Target("results", st.sampled_from(names).flatmap(case), attempt)


def _raw(place: Path, result: Path) -> Target:
    def attempt(content: bytes) -> None:
        place.write_bytes(content)
        signals = read_raw(place)
        for name in signals:
            signals[name].sum()

    return Target("raw", damaged([(result / "signals.raw").read_bytes()]), attempt)


def _csv(place: Path, result: Path) -> Target:
    def attempt(content: bytes) -> None:
        place.write_bytes(content)
        read_csv(place)

    return Target("csv", damaged([(result / "samples.csv").read_bytes()]), attempt)


def _points(place: Path) -> Target:
    with Points(place, "a") as points:
        for key in "abc":
            points.get(key, lambda: {"peak_force": 1.25, "text": "x"})
    data = place.read_bytes()

    def attempt(content: bytes) -> None:
        place.write_bytes(content)
        with Points(place, "a") as again:
            for key in "abc":
                assert again.get(key, lambda: {"peak_force": 1.25, "text": "x"})["peak_force"] == 1.25

    return Target("points", damaged([data]), attempt)
