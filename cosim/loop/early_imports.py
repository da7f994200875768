"""Imported by a child while its parent reads the scene: loads what every run needs and takes long.

Both loops, and the library of ngspice.
"""

import cosim.loop.linear.run_linear
import cosim.loop.spice.run_spice  # noqa: F401  both for what their import loads
from cosim.ngspice.simulator import Simulator
from mech.library import load

Simulator()
for package in ("cosim.loop.linear", "cosim.loop.spice"):
    load(package)
