"""Named problems at their defaults, each built once in a process; tests only read them."""

from __future__ import annotations

from functools import cache

from ocp.problem.problem import Problem
from problems import get


@cache
def named(name: str) -> Problem:
    return get(name)
