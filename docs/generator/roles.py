"""Conversion of docstrings for the site: references to links, indented formulas to blocks."""

from __future__ import annotations

import re
from typing import Any

import griffe

_ROLE = re.compile(r":(?:class|func|meth|mod|attr|data|exc|obj):`(~?)([\w.]+)`")
"""Pattern of a reference in a docstring, such as ``:func:`a.b```."""


def linked(text: str) -> str:
    """Return ``text`` with roles such as ``:func:`~a.b``` replaced by links, if the site has their targets."""
    return _ROLE.sub(_link, text).replace("::\n\n    ", ":\n\n    ")


def cleaned(text: str | None) -> str:
    """Return the first paragraph of a docstring in Markdown, on one line, with references as code."""
    with_names = _ROLE.sub(lambda match: f"`{match[2].rpartition('.')[2]}`", text or "")
    return " ".join(with_names.partition("\n\n")[0].replace("``", "`").split())


def _link(match: re.Match[str]) -> str:
    short, name = match.groups()
    text = name.rpartition(".")[2] if short else name
    return f'<autoref optional identifier="{name}"><code>{text}</code></autoref>'


class Roles(griffe.Extension):
    """Extension of griffe that converts every docstring it reads with :func:`linked`."""

    def on_object(self, *, obj: griffe.Object, **kwargs: Any) -> None:
        """Convert the docstring of ``obj``, if it has one."""
        if obj.docstring is not None:
            obj.docstring.value = linked(obj.docstring.value)
