"""What every table of a scene has in common."""

from typing import Any

from pydantic import BaseModel, ConfigDict, Field
from pydantic_core import PydanticCustomError

#: Strict validation accepts only members of an enum; in a TOML file a choice is a word.
WORD = Field(strict=False)


class Table(BaseModel):
    """Base of all tables of a scene.

    Their checks are built with those of the first scene that is read, as one; a process that only receives
    scenes builds none. So a default is made by `model_construct`: a call would build the table's own checks.
    """

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True, allow_inf_nan=False, defer_build=True)


def no_bool(value: Any) -> Any:
    """Refuse true and false where a number is asked for."""
    # True equals 1, so a list of allowed integers alone would let it pass.
    if isinstance(value, bool):
        raise PydanticCustomError("literal_error", "is not one of the choices")
    return value
