"""Imported by a child that will run on `linear` or `ideal` only, and needs no library of ngspice for it."""

import cosim.loop.linear.run_linear  # noqa: F401  for what its import loads
from mech.library import load

load("cosim.loop.linear")
