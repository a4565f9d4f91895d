"""Count the functions that a problem passes through on its way through one solve.

The walk is the sequence of functions of this project that are entered with the problem among their arguments, its
own methods included. Its *stays* are the distinct functions, its *returns* the entries of a function that was visited
before, from another function of the walk. Prints both for a problem of complementarity and for a law's path::

    python -m tests.benchmarks.ocp.walk_of_solve [-v]
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path
from types import CodeType, FrameType
from typing import Any

import problems
from ocp import Problem, solve

ROOT = Path(__file__).parents[3]
"""Directory of the packages."""
WALKS = {"push-disc, exact": ("push-disc", "exact"), "wall-1d, barrier": ("wall-1d", "barrier")}
"""Solves that are counted: a problem and the name of its law."""


def walk(call: Callable[[], object]) -> list[CodeType]:
    """Return the functions that are entered with a problem during a call, in order."""
    entered: list[CodeType] = []

    def enter(frame: FrameType, event: str, _: Any) -> None:
        code = frame.f_code
        if event != "call" or not code.co_filename.startswith(str(ROOT)) or code.co_name.startswith("<"):
            return
        names = code.co_varnames[: code.co_argcount + code.co_kwonlyargcount]
        if any(isinstance(frame.f_locals.get(name), Problem) for name in names):
            entered.append(code)

    sys.setprofile(enter)
    try:
        call()
    finally:
        sys.setprofile(None)
    return entered


def returns(walked: list[CodeType]) -> list[CodeType]:
    """Return the entries of functions that were visited before, where the walk comes from another one."""
    visited, repeated, last = set[CodeType](), [], None
    for code in walked:
        if code in visited and code is not last:
            repeated.append(code)
        visited.add(code)
        last = code
    return repeated


def main() -> None:
    """Print stays and returns, and with ``-v`` the functions with their returns."""
    for title, (name, law) in WALKS.items():
        problem = problems.get(name)
        walked = walk(lambda problem=problem, law=law: solve(problem, law))
        stays, repeated = list(dict.fromkeys(walked)), returns(walked)
        print(f"{title}: {len(stays)} stays, {len(repeated)} returns")
        for code in stays if "-v" in sys.argv else ():
            print(f"    {Path(code.co_filename).relative_to(ROOT)} {code.co_qualname} ({repeated.count(code)})")


if __name__ == "__main__":
    main()
