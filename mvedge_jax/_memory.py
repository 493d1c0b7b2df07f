"""Memory that the C library holds back."""

import contextlib
import ctypes


def release_memory() -> None:
    """Returns freed memory to the system, where the C library would keep it (glibc).

    The compiler leaves almost a gigabyte behind after the whole chain, beside which the arrays of
    the first run would otherwise be put.
    """
    with contextlib.suppress(OSError, AttributeError):
        ctypes.CDLL("libc.so.6").malloc_trim(0)
