"""Tests compile into the same folder as the program, so that both are warm after the first run."""

import os

from cosim.compiled import cache_folder

os.environ["NUMBA_CACHE_DIR"] = cache_folder()
