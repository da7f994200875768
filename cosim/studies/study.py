"""Study files: an analysis of a scene with its parameters, run once and kept with its points.

A study file is TOML: ``study`` names the analysis, ``scene`` the scene it is about, ``set`` what is changed
in that scene, ``[parameters]`` what the analysis itself takes. Its result is a set of tables and verdicts.
"""

from __future__ import annotations

import csv
import hashlib
import io
import json
import os
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import cache
from importlib import import_module
from pathlib import Path, PurePath
from typing import Any

import cosim
from cosim.errors import InputError, Problem, fail, nearest
from cosim.notebook_view import view
from cosim.plan import resolve
from cosim.results import json_text
from cosim.scene import Scene, load_scene
from cosim.scene.layers import line_of, read_layer
from cosim.scene.parameters import Parameters, read_parameters
from cosim.storage import field_types
from cosim.storage.checkpoint import Points
from cosim.storage.checksums import listed, read_sealed, sealed, write_manifest
from cosim.storage.staging import Staging, disk_errors, require_ours

__all__ = ["STUDIES", "Parameters", "Study", "StudyFile", "StudyResult", "Table", "Verdict", "is_study",
           "load_study", "run_study"]  # fmt: skip

RECORD, POINTS = "study.json", "points.jsonl"
_FORMAT_VERSION = 3
#: Versions that can be read; 2 has the outcome of a verdict under the name "found".
_READABLE = (2, _FORMAT_VERSION)
#: The analyses by name, and the module of each; its `STUDY` says the rest.
STUDIES = {
    "acceptance": "cosim.studies.equations",
    "budget": "cosim.studies.budget",
    "ceiling": "cosim.studies.analog_limit",
    "congruence": "cosim.studies.preload",
    "corner": "cosim.studies.differentiator_corner",
    "device": "cosim.studies.device",
    "drop": "cosim.studies.drop_test",
    "eta": "cosim.studies.delay_damping",
    "footnote": "cosim.studies.footnote1_map",
    "maps": "cosim.studies.stability_maps",
    "onset": "cosim.studies.onset",
    "passive": "cosim.studies.paper_passivity",
    "poses": "cosim.studies.poses",
    "rendering": "cosim.studies.rendering",
    "shift": "cosim.studies.limit_shift",
    "trace": "cosim.studies.wall_trace",
}


@dataclass(frozen=True)
class Table:
    """A table of a result.

    Attributes
    ----------
    name, title : file name without ending, and heading
    columns : heading with unit -> values (numbers, words or None), all of one length; what a picture looks
        up goes by a `cosim.studies.table_columns.Column`
    note : what a reader must know of it
    """

    name: str
    title: str
    columns: Mapping[str, Sequence[Any]]
    note: str = ""


@dataclass(frozen=True)
class Verdict:
    """One claim: what the paper (or theory) says, what came out, and whether it holds.

    Attributes
    ----------
    id : row of the acceptance table, such as ``F13a``
    claim, expected, outcome : in words with numbers and units
    holds : None where the claim is a question that `outcome` answers
    own : whether it judges a closed form or a model of this program, which is no verdict on the paper
    """

    id: str
    claim: str
    expected: str
    outcome: str
    holds: bool | None
    own: bool = False


@dataclass(frozen=True)
class StudyResult:
    """What a study found.

    `seconds` is the computing time, interrupted runs included; `kept_in` the file that it was read from.
    """

    study: str
    title: str
    tables: tuple[Table, ...]
    verdicts: tuple[Verdict, ...] = ()
    notes: tuple[str, ...] = ()
    seconds: float = 0.0
    digest: str = ""
    kept_in: str = field(default="", compare=False)

    def table(self, name: str) -> Table:
        """Return a table by its name; `KeyError` when there is none."""
        for table in self.tables:
            if table.name == name:
                return table
        raise KeyError(name)

    def plot(self, name: str | None = None) -> Any:
        """Return a matplotlib figure of the study: that of a name, or its first.

        Raises
        ------
        ValueError
            For a name that the study does not draw.
        """
        return view("study_figure", self, name)

    def _repr_html_(self) -> str:
        """Return notes, verdicts, tables and pictures, for notebooks."""
        text: str = view("study_html", self)
        return text


@dataclass(frozen=True)
class Study:
    """An analysis: its name, a line of help, its parameters, and its function.

    `analyse` gets the study file and `Points`, in which it keeps slow results. `no_tolerance` says why no
    tolerance can be asked of it; empty where its runs have measures that can be within one.
    """

    name: str
    help: str
    parameters: type[Parameters]
    analyse: Callable[[StudyFile, Points], StudyResult]
    no_tolerance: str = "it is made of theory on the extracted circuit, and runs nothing"


@dataclass(frozen=True)
class StudyFile:
    """A checked study file.

    Attributes
    ----------
    file, study, title : where it is, which analysis, heading
    scene_file, overrides : the scene with what is changed in it, as `load_scene` takes them
    parameters : of the analysis, an instance of `Study.parameters`
    tolerances : within which the measures of its runs are asked for, as `cosim run --tol` takes them
    """

    file: Path
    study: Study
    title: str
    scene_file: Path
    overrides: tuple[str, ...]
    parameters: Any = field(repr=False)
    tolerances: tuple[str, ...] = ()

    def scene(self, *overrides: str) -> Scene:
        """Load the scene with further overrides on top."""
        return load_scene(self.scene_file, (*self.overrides, *overrides))

    def result(
        self, *tables: Table, verdicts: Sequence[Verdict] = (), notes: Sequence[str] = ()
    ) -> StudyResult:
        """Return a result under this study's name and title."""
        return StudyResult(self.study.name, self.title, tables, tuple(verdicts), tuple(notes))

    def digest(self) -> str:
        """SHA-256 of all that the result depends on: parameters, scene, user's code, flat deck, our code."""
        scene = self.scene()
        parts = (
            self.study.name, self.title, self.parameters.model_dump_json(), scene.digest(),
            scene.code_digest(), resolve(scene).board.digest, _sources(), *self.tolerances,
        )  # fmt: skip
        return hashlib.sha256("\n".join(parts).encode()).hexdigest()


@cache
def _sources() -> str:
    """SHA-256 of the program's own sources: a changed analysis runs again."""
    root = Path(cosim.__file__).parent
    digest = hashlib.sha256()
    for path in sorted([*root.rglob("*.py"), *(root.parent / "mech").rglob("*.py")]):
        digest.update(path.read_bytes())
    return digest.hexdigest()


def is_study(path: Path) -> bool:
    """Whether a file is a study file: TOML with a key ``study``."""
    return path.suffix == ".toml" and os.path.isfile(path) and "study" in read_layer(path).data


def study_named(name: str) -> Study:
    """Return an analysis by its name; `KeyError` when there is none."""
    study: Study = import_module(STUDIES[name]).STUDY
    return study


def load_study(path: str | os.PathLike[str], overrides: Sequence[str] = ()) -> StudyFile:
    """Load a study file.

    Parameters
    ----------
    path
        TOML file.
    overrides
        Changes of its scene, on top of its ``set``.

    Raises
    ------
    InputError
        With every problem of the file; problems of the scene come from `load_scene`.
    """
    file = Path(os.path.abspath(path))
    layer = read_layer(file)
    data = dict(layer.data)

    def at(
        message: str, key: str, value: object = None, unit: str | None = None, allowed: str | None = None
    ) -> Problem:
        return Problem(message, str(file), key, value, unit, allowed, line_of(layer.text, key.split(".")))

    known = ("study", "title", "scene", "set", "parameters")
    problems = [
        at("unknown key" + (f'; did you mean "{near}"?' if (near := nearest(key, known)) else ""), key,
           data[key], allowed=", ".join(known))
        for key in data if key not in known
    ]  # fmt: skip
    for key in ("study", "title", "scene"):
        if not isinstance(data.get(key), str):
            problems.append(at("is required, as text", key, data.get(key)))
    changes = data.get("set", ())
    if not isinstance(changes, tuple) or not all(isinstance(text, str) for text in changes):
        problems.append(at('must be a list of texts like "computer.period_s=0.01"', "set", changes))
    name = data.get("study")
    if isinstance(name, str) and name not in STUDIES:
        near = nearest(name, STUDIES)
        hint = f'; did you mean "{near}"?' if near else ""
        problems.append(at(f"no such study{hint}", "study", name, allowed=", ".join(STUDIES)))
    if problems:
        raise InputError(problems)
    study = study_named(data["study"])
    parameters, refused = read_parameters(study.parameters, data.get("parameters", {}))
    if refused:
        raise InputError(
            at(p.message, f"parameters.{p.key}" if p.key else "parameters", p.value, p.unit, p.allowed)
            for p in refused
        )
    scene_file = Path(os.path.abspath(file.parent / data["scene"]))
    if not os.path.isfile(scene_file):
        raise InputError(at("no such scene file", "scene", data["scene"]))
    return StudyFile(file, study, data["title"], scene_file, (*changes, *overrides), parameters)


def run_study(
    spec: StudyFile,
    folder: Path,
    *,
    on_progress: Callable[[int, int, str], None] | None = None,
) -> StudyResult:
    """Run a study, or take its result from `folder` when nothing it depends on has changed.

    An interrupted run resumes after the points that it finished.

    Parameters
    ----------
    folder
        Keeps the result, its tables as CSV, and the points until the result is complete.
    on_progress
        Called with (points done, points in all, what is computed).

    Raises
    ------
    InputError
        When the folder cannot be written or is somebody else's.
    """
    digest = spec.digest()
    known = _load(folder)
    if known is not None and known.digest == digest:
        if known.study != spec.study.name:
            fail("is of another study; remove it to compute it again", file=known.kept_in)
        return known
    require_ours(folder, listed)  # refuse before anything is computed
    kept = folder.parent / f"{folder.name}.{POINTS}"
    with disk_errors(folder):
        folder.parent.mkdir(parents=True, exist_ok=True)
    with Points(kept, digest, on_progress) as points:
        begun = time.perf_counter()
        with field_types.used(str(kept), points.restored > 0):
            result = spec.study.analyse(spec, points)
        seconds = points.seconds_before + time.perf_counter() - begun
    result = StudyResult(**{**vars(result), "seconds": seconds, "digest": digest})
    with Staging(folder, listed) as stage, disk_errors(folder):
        for table in result.tables:
            (stage.path / f"{table.name}.csv").write_text(table_text(table), encoding="utf-8")
        plain = json.loads(json_text({"format": _FORMAT_VERSION, **asdict(result)}))
        (stage.path / RECORD).write_text(json_text(sealed(plain)) + "\n", encoding="utf-8")
        write_manifest(stage.path, [RECORD, *(f"{table.name}.csv" for table in result.tables)])
        stage.publish()
    kept.unlink(missing_ok=True)
    return result


def table_text(table: Table) -> str:
    """Return a table as CSV."""
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow(table.columns)
    writer.writerows(zip(*table.columns.values(), strict=True))
    return stream.getvalue()


def _load(folder: Path) -> StudyResult | None:
    """Return the stored result; None when there is none."""
    file = folder / RECORD
    if not os.path.isfile(file):
        return None
    data = read_sealed(file, *_READABLE)
    rows = data.get("verdicts")
    for row in rows if isinstance(rows, list) else []:
        if isinstance(row, dict) and "found" in row:
            row["outcome"] = row.pop("found")
    result: StudyResult = field_types.made(data, StudyResult, str(file))
    for table in result.tables:
        if (
            len({len(values) for values in table.columns.values()}) > 1
            or PurePath(table.name).name != table.name
        ):
            fail("holds no table of a study", file=str(file), key=table.name)
    return replace(result, kept_in=str(file))
