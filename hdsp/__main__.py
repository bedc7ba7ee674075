"""``python -m hdsp``: the command ``hdsp``."""

import sys

from hdsp.planning.cli import main

if __name__ == "__main__":
    sys.exit(main())
