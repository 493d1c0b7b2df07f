"""Checkpointing: arrays that reverse mode stores, and those it recomputes."""

from collections.abc import Callable
from typing import Any, TypeVar

import jax
from jax.ad_checkpoint import checkpoint_name
from jax.extend.core import Primitive

_Tree = TypeVar("_Tree")
_SAVED = "mvedge_jax: saved"


def checkpoint(function: Callable[..., Any]) -> Callable[..., Any]:
    """`jax.checkpoint` that saves linear solutions and arrays tagged by `save_residual`."""
    return jax.checkpoint(function, policy=_saves)


def save_residual(tree: _Tree) -> _Tree:
    """Tags the arrays of a tree that reverse mode stores within `checkpoint`."""
    return jax.tree.map(lambda array: checkpoint_name(array, _SAVED), tree)


def _saves(primitive: Primitive, *_: Any, **params: Any) -> bool:
    return primitive.name == "custom_linear_solve" or params.get("name") == _SAVED
