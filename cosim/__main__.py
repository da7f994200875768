"""``python -m cosim``: the command line."""

import sys

from cosim.cli import main

if __name__ == "__main__":
    sys.exit(main())
