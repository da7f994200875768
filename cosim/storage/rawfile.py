"""The binary raw format of ngspice: written row by row, read by memory map.

A raw file is a text header and then the points, each one row of float64, in the machine's own byte
order. ngspice reads it with ``load``; so do viewers of the LTspice kind and spicelib.
The writer leaves room for the number of points and fills it in at the end, so a simulation of any
length streams through constant memory.
"""

import os
import time
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import BinaryIO, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cosim.errors import SimulationError, fail
from cosim.storage.staging import disk_errors

RAW = "signals.raw"
"""Its name in a result."""
_COUNT_WIDTH = 20
_BINARY = b"Binary:\n"
# A raw file wants a date: this one holds the place of the run's, see `stamp`.
_DATE = "Thu Jan  1 00:00:00  1970"
# By this line spicelib and PyLTSpice know whose form it is; ngspice takes it for a command, here a comment.
_COMMAND = "Command: * ngspice\n"


def kind_of(name: str) -> str:
    """Return the type that ngspice shows for a signal of this name."""
    if name == "time":
        return "time"
    if name.startswith("imot"):
        return "current"
    # Only voltages carry a unit that ngspice knows; mechanical quantities have none there.
    is_voltage = "." in name or name.rstrip("0123456789") in ("u", "cmd", "ksp", "ksd")
    return "voltage" if is_voltage else "notype"


class RawWriter:
    """Streams points into a raw file.

    Parameters
    ----------
    path
        File to write; an existing one is replaced.
    names
        Names of the signals, the first of them ``time``; no blanks.
    kinds
        ngspice's type of each signal (``time``, ``voltage``, ``current``, ``notype``); by default
        guessed from the name.
    title
        One line for the header.

    Raises
    ------
    InputError
        When the disk is full or the folder cannot be written.
    """

    def __init__(
        self,
        path: str | os.PathLike[str],
        names: Sequence[str],
        kinds: Sequence[str] | None = None,
        title: str = "cosim",
    ) -> None:
        self.path = Path(path)
        self.names = tuple(names)
        self.points = 0
        kinds = [kind_of(name) for name in names] if kinds is None else kinds
        if not self.names or len(set(self.names)) != len(self.names) or len(kinds) != len(self.names):
            raise ValueError("names must be unique and come with one kind each")
        if any(not name or any(c.isspace() for c in name) for name in self.names):
            raise ValueError("names of signals must not contain blanks")
        rows = "".join(
            f"\t{i}\t{name}\t{kind}\n" for i, (name, kind) in enumerate(zip(names, kinds, strict=True))
        )
        before = (
            f"Title: {' '.join(title.split())}\nDate: {_DATE}\nPlotname: Transient Analysis\n"
            f"{_COMMAND}Flags: real\nNo. Variables: {len(self.names)}\nNo. Points: "
        ).encode()
        after = f"\nVariables:\n{rows}".encode() + _BINARY
        # Blanks after the count put the points on a multiple of 8, where numpy maps them as they are.
        width = _COUNT_WIDTH + -(len(before) + _COUNT_WIDTH + len(after)) % 8
        self._count_at = len(before)
        with disk_errors(self.path):
            # An earlier result may share this file by a hard link: leave its contents alone.
            if self.path.is_file():
                self.path.unlink()
            self._file: BinaryIO = self.path.open("wb", buffering=1 << 20)
            self._file.write(before + b"0".ljust(width) + after)

    def append(self, block: ArrayLike) -> None:
        """Append points.

        Parameters
        ----------
        block
            Array of shape (points, signals), or (signals,) for one point.

        Raises
        ------
        SimulationError
            When a value is NaN or infinite, naming signal and time.
        InputError
            When the disk is full.
        """
        rows = np.ascontiguousarray(block, dtype=np.float64).reshape(-1, len(self.names))
        finite = np.isfinite(rows)
        if not finite.all():
            row, column = np.argwhere(~finite)[0]
            time_s = float(rows[row, 0]) if finite[row, 0] else None
            raise SimulationError(f"signal {self.names[column]} became {rows[row, column]}", time_s=time_s)
        with disk_errors(self.path):
            self._file.write(rows.data)
        self.points += len(rows)

    def close(self) -> None:
        """Fill in the number of points and close; closing twice does no harm."""
        if self._file.closed:
            return
        with disk_errors(self.path):
            try:
                self._file.seek(self._count_at)
                self._file.write(str(self.points).encode().ljust(_COUNT_WIDTH))
            finally:
                self._file.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def stamp(path: Path, date_s: float) -> None:
    """Write a date, in seconds since 1970, into a file of `RawWriter`; UTC, whatever the place and language.

    Raises
    ------
    InputError
        When it cannot be written.
    """
    day, _, year = time.asctime(time.gmtime(date_s)).rpartition(" ")
    with disk_errors(path), path.open("r+b") as stream:
        stream.readline()  # the title
        stream.write(f"Date: {day}  {year}".encode())


class Signals(Mapping[str, NDArray[np.float64]]):
    """Signals of a raw file by name, memory-mapped and read-only.

    Attributes
    ----------
    path
        The raw file.
    table
        All points, shape (points, signals), float64.
    """

    def __init__(self, path: Path, names: Sequence[str], table: NDArray[np.float64]) -> None:
        self.path = path
        self.table = table
        self._column = {name: i for i, name in enumerate(names)}

    def __getitem__(self, name: str) -> NDArray[np.float64]:
        column: NDArray[np.float64] = self.table[:, self._column[name]]
        return column

    def __iter__(self) -> Iterator[str]:
        return iter(self._column)

    def __len__(self) -> int:
        return len(self._column)


def read_raw(path: str | os.PathLike[str]) -> Signals:
    """Map a real binary raw file.

    Raises
    ------
    InputError
        When the file is missing, is no binary raw file of real numbers, or was cut short.
    """
    file = Path(path)
    try:
        with file.open("rb") as stream:
            head = stream.read(1 << 20)
    except OSError as error:
        fail(f"cannot be read: {error.strerror}", file=str(file))
    end = head.find(b"\n" + _BINARY)
    if end < 0:
        fail("is not a binary raw file of ngspice", file=str(file))
    fields, _, listing = head[:end].decode("utf-8", "replace").partition("\nVariables:")
    header = dict(line.split(": ", 1) for line in fields.splitlines() if ": " in line)
    if header.get("Flags", "").split()[:1] != ["real"]:
        fail("holds no real numbers", file=str(file), key="Flags", value=header.get("Flags"))
    names = [line.split()[1] for line in listing.splitlines() if len(line.split()) >= 3]
    try:
        points, variables = int(header["No. Points"]), int(header["No. Variables"])
    except (KeyError, ValueError):
        fail("has a damaged header", file=str(file))
    start, shape = end + 1 + len(_BINARY), (points, variables)
    try:
        missing = start + 8 * points * variables - file.stat().st_size
        if min(points, variables) < 0:
            fail("has a damaged header", file=str(file))
        if missing > 0 or len(names) != variables:
            fail(f"was cut short: {max(missing, 0)} bytes are missing", file=str(file))
        table = np.empty(shape)
        if points:
            table = np.memmap(file, dtype=np.float64, mode="r", offset=start, shape=shape)
    except OSError as error:  # another run has just put its own result in this place
        fail(f"cannot be read: {error.strerror}", file=str(file))
    return Signals(file, names, table)
