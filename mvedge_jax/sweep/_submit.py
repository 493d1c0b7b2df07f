"""The default executor of a sweep's batches: threads of this process."""

import contextlib
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor, wait
from typing import Any, NamedTuple, Protocol, runtime_checkable


@runtime_checkable
class Future(Protocol):
    """The result of `submit`: `concurrent.futures.Future`, or that of Dask."""

    def result(self) -> Any:
        """Waits for the value."""
        ...


Submit = Callable[..., Future]


class _Done(NamedTuple):
    value: Any

    def result(self) -> Any:
        return self.value


@contextlib.contextmanager
def in_threads(count: int) -> Iterator[Submit]:
    """`submit` of some threads of this process, for `evaluate` and its arguments.

    The first call for a scene and its choices runs alone, because threads that reach an uncompiled
    program together would each compile it.
    """
    seen: set[Any] = set()
    begun: list[Any] = []
    pool = ThreadPoolExecutor(count, thread_name_prefix="sweep")

    def submit(function: Callable, scene: Any, *arguments: Any, **options: Any) -> Future:
        program = id(scene), tuple(sorted(options["choices"].items()))
        if count == 1 or program not in seen:
            seen.add(program)
            wait(begun)
            begun.clear()
            return _Done(function(scene, *arguments, **options))
        begun.append(pool.submit(function, scene, *arguments, **options))
        return begun[-1]

    try:
        yield submit
    finally:
        # After an error or Ctrl-C, pending calls are canceled.
        pool.shutdown(cancel_futures=True)
