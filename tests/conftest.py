"""Markers of tests that are too slow for ``make test``; ``make test-slow`` runs them all.

``costly`` marks a whole test, ``costly_cases(id, ...)`` some of its cases, ``cheap_cases(id, ...)`` all others, and
``one_case_in(k)`` all but every k-th. These get the marker ``slow``, unless :data:`tests.times.ALL` is set.

In a new checkout one process of ``pytest -n`` collects before the others, which read the bytecode that it wrote.
"""

from __future__ import annotations

import gc
import os
import tempfile
import time
from collections import Counter
from pathlib import Path

import pytest

from tests import times

FIRST, FIRST_S = "gw0", 300
"""The process that collects first, and the time limit of the others for waiting [s]."""
FOLDER = "FIRST_COLLECTION"
"""Environment variable of the processes of ``pytest -n``, if there is no bytecode: folder of the first one's mark."""


def pytest_configure(config: pytest.Config) -> None:
    if not hasattr(config, "workerinput") and not Path(__file__).with_name("cli").joinpath("__pycache__").exists():
        folder = tempfile.TemporaryDirectory()
        config.add_cleanup(folder.cleanup)
        os.environ[FOLDER] = folder.name
    if config.option.markexpr.startswith("not slow") and not times.as_users_compile():
        from dynamics.batch.engines import compiler

        # Optimisation takes longer than what it accelerates in quick tests, and changes no bit: test_c_text.py.
        build = compiler._object

        def build_quickly(key: str, source: str, found: compiler.Compiler, flags: tuple[str, ...]) -> Path:
            # Rollouts of a search have the first level; strict compilers warn at the second one.
            quick = flags if "-Werror" in flags else tuple("-O0" if f in ("-O2", "-O3") else f for f in flags)
            return build(key if quick == flags else f"{key}quick", source, found, quick)

        compiler._object = build_quickly


@pytest.hookimpl(wrapper=True)
def pytest_collection(session: pytest.Session):
    worker = getattr(session.config, "workerinput", {}).get("workerid")
    collected = Path(os.environ.get(FOLDER, ""), "collected")
    if worker not in (None, FIRST) and FOLDER in os.environ:
        end_s = time.monotonic() + FIRST_S
        while not collected.exists() and time.monotonic() < end_s:
            time.sleep(0.1)
    # What collection makes lives to the end: the search for unused cycles need not go through it.
    gc.disable()
    outcome = yield
    gc.enable()
    gc.freeze()
    if worker == FIRST and FOLDER in os.environ:
        collected.touch()
    return outcome


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
