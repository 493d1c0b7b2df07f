"""Formulas as MathML, which browsers draw by themselves: pages load nothing from other hosts."""

import html
import re
from typing import Any

from latex2mathml.converter import convert

_FORMULA = re.compile(r'<(span|div) class="arithmatex">\\[(\[](.*?)\\[)\]]</\1>', re.DOTALL)


def on_page_content(content: str, page: Any, **_: Any) -> str:
    """Replaces the formulas of a page; called by MkDocs."""

    def drawn(formula: re.Match[str]) -> str:
        tag, source = formula[1], html.unescape(formula[2]).strip()
        try:
            drawing = convert(source, display="block" if tag == "div" else "inline")
        except Exception as error:
            raise ValueError(f"{page.file.src_path}: can't draw the formula {source!r}.") from error
        return f'<{tag} class="formula">{drawing}</{tag}>'

    return _FORMULA.sub(drawn, content)
