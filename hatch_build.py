"""Takes the built site (`make docs`) along in wheel and sdist, where there is one: `cosim docs` serves it."""

from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface


class BuiltSite(BuildHookInterface):  # type: ignore[misc,type-arg]
    """Adds the folder ``site`` to what is built; without it the package has no pages and says so."""

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Add the site, under the name that the installed package looks for."""
        site = Path(self.root) / "site"
        if version != "editable" and (site / "index.html").is_file():
            build_data["force_include"][str(site)] = (
                "cosim/data/docs" if self.target_name == "wheel" else "site"
            )
