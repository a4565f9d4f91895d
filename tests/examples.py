"""Number of examples of a property test: at most 25 by default, all with EXAMPLES=all."""

from __future__ import annotations

import os

import hypothesis

EVERY = os.environ.get("EXAMPLES") == "all"
AT_MOST = 25


def settings(max_examples: int, **others: object) -> hypothesis.settings:
    """Return Hypothesis' settings with ``max_examples``, limited to :data:`AT_MOST` unless EXAMPLES=all is set."""
    count = max_examples if EVERY else min(max_examples, AT_MOST)
    return hypothesis.settings(max_examples=count, **others)  # pyright: ignore[reportArgumentType]
