"""The command `mvedge`, which listens for signals before it imports the libraries it needs."""

from ._run import run as run
