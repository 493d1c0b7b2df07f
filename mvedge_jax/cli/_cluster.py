"""Where a command's work runs: in this process, or on the workers of a Dask cluster."""

import contextlib
import threading
import uuid
from collections.abc import Callable, Iterator, Mapping
from typing import Any, NamedTuple

from mvedge_jax._cache import compilation_cache

from ._common import warn

# How often Dask repeats a call that raised. A worker that died is another matter: the scheduler's
# `allowed-failures` says after how many of them a call is given up.
_RETRIES = 2
# XLA has threads of its own: a worker runs one call at a time, however many threads it has.
_ALONE = threading.Lock()
# What a call raises alike on every worker.
_LASTING = (ValueError, FileExistsError)


class Outcome(NamedTuple):
    """What has become of a call.

    Attributes:
        name: of the call.
        value: what the function returned, or the exception that it raised.
        workers: addresses of the workers that began the call, in order, but for one that died
            within milliseconds; empty in this process.
    """

    name: str
    value: Any
    workers: tuple[str, ...]


@contextlib.contextmanager
def extra(who: str, name: str) -> Iterator[None]:
    """Imports from an extra, with a sentence where it is not installed."""
    try:
        yield
    except ModuleNotFoundError as missing:
        raise ValueError(f"{who} {missing.name}: pip install 'mvedge_jax[{name}]'.") from missing


@contextlib.contextmanager
def connected(workers: int, scheduler: str | None) -> Iterator[Any]:
    """A Dask client whose workers, later ones included, use the compilation cache.

    None without workers to start and without the address of a scheduler. Mistakes in either, and a
    missing Dask, are ValueErrors.
    """
    if workers < 0:
        raise ValueError(f"--workers must not be negative, got {workers}.")
    if not workers and scheduler is None:
        yield None
        return
    with extra("--workers and --scheduler need", "cluster"):
        from distributed import Client, LocalCluster
    with contextlib.ExitStack() as stack:
        address: Any = scheduler
        if address is None:
            cluster = LocalCluster(
                n_workers=workers, threads_per_worker=1, dashboard_address=":0", processes=True
            )
            address = stack.enter_context(cluster)
        try:
            client = stack.enter_context(Client(address))
        except (OSError, ValueError) as reason:
            raise ValueError(
                f"no Dask scheduler answers at {address} (--scheduler; expected an address such as "
                f"tcp://host:8786): {reason}"
            ) from reason
        client.register_worker_callbacks(compilation_cache)
        if not client.scheduler_info()["workers"]:
            warn(f"the scheduler at {address} has no workers yet; waiting for the first")
        yield client


def outcomes(
    client: Any, function: Callable[..., Any], calls: Mapping[str, tuple]
) -> Iterator[Outcome]:
    """Calls a function with each of several arguments; a call that fails stops no other.

    Without a client a call begins when the outcome before it was taken, and only mistakes of the
    user's files are outcomes. With one, calls run on its workers, and outcomes come as they are
    finished; calls of a worker that died, and those that raised what may pass, run again.
    """
    if client is not None:
        yield from _on_workers(client, function, calls)
        return
    for name, arguments in calls.items():
        try:
            value = function(*arguments)
        except (ValueError, OSError, MemoryError) as reason:
            value = reason
        yield Outcome(name, value, ())


def _on_workers(
    client: Any, function: Callable[..., Any], calls: Mapping[str, tuple]
) -> Iterator[Outcome]:
    from distributed import as_completed

    run = f"mvedge-{uuid.uuid4().hex}"
    begun: dict[str, list[str]] = {name: [] for name in calls}
    # A worker tells that it begins a call before it can tell that it is done.
    client.subscribe_topic(run, lambda event: begun[event[1][0]].append(event[1][1]))
    try:
        names = {
            client.submit(
                _on_worker, run, name, function, *arguments, key=f"{run}-{name}", retries=_RETRIES
            ): name
            for name, arguments in calls.items()
        }
        for future in as_completed(names):
            name = names.pop(future)
            try:
                value = future.result()
            except Exception as reason:
                value = reason
            yield Outcome(name, value, tuple(begun[name]))
    finally:
        client.unsubscribe_topic(run)


def _on_worker(run: str, name: str, function: Callable[..., Any], *arguments: Any) -> Any:
    """Runs on a worker; what would fail there again is returned, lest Dask repeat it."""
    from distributed import get_worker

    with _ALONE:
        worker = get_worker()
        worker.log_event(run, (name, worker.address))
        try:
            return function(*arguments)
        except _LASTING as mistake:
            return mistake


def reason_of(failure: BaseException) -> str:
    """An exception in a sentence; one that is no mistake of the user's comes with its type."""
    told = isinstance(failure, ValueError | OSError | MemoryError)
    return str(failure) if told else f"{type(failure).__name__}: {failure}"
