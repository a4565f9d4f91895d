"""Fixture that all tests of the batch engine use."""

from __future__ import annotations

import pytest

from dynamics.batch.engines import kernels


@pytest.fixture(autouse=True)
def nothing_told(monkeypatch) -> None:
    """Forget the reasons for skipping a backend that were reported before, as in a new process."""
    monkeypatch.setattr(kernels, "_reported_reasons", set())
