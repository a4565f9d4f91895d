"""Pictures in the house style, as every command draws them."""

from collections.abc import Iterator

import pytest

from reports.drawing.style import styled


@pytest.fixture(autouse=True)
def house_style() -> Iterator[None]:
    with styled():
        yield
