"""Results below a folder that is none itself: what somebody who names the folder of all results means."""

import os
from collections.abc import Collection
from pathlib import Path

__all__ = ["results_below"]

_SHOWN, _LOOKED_AT = 8, 1000


def results_below(folder: Path, records: Collection[str]) -> str:
    """Return which folders up to two levels below hold one of the records, in words; empty for none.

    Examples
    --------
    >>> from tempfile import TemporaryDirectory
    >>> with TemporaryDirectory() as top:
    ...     for name in ('press', 'drop'):
    ...         (Path(top) / name).mkdir()
    ...         _ = (Path(top) / name / 'run.json').write_text('')
    ...     results_below(Path(top), ['run.json'])
    '; name one of those below it: drop, press'
    """
    folders = []
    for inner in _folders(folder):
        for each in (inner, *_folders(inner)):
            if any(os.path.isfile(each / record) for record in records):
                folders.append(each.relative_to(folder).as_posix())
    shown = folders[:_SHOWN] + ([f"and {len(folders) - _SHOWN} more"] if len(folders) > _SHOWN else [])
    return f"; name one of those below it: {', '.join(shown)}" if folders else ""


def _folders(folder: Path) -> list[Path]:
    try:
        with os.scandir(folder) as entries:
            names = [entry.name for _, entry in zip(range(_LOOKED_AT), entries, strict=False)
                     if entry.is_dir(follow_symlinks=False) and not entry.name.startswith(".")]  # fmt: skip
    except OSError:  # unreadable, or no folder: then nothing is below
        return []
    return [folder / name for name in sorted(names)]
