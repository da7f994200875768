"""A scene as one plain ngspice deck, to be run without this program."""

from cosim.export.deck import export

__all__ = ["export"]
