"""Broken problem files as data: their text, and the expected outcome.

Every file is :data:`GOOD` with one error. Files that still work are marked so; all others must be
rejected with one sentence and exit code 2.
"""

from __future__ import annotations

import random
from collections.abc import Iterator
from dataclasses import dataclass

from tests.attack.odd_parts import PARTICULAR

GOOD = '''
import casadi as ca
import numpy as np

from dynamics.learned.region import Region
from dynamics.systems import signals, time_stepping
from ocp import Constraint, FreeStart, Origin, Problem, Scaling, Scenarios
from problems.drawing import Rectangle, ContactFrame, Wall
from problems.parameters import Parameters, quantity, structure, table
from problems.spec import Citation, Golden

name = "mine"
title = "My problem"
equations = """
m (v^+ - v) = u + lambda
"""
citation = Citation("me2025", "My notes")
axes = ("x [m]", "y [m]")
golden = {"exact": Golden(0.5)}


class Params(Parameters):
    m: float = quantity(1.0, "kg", "mass", above=0)
    N: int = structure(3, "number of steps", least=1)


def build(params):
    p = table(params)
    system = time_stepping(
        name, states=signals("q [m]; v [m/s]"), inputs=signals("u [N s]"),
        contacts=signals("wall [N s]"), h=0.1, mass=p["m"], impulse=lambda q, v, u: u,
        distance=lambda q: q, parameters=p)
    x, u = system.x, system.u
    return Problem(name=name, system=system, N=params.N, stage_cost=ca.sumsqr(u),
                   terminal_cost=ca.sumsqr(x), x0=ca.SX([1, 0]), parameters=p, u_lower=-1,
                   u_upper=1, path=(), terminal=(), scenarios=Scenarios(), start=None,
                   guess=guess, scaling=Scaling(), origin=Origin(settings={}, citation=""))


def guess(problem, p):
    return np.tile([1.0, 0.0], (problem.N + 1, 1)), np.zeros((problem.N, 1))


def draw(params, state):
    return [Wall(0, 0, 1, 0), Rectangle(float(state[0]), 0, 0.1, 0.1)]


def frames(params, state):
    return [ContactFrame(float(state[0]), 0, 1, 0)]


def region(params):
    return Region({"q": (0, 1), "v": (-1, 1)}, {"u": (-1, 1)}, (1, 0), (0, 0), (0.1, 0.1))
'''
"""Text of a valid file with every part that a file may have."""


@dataclass(frozen=True)
class Broken:
    """Bytes of a file with one error, and the command that must report it.

    ``needs`` is the command that must report the error at the latest: ``solve``, or ``collect`` for
    errors of the region. ``works`` marks a file that is valid after all.
    """

    name: str
    content: bytes
    needs: str = "solve"
    works: bool = False


RAISED = (
    "SystemExit(0)",
    "SystemExit('bye')",
    "KeyboardInterrupt()",
    "BaseException('base')",
    "GeneratorExit()",
    "RecursionError('deep')",
    "MemoryError()",
    "StopIteration()",
    "AssertionError()",
    "OSError(28, 'No space left on device')",
    "BrokenPipeError()",
    "ValueError('a\\ud800b')",
    "ValueError('\\x1b[2J\\x07' + chr(0))",
    "ValueError('y' * 100000)",
    "ValueError('first\\nsecond\\nthird')",
    "UnicodeDecodeError('utf-8', b'x', 0, 1, 'no')",
    "ExceptionGroup('two', [ValueError('one'), TypeError('two')])",
    "type('E', (Exception,), {'__str__': lambda self: 1 / 0})()",
    "type('E', (BaseException,), {})('own')",
    "ImportError('nothing of that name')",
    "SyntaxError('odd')",
    "EOFError()",
)
"""Exceptions that a user's code raises."""

FUNCTIONS = {
    "the file": 'name = "mine"\n',
    "build": "def build(params):\n",
    "guess": "def guess(problem, p):\n",
    "draw": "def draw(params, state):\n",
    "frames": "def frames(params, state):\n",
    "region": "def region(params):\n",
}
"""Mapping from function of the file to its first line."""

WRONG = {
    "None": "None",
    "a number": "1.5",
    "NaN": "float('nan')",
    "true": "True",
    "bytes": "b'mine'",
    "a text": "'mine'",
    "a surrogate": "'a\\ud800b'",
    "controls": "'a\\x1b[2Jb'",
    "a list": "[1, 'a', None]",
    "a mapping": "{'a': object()}",
    "an object": "object()",
    "a function": "lambda *_: None",
    "a type": "int",
    "an array": "np.full((2, 2), np.nan)",
    "a symbol": "ca.SX.sym('w', 3)",
    "an MX": "ca.MX.sym('w')",
    "nested": "(lambda f: f(f, 900))(lambda f, n: [f(f, n - 1)] if n else [])",
}
"""Mapping from kind to a value, each of the wrong type for nearly everything."""

MODULE = {
    "name": {"None", "a text"} - {"None"},
    "title": {"a text"},
    "equations": {"a text"},
    "citation": {"None"},
    "axes": set(),
    "golden": set(),
    "Params": set(),
    "build": set(),
    "draw": {"None"},
    "frames": {"None"},
    "region": {"None"},
}
"""Mapping from name in the file to the kinds in :data:`WRONG` that are right for it."""

PROBLEM = {
    "name=name": {"a text"},
    "system=system": set(),
    "N=params.N": set(),
    "stage_cost=ca.sumsqr(u)": {"a number"},
    "terminal_cost=ca.sumsqr(x)": {"a number"},
    "x0=ca.SX([1, 0])": set(),
    "parameters=p": set(),
    "u_lower=-1": set(),
    "u_upper=1": {"a number"},
    "path=()": set(),
    "terminal=()": set(),
    "scenarios=Scenarios()": set(),
    "start=None": {"None"},
    "guess=guess": {"None"},
    "scaling=Scaling()": set(),
    "settings={}": set(),
    'citation=""': {"a text"},
}
"""Mapping from argument of the problem to the kinds in :data:`WRONG` that are right for it."""

RETURNED = {
    "guess": (
        "None",
        "1",
        "(1, 2, 3)",
        "(np.zeros((4, 2)), np.zeros((4, 1)))",
        "(np.zeros((4, 3)), np.zeros((3, 1)))",
        "(np.full((4, 2), np.nan), np.zeros((3, 1)))",
        "(np.zeros((4, 2)), np.full((3, 1), np.inf))",
        "('a', 'b')",
        "(None, None)",
        "(np.zeros((4, 2), dtype=complex) * 1j, np.zeros((3, 1)))",
        "(np.array([['a', 'b']] * 4), np.zeros((3, 1)))",
        "iter(())",
    ),
    "draw": (
        "None",
        "1",
        "'text'",
        "[None]",
        "[1, 2]",
        "[Rectangle(float('nan'), 0, 1, 1)]",
        "[Rectangle(0, 0, float('inf'), 1)]",
        "[Rectangle('a', 0, 1, 1)]",
        "[Rectangle(0, 0, None, 1)]",
        "Rectangle(0, 0, 1, 1)",
        "[Rectangle(ca.SX.sym('w'), 0, 1, 1)]",
        "[Rectangle(0, 0, 1, 1, role='devil')]",
        "[Rectangle(0, 0, 1, 1, role=None)]",
        "[Rectangle(0, 0, -1, 1)]",
        "[[Rectangle(0, 0, 1, 1)]]",
    ),
    "frames": (
        "None",
        "[None]",
        "[ContactFrame(float('nan'), 0, 1, 0)]",
        "'text'",
        "[ContactFrame(0, 0, 1, 0, float('nan'))]",
        "[ContactFrame('a', None, 1, 0)]",
        "[1]",
    ),
    "region": (
        "None",
        "1",
        "Region({}, {}, (), (), ())",
        "Region({'q': (0, 1), 'v': (-1, 1)}, {'u': (-1, 1)}, (1, 0), (0, 0), ('a', 'b'))",
        "Region({'q': (0, float('nan')), 'v': (-1, 1)}, {'u': (-1, 1)}, (1, 0), (0, 0), (1, 1))",
        "Region({'q': 3, 'v': (-1, 1)}, {'u': (-1, 1)}, (1, 0), (0, 0), (1, 1))",
        "Region({'q': ('a', 'b'), 'v': (-1, 1)}, {'u': (-1, 1)}, (1, 0), (0, 0), (1, 1))",
        "Region(None, None, None, None, None)",
        "Region({'q': (0, 1), 'v': (-1, 1)}, {'u': (-1, 1)}, (1, 0), (0, 0), (-1, 0.1))",
    ),
}
"""Mapping from function to invalid return values."""

HABITS = {
    "changes the folder": "import os, tempfile\nos.chdir(tempfile.gettempdir())",
    "empties the path": "import sys\nsys.path.clear()",
    "empties the environment": "import os\nos.environ.clear()",
    "prints": "print('hello\\udcff'.encode('utf-8', 'replace').decode(), flush=True)",
    "turns warnings into errors": "import warnings\nwarnings.simplefilter('error')",
    "turns rounding into errors": "np.seterr(all='raise')",
    "takes the output away": "import sys\nsys.stdout = sys.stderr = None",
    "lowers recursion": "import sys\nsys.setrecursionlimit(120)",
    "seeds": "import random\nrandom.seed(0)\nnp.random.seed(0)",
    "ends with a thread": "import threading\nthreading.Thread(target=lambda: None).start()",
    "prints numbers shortly": "np.set_printoptions(precision=1)",
}
"""Mapping from side effect of a file to its code; such files still work."""

BYTES = {
    "empty": b"",
    "only spaces": b" \n\t\n",
    "latin-1": "name = 'größe'".encode("latin-1"),
    "UTF-16": GOOD.encode("utf-16"),
    "a null byte": b"name = 'mine'\0\n",
    "noise": bytes(range(256)) * 4,
    "an unknown coding": b"# -*- coding: no-such -*-\nname = 'mine'\n",
    "cut": GOOD.encode()[:700],
    "tabs and spaces": b"if True:\n\tname = 1\n        title = 2\n",
    "nested too deep": b"(" * 5000 + b")" * 5000,
    "a huge number": b"name = " + b"9" * 6000,
    "carriage returns": GOOD.replace("\n", "\r\n").encode(),
    "a mark of byte order": b"\xef\xbb\xbf" + GOOD.encode(),
    "ELF": b"\x7fELF\x02\x01\x01\0" + bytes(100),
    "an old Python": b"print 'hello'\n",
    "a class that asks for itself": b"class name(name): pass\n",
}
_SOUND = {"carriage returns", "a mark of byte order"}


def raising() -> Iterator[Broken]:
    """Yield files that raise each of :data:`RAISED` in each function."""
    for place, head in FUNCTIONS.items():
        for what in RAISED:
            indent = "" if place == "the file" else "    "
            text = GOOD.replace(head, f"{head}{indent}raise {what}\n")
            yield _made(f"{place} raises {what[:40]}", text, place)


def wrong_types() -> Iterator[Broken]:
    """Yield files with each of :data:`WRONG` for every name of the file and every argument of the problem."""
    for key, right in MODULE.items():
        for what, value in WRONG.items():
            works = what in right
            yield _made(f"{key} is {what}", f"{GOOD}\n{key} = {value}\n", key, works)
    for argument, right in PROBLEM.items():
        key = argument.partition("=")[0]
        for what, value in WRONG.items():
            text = GOOD.replace(argument, f"{key}={value}")
            yield _made(f"problem's {key} is {what}", text, "", what in right)


def wrong_returns() -> Iterator[Broken]:
    """Yield files with each return value of :data:`RETURNED`."""
    for place, values in RETURNED.items():
        for value in values:
            text = GOOD.replace(FUNCTIONS[place], f"{FUNCTIONS[place]}    return {value}\n")
            yield _made(f"{place} returns {value[:60]}", text, place)


def particular() -> Iterator[Broken]:
    """Yield files with each error of :data:`PARTICULAR` and :data:`BYTES`, and each of :data:`HABITS`."""
    for what, (old, new, works) in PARTICULAR.items():
        assert old in GOOD, what
        yield _made(what, GOOD.replace(old, new, 1), "", works)
    for what, lines in HABITS.items():
        yield _made(f"a file that {what}", f"{GOOD}\n{lines}\n", "", works=True)
        inside = lines.replace("\n", "\n    ")
        text = GOOD.replace("    p = table", f"    {inside}\n    p = table")
        yield _made(f"a build that {what}", text, "", works=True)
    for what, content in BYTES.items():
        yield Broken(what, content, works=what in _SOUND)


def every() -> list[Broken]:
    """Return all broken files, about 600."""
    return [*particular(), *wrong_returns(), *raising(), *wrong_types()]


def sample(n: int, seed: int) -> list[Broken]:
    """Draw ``n`` broken files without repetition."""
    return random.Random(seed).sample(every(), n)


def _made(name: str, text: str, place: str, works: bool = False) -> Broken:
    needs = "collect" if place == "region" else "solve"
    return Broken(name, text.encode("utf-8", "surrogatepass"), needs, works)
