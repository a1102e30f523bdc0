"""Run the command line with ``python -m sklearn_vbjfa``."""

import sys

from sklearn_vbjfa._cli import main

if __name__ == "__main__":
    sys.exit(main())
