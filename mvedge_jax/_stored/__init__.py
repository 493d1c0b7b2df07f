"""Compiled programs in files, so that a later process neither traces nor compiles them."""

from ._files import ProgramFiles as ProgramFiles, in_use as in_use, use as use
from ._key import is_ordinary as is_ordinary, kind_of as kind_of, replaced_name as replaced_name
from ._program import (
    Lowered as Lowered,
    Program as Program,
    is_array as is_array,
    obtain as obtain,
    prepared as prepared,
)
