"""``[tolerance]``: by how much components of the built device vary, and which change of a measure matters.

One table for both, since their names differ: `resistors` and the like are classes of components, every other
key is a measure.
"""

from collections.abc import Mapping
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Discriminator, Field, Tag

__all__ = ["CLASSES", "Tolerance", "Tolerated"]


def _kind(value: object) -> str:
    return "<text>" if isinstance(value, str) else "<share>"


Tolerated = Annotated[
    Annotated[float, Field(ge=1e-12, le=1), Tag("<share>")] | Annotated[str, Tag("<text>")],
    Discriminator(_kind),
]


class Tolerance(BaseModel):
    """``[tolerance]``: defaults of a class of components, tolerances by name, and changes of measures.

    A default counts for what the netlist gives no tolerance. All are written as in a netlist: "1%",
    "lot=5% dev=1%", "5% uniform"; a bare number is a share.
    """

    model_config = ConfigDict(frozen=True, extra="allow", strict=True, allow_inf_nan=False, defer_build=True)
    __pydantic_extra__: dict[str, Tolerated] = Field(init=False)

    resistors: Tolerated | None = None
    capacitors: Tolerated | None = None
    inductors: Tolerated | None = None
    gbw: Tolerated | None = None
    offset: Tolerated | None = None
    vca_gain: Tolerated | None = None
    pot_linearity: Tolerated | None = None
    k_t: Tolerated | None = None
    link_length: Tolerated | None = None
    mass: Tolerated | None = None
    friction: Tolerated | None = None
    components: Mapping[str, Tolerated] = {}
    series: Literal["E6", "E12", "E24", "E48", "E96", "E192"] | None = None
    calibration: Literal["none", "gains"] = "none"
    trim: Mapping[str, str] = {}

    @property
    def measures(self) -> dict[str, Any]:
        """Changes of measures that ``effects = "auto"`` may leave out, by measure."""
        return dict(self.__pydantic_extra__ or {})

    @property
    def classes(self) -> dict[str, float | str]:
        """Tolerances by class of component, of those that state one."""
        stated = {name: getattr(self, name) for name in CLASSES}
        return {name: value for name, value in stated.items() if value is not None}

    def without_measures(self) -> "Tolerance":
        """Return the table without the changes of measures."""
        return Tolerance.model_validate({name: getattr(self, name) for name in type(self).model_fields})


#: Classes of components with a default tolerance.
CLASSES = (
    "resistors", "capacitors", "inductors", "gbw", "offset", "vca_gain", "pot_linearity", "k_t",
    "link_length", "mass", "friction",
)  # fmt: skip
