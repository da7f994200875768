"""Imported by a child while its parent reads the scene: loads what every run needs and takes long.

Both loops, numba's tables of types and functions, which it else fills at the first compiled call, and the
library of ngspice.
"""

from numba.core.registry import cpu_target

import cosim.loop.linear.run_linear
import cosim.loop.spice.run_spice  # noqa: F401  both for what their import loads
from cosim.ngspice.simulator import Simulator

cpu_target.typing_context.refresh()
cpu_target.target_context.refresh()
Simulator()
