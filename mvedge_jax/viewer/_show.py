"""The page in a notebook."""

import html as markup
from pathlib import Path
from typing import NamedTuple

from mvedge_jax.depth import DepthResult
from mvedge_jax.lightfield import LightField

from ._page import page
from ._result import Result, result_of


class Inline(NamedTuple):
    """A page that a notebook shows as the value of a cell.

    Attributes:
        html: the page.
        height: of its frame, px.
    """

    html: str
    height: int

    def _repr_html_(self) -> str:
        source = markup.escape(self.html, quote=True)
        style = f"width: 100%; height: {self.height}px; border: 0"
        return f'<iframe sandbox="allow-scripts" style="{style}" srcdoc="{source}"></iframe>'

    def save(self, path: str | Path) -> None:
        """Writes the page into an HTML file."""
        Path(path).write_text(self.html, encoding="utf-8")


def show(
    light_field: LightField, *results: DepthResult | Result, quality: int = 80, height: int = 720
) -> Inline:
    """A light field, and what was computed from it, in a notebook.

    The page travels in the notebook's output: 9x9 views of 512x512 px take some megabytes.

    Args:
        light_field: the views.
        results: of `EdgeDepth`, or maps as `Result`, which have names; two are compared.
        quality: of the views, 1 to 100.
        height: of the frame, px.

    Returns:
        What the cell shows.
    """
    shown = [
        found if isinstance(found, Result) else result_of(found, name=f"result {number}")
        for number, found in enumerate(results, 1)
    ]
    return Inline(page(light_field, *shown, quality=quality), height)
