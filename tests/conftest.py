"""Markers of tests that are too slow for ``make test``; ``make test-slow`` runs them all.

``costly`` marks a whole test, ``costly_cases(id, ...)`` some of its cases, ``cheap_cases(id, ...)`` all others, and
``one_case_in(k)`` all but every k-th. These get the marker ``slow``, unless :data:`tests.times.ALL` is set.
"""

from __future__ import annotations

import os
from collections import Counter

import pytest

from tests import times


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    cases: Counter[str] = Counter()
    for item in items:
        test = item.nodeid.partition("[")[0]
        if is_costly(item, cases[test]) and not os.environ.get(times.ALL):
            item.add_marker(pytest.mark.slow)
        cases[test] += 1


def is_costly(item: pytest.Item, index: int) -> bool:
    """Return whether the markers leave a case, the ``index``-th of its test, to ``make test-slow``."""
    case = item.nodeid.partition("[")[2].removesuffix("]")
    some, others, drawn = (item.get_closest_marker(name) for name in ("costly_cases", "cheap_cases", "one_case_in"))
    return bool(
        item.get_closest_marker("costly")
        or (some and case in some.args)
        or (others and case not in others.args)
        or (drawn and index % drawn.args[0])
    )


@pytest.hookimpl(wrapper=True)
def pytest_runtest_protocol(item: pytest.Item):
    before = times.processor_seconds()
    outcome = yield
    times.record(item, times.processor_seconds() - before)
    return outcome
