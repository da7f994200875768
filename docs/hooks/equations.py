"""Equations of the site as MathML, made when it is built: a browser needs neither script nor network."""

import html
import re
from typing import Any

from latex2mathml.converter import convert

_MARKED = re.compile(r'<(span|div) class="arithmatex">\\([(\[])(.*?)\\[)\]]</\1>', re.DOTALL)


def on_page_content(content: str, **_: Any) -> str:
    """Replace what `pymdownx.arithmatex` has marked as TeX."""
    return _MARKED.sub(_as_mathml, content)


def _as_mathml(marked: re.Match[str]) -> str:
    tag, bracket, tex = marked.groups()
    tex = html.unescape(tex).strip()
    display = "inline" if bracket == "(" else "block"
    return f'<{tag} class="equation" title="{html.escape(tex)}">{convert(tex, display=display)}</{tag}>'
