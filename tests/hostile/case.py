"""What a hostile case is, and what may come of it."""

import random
import time
import warnings
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np

from mvedge_jax import LightField

# Seconds within which a file must be refused, and characters of a message: two lines of a terminal.
PROMPT, LONGEST = 5.0, 420


class Case(NamedTuple):
    """One hostile input: what runs in an empty folder and raises `AssertionError` if it is wrong.

    `fast` ones are run by the ordinary tests, too; `place` is where the case is defined.
    """

    name: str
    run: Callable[[Path], None]
    fast: bool = True
    place: tuple[str, int] = ("", 0)


CASES: dict[str, Case] = {}


def hostile(name: str, values: Iterable[Any] = ((),), *, fast: bool = True) -> Callable:
    """Makes a function of a folder, and of a value, a case for each of some values.

    Tuples are several arguments; in a dictionary, values have names of their own. What is in braces
    in the name of a case stands for the value.
    """
    named = values.items() if isinstance(values, dict) else [(value, value) for value in values]

    def register(function: Callable) -> Callable:
        place = function.__code__.co_filename, function.__code__.co_firstlineno
        for label, value in named:
            labels, arguments = (x if isinstance(x, tuple) else (x,) for x in (label, value))
            case = Case(name.format(*labels), lambda f, a=arguments: function(f, *a), fast, place)
            # The search for doctests imports a file under a name of its own.
            known = CASES.get(case.name, case)
            assert known.place == place, f"twice: {case.name}"
            CASES[case.name] = case
        return function

    return register


def sentence(error: BaseException, *mentions: str) -> None:
    """A message that a user can read: one line that names what it is about."""
    text = str(error)
    assert text, f"{type(error).__name__} without a message"
    assert len(text) <= LONGEST, f"{len(text)} characters: {text}"
    assert "\n" not in text, f"several lines: {text!r}"
    assert text.rstrip().endswith((".", ")")), f"not a sentence: {text}"
    for mention in mentions:
        assert mention in text, f"does not mention {mention!r}: {text}"


def refuses(
    call: Callable[[], Any], *mentions: str, kinds: Any = (ValueError, FileNotFoundError)
) -> None:
    """The call raises one of `kinds`, promptly, with a sentence, and without any warning."""
    start = time.perf_counter()
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        found = None
        try:
            call()
        except kinds as error:
            found = error
    assert found is not None, "nothing was refused"
    sentence(found, *mentions)
    assert time.perf_counter() - start < PROMPT, f"took {time.perf_counter() - start:.1f} s"


def survives(call: Callable[[], Any], *mentions: str) -> None:
    """The call gives finite numbers, or raises an error with a sentence; and no warning but one.

    Views of damaged files may be black.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        warnings.filterwarnings("ignore", ".*as they do not show the scene")
        try:
            result = call()
        except (ValueError, FileNotFoundError) as error:
            sentence(error, *mentions)
            return
    if isinstance(result, LightField):  # the focus of a camera may be at infinity
        result = (result.views, result.disparity_range, result.truth)
    for leaf in jax.tree.leaves(result):
        if hasattr(leaf, "dtype") and np.issubdtype(leaf.dtype, np.floating):
            assert np.isfinite(np.asarray(leaf)).all(), "numbers that are not finite"


def mutated(data: bytes, seed: int) -> bytes:
    """Bytes flipped, cut out, doubled or cut off, by a random generator of its own."""
    draw = random.Random(seed)
    out = bytearray(data)
    kind = draw.choice(["flip", "flip", "byte", "cut", "end", "double", "zero"])
    place = draw.randrange(len(out))
    length = draw.randint(1, max(1, len(out) // 8))
    if kind == "flip":
        out[place] ^= 1 << draw.randrange(8)
    elif kind == "byte":
        for _ in range(draw.randint(1, 8)):
            out[draw.randrange(len(out))] = draw.randrange(256)
    elif kind == "cut":
        del out[place : place + length]
    elif kind == "end":
        del out[place:]
    elif kind == "double":
        out[place:place] = out[place : place + length]
    else:
        out[place : place + length] = bytes(len(out[place : place + length]))
    return bytes(out)
