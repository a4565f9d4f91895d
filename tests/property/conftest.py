"""Property tests draw the same examples in every run, so that failures are reproducible."""

from __future__ import annotations

from hypothesis import settings

from tests.examples import AT_MOST, EVERY

settings.register_profile(
    "repeatable",
    max_examples=100 if EVERY else AT_MOST,
    deadline=None,
    derandomize=True,
    database=None,
)
settings.load_profile("repeatable")
