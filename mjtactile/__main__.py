"""`python -m mjtactile` is the command line."""

import sys

from mjtactile.cli import main

if __name__ == "__main__":
    sys.exit(main())
