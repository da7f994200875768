"""Tests compile into the same folder as the program, so that both are warm after the first run."""

import os

from cosim.compiled import cache_folder

os.environ["NUMBA_CACHE_DIR"] = cache_folder()
# results carry the date of their run: for tests that compare bytes all have the same
os.environ.setdefault("SOURCE_DATE_EPOCH", "0")
