"""Mechanics of the device: linkage, friction, operators. Knows no circuit."""
