"""Values as TOML: of a whole scene, and in one line."""

import json
import math
import os
from collections.abc import Mapping
from typing import Any

__all__ = ["inline_toml", "toml_key", "toml_value"]


def toml_key(key: str) -> str:
    """Return a key, in quotes where TOML asks for them.

    Examples
    --------
    >>> toml_key("period_s"), toml_key("xdiff1.r1")
    ('period_s', '"xdiff1.r1"')
    """
    bare = key.replace("_", "").replace("-", "")
    return key if bare.isalnum() and bare.isascii() else json.dumps(key)


def toml_value(value: Any) -> str:
    """Return a JSON-ready value as TOML.

    Examples
    --------
    >>> toml_value(True), toml_value([1.5, "a"])
    ('true', '[1.5, "a"]')
    """
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, float):
        assert math.isfinite(value)
        return repr(value)
    if isinstance(value, list):
        return "[" + ", ".join(toml_value(item) for item in value) + "]"
    # JSON's escapes are TOML's too, except for the surrogate pairs of ensure_ascii; DEL is missing.
    return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")


def inline_toml(value: Any) -> str:
    """Return a Python value, numpy's numbers and arrays included, as TOML in one line.

    Examples
    --------
    >>> inline_toml({"type": "mass", "mass_kg": 0.1})
    '{type = "mass", mass_kg = 0.1}'
    """
    if hasattr(value, "tolist"):
        value = value.tolist()
    if isinstance(value, Mapping):
        rows = (f"{toml_key(str(key))} = {inline_toml(item)}" for key, item in value.items())
        return "{" + ", ".join(rows) + "}"
    if isinstance(value, list | tuple):
        return "[" + ", ".join(inline_toml(item) for item in value) + "]"
    if isinstance(value, os.PathLike):
        return json.dumps(os.fspath(value), ensure_ascii=False)
    if isinstance(value, float) and not math.isfinite(value):
        return {math.inf: "inf", -math.inf: "-inf"}.get(value, "nan")  # refused with the key that it is for
    return toml_value(value)
