"""A scene as one plain ngspice deck, to be run without this program."""

from cosim.export.scene_deck import command, export

__all__ = ["command", "export"]
