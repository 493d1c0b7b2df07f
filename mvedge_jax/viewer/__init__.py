"""Light fields and what was computed from them, in a browser: one page without a network."""

from ._page import page as page
from ._result import (
    Result as Result,
    hidden_surfaces as hidden_surfaces,
    read_result as read_result,
    result_of as result_of,
    result_of_photograph as result_of_photograph,
)
from ._serve import Server as Server, serve as serve
from ._show import Inline as Inline, show as show
