"""Tolerances: what the devices that are built from one design will do."""
