"""Circuit-level co-simulation of haptic devices."""

import os

from cosim.numba_cache import LOCATORS, cache_folder

__version__ = "0.1.0"

# numba reads it when it is imported: every process that compiles keeps its code in the same place
os.environ.setdefault("NUMBA_CACHE_DIR", cache_folder())
os.environ.setdefault("NUMBA_CACHE_LOCATOR_CLASSES", LOCATORS)
