"""What a process that measures samples has ready before its first one: modules, schemes, versions.

The pool's template imports this once and copies itself for each worker. Nothing here keeps
what depends on the environment.
"""

from cosim.quick_start import defer

defer()

import scipy.special  # noqa: E402 (of distributions; loads lazily otherwise)

import cosim.tolerance.preparation  # noqa: E402, F401
from cosim.provenance import packages  # noqa: E402
from cosim.scene import Scene  # noqa: E402

__all__ = ["SPECIAL"]

#: Kept for the import alone.
SPECIAL = scipy.special

packages()
Scene.model_rebuild()
