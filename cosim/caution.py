"""`Caution`: something in a result that a person should doubt, and what to do about it.

A caution is no error: the run is complete. It is printed on the terminal, stands at the head of the page and
in ``run.json`` under ``warnings``; ``--strict`` turns every caution into an error.
"""

from dataclasses import dataclass

__all__ = ["Caution"]


@dataclass(frozen=True)
class Caution:
    """One doubt about a result.

    Attributes
    ----------
    code
        Stable identifier for machines, in kebab case: ``amplifier-clipped``.
    text
        What was seen, with its numbers and units, as a short sentence without a full stop.
    advice
        What to do about it, as a short sentence without a full stop.
    """

    code: str
    text: str
    advice: str

    def __str__(self) -> str:
        return f"{self.text}: {self.advice}"

    def as_dict(self) -> dict[str, str]:
        """Return the caution as JSON-ready fields."""
        return {"code": self.code, "text": self.text, "advice": self.advice}
