"""One place where Ctrl-C and its like are heard, whatever the main thread is busy with."""

import os
import signal
import sys
import threading

from ._help import answer


def run() -> int:
    """Runs the command line; the overview of commands and the version need no library.

    Returns:
        The exit code, see `mvedge_jax.cli.main`.
    """
    code = answer(sys.argv[1:])
    if code is not None:
        return code
    listen()
    from mvedge_jax.cli import main

    return main()


def listen() -> None:
    """Has one thread wait for signals; to be called before any other thread is there.

    The handlers of Python's own run between two steps of the main thread, and so not within the
    minute that a compilation takes, nor safely within an import. Here signals are blocked in every
    thread and one thread waits for them: it has the unfinished result removed, says so in a line,
    and ends the process with 128 plus the number of the signal.
    """
    if hasattr(signal, "pthread_sigmask"):
        heard = {signal.SIGINT, signal.SIGTERM, signal.SIGHUP}
        # A signal that the parent has ignored, as nohup does, stays so.
        heard = {number for number in heard if signal.getsignal(number) is not signal.SIG_IGN}
        signal.pthread_sigmask(signal.SIG_BLOCK, heard)
        threading.Thread(target=_wait, args=(heard,), name="signals", daemon=True).start()


def _wait(heard: set[signal.Signals]) -> None:
    number = signal.sigwait(heard)
    # Before this module is imported nothing was written yet.
    interruption = sys.modules.get("mvedge_jax.cli._interruption")
    clean = getattr(interruption, "clean", None)
    if clean is not None:
        clean()
    os.write(2, b"interrupted; nothing was left half-written\n")
    os._exit(128 + number)
