"""`python -m mvedge_jax`, the same as `mvedge`."""

import sys

from mvedge_jax.cli import main

if __name__ == "__main__":
    sys.exit(main())
