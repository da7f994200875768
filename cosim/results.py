"""`Run`: what a simulation leaves behind, in memory and in a folder.

A result folder holds

* ``signals.raw``: every recorded point, ngspice's binary raw format;
* ``signals.parquet`` and, on request, ``signals.csv``: the same for other tools;
* ``samples.csv``: one row for each sample of the computer;
* ``board.json``: the board that ran, flat, for comparisons with later ones (written by `cosim.runner`);
* ``scene.toml``: the resolved scene, every key stated, to be run again;
* ``run.json``: resolved scene, plan, events, measures, energy ledger, statistics, provenance.
"""

import csv
import importlib
import importlib.util
import json
import os
import shutil
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cosim.caution import Caution, caution_of
from cosim.errors import CosimError, InputError, fail
from cosim.notebook_view import view
from cosim.scene import Scene, scene_from_dict
from cosim.storage import field_types
from cosim.storage.checksums import check_files, file_sums, intact, listed, read_sealed, sealed
from cosim.storage.rawfile import RAW, Signals, read_raw
from cosim.storage.results_nearby import results_below
from cosim.storage.run_record import Record
from cosim.storage.staging import Staging, disk_errors
from cosim.units import heading, name_of, sample_unit, signal_unit

SAMPLES, RECORD, SCENE = "samples.csv", "run.json", "scene.toml"
BOARD = "board.json"
FORMATS = ("parquet", "csv")
_FORMAT_VERSION = 3
#: Versions that can be read; 2 has `printed` under the name "said".
_READABLE = (2, _FORMAT_VERSION)
#: What a result is checked for when it is loaded; the other forms of the signals are for other tools.
_SEALED = (RAW, SAMPLES, SCENE, BOARD)
#: Further forms of the signals, which are never read back.
_FORMS = tuple(f"signals.{ending}" for ending in FORMATS)
#: Where `cosim report` puts its page by default.
PAGE_FOLDER = "report"
# Rows handled at once when exporting: some megabytes, whatever the length of the run.
_CHUNK = 1 << 15


@dataclass(frozen=True)
class Run:
    """A finished simulation.

    Attributes
    ----------
    scene
        The scene that ran.
    signals
        Recorded signals by name, memory-mapped, one value an accepted time point, SI units.
    samples
        What the computer saw and wrote, one value a sample, SI units.
    plan
        Effects in force, circuit model and what was left out, JSON-ready.
    events
        What happened and when, JSON-ready.
    measures
        Name -> {value, unit, text}.
    ledger
        Energies [J] by name and how well they close.
    stats
        Wall time, points, rejected points and the like.
    provenance
        Versions, seed and command, see `provenance`.
    warnings
        What a person should doubt about the result.
    printed
        Lines that the user's own law and measures printed.

    Examples
    --------
    >>> from cosim.assets import scenes_folder
    >>> import cosim
    >>> scene = cosim.load_scene(scenes_folder() / 'press.toml', ['duration_s=0.05'])
    >>> run = cosim.run(scene, estimate=False)
    >>> run.measures['peak_force']['unit'], Run.load(run.signals.path.parent).scene == run.scene
    ('N', True)
    """

    scene: Scene
    signals: Signals
    samples: Mapping[str, NDArray[np.float64]]
    plan: Mapping[str, Any] = field(default_factory=dict)
    events: Sequence[Mapping[str, Any]] = ()
    measures: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    ledger: Mapping[str, Any] = field(default_factory=dict)
    stats: Mapping[str, Any] = field(default_factory=dict)
    provenance: Mapping[str, Any] = field(default_factory=dict)
    warnings: Sequence[Caution] = ()
    printed: Sequence[str] = ()

    def to_dataframe(self, of: str = "signals") -> Any:
        """Return the signals [one row a time point] or the samples [one row a sample] as a table.

        Parameters
        ----------
        of
            'signals' or 'samples'; SI units, as `units.signal_unit` and `units.sample_unit` tell.

        Returns
        -------
        pandas.DataFrame or polars.DataFrame
            Of whichever is installed, pandas first.

        Raises
        ------
        ImportError
            Where neither is installed.
        ValueError
            For another `of`.
        """
        if of not in ("signals", "samples"):
            raise ValueError(f"of must be 'signals' or 'samples', not {of!r}")
        table = self.signals if of == "signals" else self.samples
        for library in ("pandas", "polars"):
            if importlib.util.find_spec(library) is not None:
                return importlib.import_module(library).DataFrame(
                    {name: np.asarray(column) for name, column in table.items()}
                )
        raise ImportError("a table needs pandas or polars: pip install pandas")

    def plot(self, name: str | None = None) -> Any:
        """Return a matplotlib figure: 'path', 'tangent_normal', 'zoom', 'currents', 'gains', 'headroom', ...

        Parameters
        ----------
        name
            Of `reports.page.FIGURES`; the first that the run fills when not given.

        Raises
        ------
        ValueError
            For an unknown name, or a figure for which the run lacks the signals.
        """
        return view("figure", self, name)

    def _repr_html_(self) -> str:
        """Return summary, cautions, measures with units and the main picture, for notebooks."""
        text: str = view("html", self)
        return text

    def save(self, folder: str | os.PathLike[str], formats: Collection[str] = ("parquet",)) -> Path:
        """Write the result folder whole, or not at all.

        Parameters
        ----------
        folder
            Must not exist, be empty, or hold an earlier result, which is replaced.
        formats
            Further forms of the signals, of `FORMATS`.

        Returns
        -------
        Path
            The folder.

        Raises
        ------
        InputError
            When it cannot be written or is somebody else's; nothing is left behind then.
        """
        with Staging(folder, written_files) as stage:
            self.write_into(stage.path, formats)
            stage.publish()
            return stage.target

    def write_into(self, folder: Path, formats: Collection[str] = ("parquet",)) -> None:
        """Write the files into an existing folder, which may already hold the raw file."""
        unknown = set(formats) - set(FORMATS)
        if unknown:
            raise ValueError(f"unknown formats {sorted(unknown)}; known are {FORMATS}")
        raw = folder / RAW
        with disk_errors(folder):
            if self.signals.path.absolute() != raw.absolute():
                _link_or_copy(self.signals.path, raw)
            if "parquet" in formats:
                write_parquet(folder / "signals.parquet", self.signals)
            if "csv" in formats:
                write_csv(folder / "signals.csv", self.signals, signal_unit)
            write_csv(folder / SAMPLES, self.samples, sample_unit)
            (folder / SCENE).write_text(self.scene.to_toml(), encoding="utf-8")
            sums = {"files": file_sums(folder, _SEALED), "forms": file_sums(folder, _FORMS)}
            plain = json.loads(json_text({**self._record(), **sums}, indent=None))
            (folder / RECORD).write_text(json_text(sealed(plain)) + "\n", encoding="utf-8")

    def _record(self) -> dict[str, Any]:
        return {
            "format": _FORMAT_VERSION,
            "title": self.scene.title,
            "scene": self.scene.as_dict(),
            "scene_digest": self.scene.digest(),
            "warnings": [caution.as_dict() for caution in self.warnings],
            "printed": list(self.printed),
            "plan": self.plan,
            "measures": self.measures,
            "ledger": self.ledger,
            "events": list(self.events),
            "stats": self.stats,
            "provenance": self.provenance,
        }

    @staticmethod
    def load(folder: str | os.PathLike[str]) -> "Run":
        """Load a result folder; the signals stay on the disk.

        Raises
        ------
        InputError
            When the folder holds no result, or a damaged one.
        """
        place = Path(folder)
        if not os.path.lexists(place):
            fail("no such file or folder", file=str(place))
        if not os.path.isfile(place / RECORD):
            fail(
                "is not a result folder: it holds no run.json" + results_below(place, (RECORD,)),
                file=str(place),
            )
        record = read_sealed(place / RECORD, *_READABLE)
        if "said" in record:
            record["printed"] = record.pop("said")
        field_types.check(record, Record, str(place / RECORD))
        check_files(place, {**dict.fromkeys((RAW, SAMPLES, SCENE), ""), **record["files"]})
        try:
            scene = scene_from_dict(record["scene"])
        except InputError as error:  # written when a scene had other keys
            problems = [replace(problem, file=str(place / RECORD)) for problem in error.problems]
            raise InputError(problems) from error
        signals, samples = read_raw(place / RAW), read_csv(place / SAMPLES)
        _check_times(place / RAW, signals)
        _check_times(place / SAMPLES, samples)
        return Run(
            scene=scene,
            signals=signals,
            samples=samples,
            plan=record["plan"],
            events=record["events"],
            measures=record["measures"],
            ledger=record["ledger"],
            stats=record["stats"],
            provenance=record["provenance"],
            warnings=tuple(map(caution_of, record["warnings"])),
            printed=tuple(map(str, record["printed"])),
        )


def _check_times(file: Path, table: Mapping[str, NDArray[np.float64]]) -> None:
    """Refuse signals that no run has: without time, with time running back, with values that are not finite.

    Their seal may be right all the same: anyone can seal what they wrote.
    """
    times = np.asarray(table["time"]) if "time" in table else np.zeros(0)
    if ("time" not in table and len(table)) or (isinstance(table, Signals) and not times.size):
        fail("holds nothing of a run over time", file=str(file), key="time")
    tables = [table.table] if isinstance(table, Signals) else [*table.values()]
    for block in (part[at : at + _CHUNK] for part in tables for at in range(0, len(part), _CHUNK)):
        if not np.isfinite(block).all():
            fail("holds what is no finite number", file=str(file))
    if (np.diff(times) < 0.0).any():
        fail("holds times that run back", file=str(file), key="time")


def written_files(folder: Path) -> set[str]:
    """Return the relative paths in a result folder that a run and its page wrote, unchanged since.

    Where the record is missing, damaged or of another version, nothing can be proven.
    """
    try:
        record = read_sealed(folder / RECORD, *_READABLE)
    except InputError:
        return set()
    page = {f"{PAGE_FOLDER}/{name}" for name in listed(folder / PAGE_FOLDER)}
    return {RECORD, *intact(folder, record.get("files")), *intact(folder, record.get("forms")), *page}


def json_text(value: Any, indent: int | None = 2) -> str:
    """Return `value` as JSON; takes numpy's numbers, refuses NaN and infinity.

    Raises
    ------
    CosimError
        When a number is not finite, with the path that leads to it.
    """
    try:
        return json.dumps(value, indent=indent, ensure_ascii=False, allow_nan=False, default=_plain)
    except ValueError:
        bad = _not_finite(value, "")
        if bad is None:
            raise
        raise CosimError(f"internal: {bad} is not a finite number and would not be valid JSON") from None


def _plain(value: Any) -> Any:
    if isinstance(value, np.generic | np.ndarray):
        return value.tolist()
    if isinstance(value, Path):
        return str(value)
    if isinstance(value, Mapping):
        return dict(value)
    raise TypeError(f"{type(value).__name__} is not JSON-ready")


def _not_finite(value: Any, path: str) -> str | None:
    if isinstance(value, float | np.floating | np.ndarray):
        return None if np.all(np.isfinite(value)) else (path or "value")
    items = (
        value.items()
        if isinstance(value, Mapping)
        else enumerate(value)
        if isinstance(value, list | tuple)
        else ()
    )
    return next((bad for key, item in items if (bad := _not_finite(item, f"{path}.{key}".lstrip(".")))), None)


def write_csv(
    path: Path, columns: Mapping[str, NDArray[Any]], unit: Callable[[str], str] = lambda name: ""
) -> None:
    """Write columns of equal length; numbers keep every digit, headings carry the unit of their name."""
    length = len(next(iter(columns.values()))) if columns else 0
    with disk_errors(path), path.open("w", encoding="utf-8", newline="") as stream:
        writer = csv.writer(stream, lineterminator="\n")
        writer.writerow([heading(name, unit(name)) for name in columns])
        for start in range(0, length, _CHUNK):
            block = [column[start : start + _CHUNK].tolist() for column in columns.values()]
            writer.writerows(zip(*block, strict=True))


def read_csv(path: Path) -> dict[str, NDArray[np.float64]]:
    """Read columns of numbers written by `write_csv`, by their names without the units.

    Raises
    ------
    InputError
        When it cannot be read, or holds a value that is not finite.
    """
    try:
        with path.open(encoding="utf-8", newline="") as stream:
            names = [name_of(each) for each in next(csv.reader([stream.readline()]), [])]
            table = np.empty((0, len(names)))
            if stream.tell() < path.stat().st_size:
                table = np.loadtxt(stream, delimiter=",", comments=None, ndmin=2)
    except (OSError, ValueError) as error:
        fail(f"cannot be read: {error}", file=str(path))
    if table.shape[1] != len(names) or len(set(names)) < len(names):
        fail(f"has {len(names)} headings over {table.shape[1]} columns", file=str(path))
    if not np.isfinite(table).all():
        row, column = np.argwhere(~np.isfinite(table))[0]
        fail("is not a finite number", file=str(path), line=int(row) + 2, key=names[column])
    return {name: np.ascontiguousarray(table[:, i]) for i, name in enumerate(names)}


def write_parquet(path: Path, columns: Mapping[str, NDArray[Any]]) -> None:
    """Write columns of equal length as Parquet, a piece at a time."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    schema = pa.schema([(name, pa.from_numpy_dtype(column.dtype)) for name, column in columns.items()])
    length = len(next(iter(columns.values()))) if columns else 0
    with disk_errors(path), pq.ParquetWriter(path, schema) as writer:
        for start in range(0, length, _CHUNK):
            block = [
                pa.array(np.ascontiguousarray(column[start : start + _CHUNK])) for column in columns.values()
            ]
            writer.write_table(pa.Table.from_arrays(block, schema=schema))


def _link_or_copy(source: Path, target: Path) -> None:
    try:
        os.link(source, target)
    except OSError:  # another file system, or one without links
        shutil.copyfile(source, target)
