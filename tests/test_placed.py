"""Values of placed components against netlists that were edited by hand."""

import re
import time

import pytest
from extraction_boards import NETLISTS, extract, shipped

from cosim.errors import InputError
from cosim.ngspice.deck import load_deck
from cosim.ngspice.placed import Placed
