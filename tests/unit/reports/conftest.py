"""Fixture that draws pictures in the style of all commands."""

from collections.abc import Iterator

import pytest

from reports.drawing.style import house_style


@pytest.fixture(autouse=True)
def styled_figures() -> Iterator[None]:
    with house_style():
        yield
