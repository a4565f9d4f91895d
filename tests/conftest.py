"""Tests that ``tests/slow.txt`` lists are slow: ``make test`` leaves them to ``make test-slow``."""

from __future__ import annotations

import os

import pytest

from tests import times


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    slow = frozenset() if os.environ.get(times.ALL) else times.listed()
    for item in items:
        if item.nodeid in slow or item.nodeid.partition("[")[0] in slow:
            item.add_marker(pytest.mark.slow)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_protocol(item: pytest.Item):
    began = times.processor_seconds()
    done = yield
    times.keep(item.nodeid, times.processor_seconds() - began)
    return done
