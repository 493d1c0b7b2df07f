"""The command line, `mvedge`."""

from ._main import main as main
