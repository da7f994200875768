"""The one way up from a result to its pictures: results draw themselves by `reports.notebook`.

It is loaded when a result is asked for a picture, so that matplotlib costs nothing before.
"""

from importlib import import_module
from typing import Any

__all__ = ["view"]


def view(function: str, *arguments: object) -> Any:
    """Call a function of `reports.notebook`; it returns a matplotlib figure, or HTML as text."""
    return getattr(import_module("reports.notebook"), function)(*arguments)
