"""`python -m mvedge_jax`, the same as `mvedge`."""

import sys

from .cli import main

if __name__ == "__main__":
    sys.exit(main())
