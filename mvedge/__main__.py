"""`python -m mvedge`, the same as `mvedge`."""

import sys

from mvedge import run

if __name__ == "__main__":
    sys.exit(run())
