"""What every test of the batch engine starts from."""

from __future__ import annotations

import pytest

from dynamics.batch.engines import kernels


@pytest.fixture(autouse=True)
def nothing_told(monkeypatch) -> None:
    """As in a new process, where no reason to pass a backend over was told before."""
    monkeypatch.setattr(kernels, "_reported_reasons", set())
