"""Where the netlists, scenes and pages that come with the program are."""

from pathlib import Path

from cosim.errors import CosimError

_PACKAGE = Path(__file__).resolve().parent


def assets_folder() -> Path:
    """Return the folder that holds ``netlists/`` and ``scenes/``.

    Inside an installed wheel it is ``cosim/data``; in a checkout it is the root of the repository.
    """
    for folder in (_PACKAGE / "data", _PACKAGE.parent):
        if (folder / "netlists").is_dir() and (folder / "scenes").is_dir():
            return folder
    raise CosimError(f"the installation is incomplete: no netlists and scenes beside {_PACKAGE}")


def netlists_folder() -> Path:
    """Return the folder with the boards, ``blocks/``, ``parts/`` and ``tb/``."""
    return assets_folder() / "netlists"


def scenes_folder() -> Path:
    """Return the folder with the scenes of the paper."""
    return assets_folder() / "scenes"


def docs_folder() -> Path:
    """Return the folder of the documentation's site: inside a wheel, or as ``make docs`` has built it.

    Raises
    ------
    CosimError
        Where there is none.
    """
    for folder in (_PACKAGE / "data" / "docs", _PACKAGE.parent / "site"):
        if (folder / "index.html").is_file():
            return folder
    raise CosimError("the documentation is not built here: `make docs` in a checkout builds it into site/")
