"""Where the batches of a sweep run, unless the user says where."""

import contextlib
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor, wait
from typing import Any, NamedTuple, Protocol, runtime_checkable


@runtime_checkable
class Future(Protocol):
    """What `submit` returns: `concurrent.futures.Future`, or that of Dask."""

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
    """`submit` of some threads of this process.

    The first call for a scene and its choices runs by itself: it may have to compile, and threads
    that come to a program together compile it once each.

    Args:
        count: calls at a time.

    Yields:
        What takes `evaluate` and its arguments.
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
        # After a mistake, or Ctrl-C, what has not begun is not waited for.
        pool.shutdown(cancel_futures=True)
