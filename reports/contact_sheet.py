"""All pictures of some folders on one sheet, to be looked at: `python -m reports.contact_sheet FOLDER`."""

import argparse
import math
from pathlib import Path

from matplotlib.image import imread

from reports.style import INK, figure, look, pictures

__all__ = ["contact_sheet"]

#: Width of a cell, and the height that the tallest picture gets [in].
_CELL_IN, _TALL_IN = 3.0, 2.6


def contact_sheet(folders: list[Path], columns: int = 4) -> bytes:
    """Return a PNG of every picture in folders, and in folders below, each with its path.

    Parameters
    ----------
    folders
        Searched for ``*.png``, in this order.
    columns
        Pictures in a row.

    Raises
    ------
    ValueError
        Where there is no picture.

    Examples
    --------
    >>> from pathlib import Path
    >>> contact_sheet([Path("no-such-folder")])
    Traceback (most recent call last):
        ...
    ValueError: no picture in no-such-folder
    """
    files = [(folder, path) for folder in folders for path in sorted(folder.rglob("*.png"))]
    if not files:
        raise ValueError(f"no picture in {', '.join(map(str, folders))}")
    rows = math.ceil(len(files) / columns)
    with look():
        drawing, grid = figure(rows * _TALL_IN, rows, columns)
        drawing.set_size_inches(columns * _CELL_IN, rows * _TALL_IN)
        for axes in grid.flat:
            axes.set_axis_off()
        for axes, (folder, path) in zip(grid.flat, files, strict=False):
            axes.imshow(imread(path), interpolation="antialiased")
            name = path.relative_to(folder).as_posix()
            axes.set_title(f"{folder.name}/{name}"[-52:], fontsize=6, fontweight="normal", color=INK)
        return pictures(drawing)["png"]


def main() -> None:
    """Write a sheet."""
    parser = argparse.ArgumentParser(prog="python -m reports.contact_sheet", description=main.__doc__)
    parser.add_argument("folders", nargs="+", type=Path, help="folders with pictures")
    parser.add_argument("-o", "--out", type=Path, default=Path("out/contact_sheet.png"), help="file to write")
    parser.add_argument("--columns", type=int, default=4, help="pictures in a row")
    asked = parser.parse_args()
    asked.out.parent.mkdir(parents=True, exist_ok=True)
    asked.out.write_bytes(contact_sheet(asked.folders, asked.columns))
    print(f"wrote {asked.out}")


if __name__ == "__main__":
    main()
