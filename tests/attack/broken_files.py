"""Problem files that do what no problem file should, as data: what is written, and what must come.

Every file is :data:`GOOD` with one thing wrong. Files that may work all the same say so; all others
must be refused by one sentence and exit code 2.
"""

from __future__ import annotations

import random
from collections.abc import Iterator
from dataclasses import dataclass

GOOD = '''
import casadi as ca
import numpy as np

from dynamics.learned.region import Region
from dynamics.systems import signals, time_stepping
from ocp.problem import Constraint, FreeStart, Problem, Reference, Scenarios
from problems.drawing import Box, ContactFrame, HalfPlane
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
                   guess=guess, reference=Reference(), settings={}, citation="")


def guess(problem, p):
    return np.tile([1.0, 0.0], (problem.N + 1, 1)), np.zeros((problem.N, 1))


def draw(params, state):
    return [HalfPlane(0, 0, 1, 0), Box(float(state[0]), 0, 0.1, 0.1)]


def frames(params, state):
    return [ContactFrame(float(state[0]), 0, 1, 0)]


def region(params):
    return Region({"q": (0, 1), "v": (-1, 1)}, {"u": (-1, 1)}, (1, 0), (0, 0), (0.1, 0.1))
'''
"""A sound file with every part that a file may have."""


@dataclass(frozen=True)
class Broken:
    """A file's bytes, and whether what is wrong with it is seen by a ``solve``.

    ``needs`` names the command by which the fault must come to light at the latest: ``solve``, or
    ``collect`` for what only a region is read for. ``works`` marks a file that nothing is wrong
    with after all.
    """

    name: str
    content: bytes
    needs: str = "solve"
    works: bool = False


RAISED = (
    "SystemExit(0)", "SystemExit('bye')", "KeyboardInterrupt()", "BaseException('base')",
    "GeneratorExit()", "RecursionError('deep')", "MemoryError()", "StopIteration()",
    "AssertionError()", "OSError(28, 'No space left on device')", "BrokenPipeError()",
    "ValueError('a\\ud800b')", "ValueError('\\x1b[2J\\x07' + chr(0))", "ValueError('y' * 100000)",
    "ValueError('first\\nsecond\\nthird')", "UnicodeDecodeError('utf-8', b'x', 0, 1, 'no')",
    "ExceptionGroup('two', [ValueError('one'), TypeError('two')])", "type('E', (Exception,),"
    " {'__str__': lambda self: 1 / 0})()", "type('E', (BaseException,), {})('own')",
    "ImportError('nothing of that name')", "SyntaxError('odd')", "EOFError()",
)  # fmt: skip
"""What user's code raises."""

FUNCTIONS = {
    "the file": 'name = "mine"\n',
    "build": "def build(params):\n",
    "guess": "def guess(problem, p):\n",
    "draw": "def draw(params, state):\n",
    "frames": "def frames(params, state):\n",
    "region": "def region(params):\n",
}
"""Where each function of the file begins."""

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
"""Values of the wrong type for nearly everything."""

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
}  # fmt: skip
"""Names of the file, each with the values of :data:`WRONG` that are right for it."""

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
    "reference=Reference()": set(),
    "settings={}": set(),
    'citation=""': {"a text"},
}  # fmt: skip
"""Arguments of the problem, each with the values of :data:`WRONG` that are right for it."""

RETURNED = {
    "guess": (
        "None", "1", "(1, 2, 3)", "(np.zeros((4, 2)), np.zeros((4, 1)))",
        "(np.zeros((4, 3)), np.zeros((3, 1)))", "(np.full((4, 2), np.nan), np.zeros((3, 1)))",
        "(np.zeros((4, 2)), np.full((3, 1), np.inf))", "('a', 'b')", "(None, None)",
        "(np.zeros((4, 2), dtype=complex) * 1j, np.zeros((3, 1)))",
        "(np.array([['a', 'b']] * 4), np.zeros((3, 1)))", "iter(())",
    ),
    "draw": (
        "None", "1", "'text'", "[None]", "[1, 2]", "[Box(float('nan'), 0, 1, 1)]",
        "[Box(0, 0, float('inf'), 1)]", "[Box('a', 0, 1, 1)]", "[Box(0, 0, None, 1)]",
        "Box(0, 0, 1, 1)", "[Box(ca.SX.sym('w'), 0, 1, 1)]", "[Box(0, 0, 1, 1, role='devil')]",
        "[Box(0, 0, 1, 1, role=None)]", "[Box(0, 0, -1, 1)]",
        "[[Box(0, 0, 1, 1)]]",
    ),
    "frames": (
        "None", "[None]", "[ContactFrame(float('nan'), 0, 1, 0)]", "'text'",
        "[ContactFrame(0, 0, 1, 0, float('nan'))]", "[ContactFrame('a', None, 1, 0)]", "[1]",
    ),
    "region": (
        "None", "1", "Region({}, {}, (), (), ())",
        "Region({'q': (0, 1), 'v': (-1, 1)}, {'u': (-1, 1)}, (1, 0), (0, 0), ('a', 'b'))",
        "Region({'q': (0, float('nan')), 'v': (-1, 1)}, {'u': (-1, 1)}, (1, 0), (0, 0), (1, 1))",
        "Region({'q': 3, 'v': (-1, 1)}, {'u': (-1, 1)}, (1, 0), (0, 0), (1, 1))",
        "Region({'q': ('a', 'b'), 'v': (-1, 1)}, {'u': (-1, 1)}, (1, 0), (0, 0), (1, 1))",
        "Region(None, None, None, None, None)",
        "Region({'q': (0, 1), 'v': (-1, 1)}, {'u': (-1, 1)}, (1, 0), (0, 0), (-1, 0.1))",
    ),
}  # fmt: skip
"""What functions return that they should not."""

CON = "Constraint('c', {})"
PARTICULAR = {
    "N numpy": ("N=params.N", "N=np.int64(3)", True),
    "N a bool": ("N=params.N", "N=True", False),
    "N a numpy bool": ("N=params.N", "N=np.True_", False),
    "N a whole float": ("N=params.N", "N=3.0", True),
    "N a numpy float": ("N=params.N", "N=np.float64(2.5)", False),
    "N an array": ("N=params.N", "N=np.array(3)", True),
    "N zero": ("N=params.N", "N=0", False),
    "N negative": ("N=params.N", "N=-3", False),
    "N infinite": ("N=params.N", "N=float('inf')", False),
    "N huge": ("N=params.N", "N=10**18", False),
    "N beyond floats": ("N=params.N", "N=10**400", False),
    "scenarios none": ("Scenarios()", "Scenarios(0)", False),
    "scenarios negative": ("Scenarios()", "Scenarios(-2, (0.1, 0.1))", False),
    "scenarios numpy": ("Scenarios()", "Scenarios(np.int64(2), (0.1, 0.1))", True),
    "scenarios half": ("Scenarios()", "Scenarios(2.5, (0.1, 0.1))", False),
    "scenarios true": ("Scenarios()", "Scenarios(True)", False),
    "scenarios huge": ("Scenarios()", "Scenarios(10**12, (0.1, 0.1))", False),
    "scenarios NaN": ("Scenarios()", "Scenarios(2, (float('nan'), 0.1))", False),
    "scenarios too few": ("Scenarios()", "Scenarios(2, (0.1,))", False),
    "scenarios' widths a text": ("Scenarios()", "Scenarios(2, 'ab')", False),
    "scenarios' width negative": ("Scenarios()", "Scenarios(2, (-0.1, 0.1))", False),
    "scenarios' widths an array": ("Scenarios()", "Scenarios(2, np.array([0.1, 0.1]))", True),
    "scenarios' seed negative": ("Scenarios()", "Scenarios(2, (0.1, 0.1), -1)", False),
    "scenarios' seed a text": ("Scenarios()", "Scenarios(2, (0.1, 0.1), 'a')", False),
    "reference zero": ("Reference()", "Reference(impulse=0)", False),
    "reference negative": ("Reference()", "Reference(gap=-1)", False),
    "reference NaN": ("Reference()", "Reference(x=float('nan'))", False),
    "reference infinite": ("Reference()", "Reference(u=float('inf'))", False),
    "reference None": ("Reference()", "Reference(x=None)", False),
    "reference a text": ("Reference()", "Reference(x='one')", False),
    "reference true": ("Reference()", "Reference(x=True)", False),
    "reference numpy": ("Reference()", "Reference(x=np.float64(2))", True),
    "reference an array": ("Reference()", "Reference(x=np.array([1.0, 1.0]))", False),
    "path without bounds": ("path=()", f"path=({CON.format('x[0], None, None')},)", False),
    "path NaN": ("path=()", f"path=({CON.format('x[0], np.nan, 1')},)", False),
    "path crossed": ("path=()", f"path=({CON.format('x[0], 2, 1')},)", False),
    "path of a text": ("path=()", "path='x >= 0'", False),
    "path of tuples": ("path=()", "path=(('c', x[0], 0, 1),)", False),
    "path alone": ("path=()", "path=Constraint('c', x[0], 0, 9)", False),
    "path undeclared": ("path=()", f"path=({CON.format('ca.SX.sym(chr(119)), 0, 1')},)", False),
    "path a vector": ("path=()", f"path=({CON.format('x, -9, 9')},)", True),
    "path a matrix": ("path=()", f"path=({CON.format('x @ x.T, -9, 9')},)", False),
    "path bounds too many": ("path=()", f"path=({CON.format('x[0], ca.SX([0, 1, 2]), 9')},)", False),
    "path bound by the state": ("path=()", f"path=({CON.format('x[0], x[1], 9')},)", False),
    "path of numbers": ("path=()", f"path=({CON.format('1.0, 0, 2')},)", True),
    "path twice one name": ("path=()", f"path=({CON.format('x[0], -9, 9')},) * 2", True),
    "path a name of bytes": ("path=()", "path=(Constraint(b'c', x[0], 0, 1),)", False),
    "path a name with a surrogate": ("path=()", "path=(Constraint('\\ud800', x[0], -9, 9),)", False),
    "terminal by an input": ("terminal=()", f"terminal=({CON.format('u, -9, 9')},)", False),
    "terminal an iterator": ("terminal=()", f"terminal=iter(({CON.format('x[0], -9, 9')},))", True),
    "start without bounds": ("start=None", "start=FreeStart(None, None)", False),
    "start numbers": ("start=None", "start=FreeStart(ca.SX([0, 0]), ca.SX([1, 0]))", True),
    "start floats": ("start=None", "start=FreeStart(0.0, 1.0)", True),
    "start too short": ("start=None", "start=FreeStart(ca.SX([0]), ca.SX([1, 2, 3]))", False),
    "start crossed": ("start=None", "start=FreeStart(ca.SX([2, 2]), ca.SX([1, 1]))", False),
    "start NaN": ("start=None", "start=FreeStart(ca.SX([np.nan, 0]), ca.SX([1, 1]))", False),
    "start undeclared": ("start=None", "start=FreeStart(ca.SX.sym('w', 2), ca.SX([1, 1]))", False),
    "start by the state": ("start=None", "start=FreeStart(x, x + 1)", False),
    "periodic beyond": ("start=None", "start=FreeStart(ca.SX([0, 0]), ca.SX([1, 0]), (7,))", False),
    "periodic negative": ("start=None", "start=FreeStart(ca.SX([0, 0]), ca.SX([1, 0]), (-1,))", False),
    "periodic a text": ("start=None", "start=FreeStart(ca.SX([0, 0]), ca.SX([1, 0]), 'q')", False),
    "periodic a number": ("start=None", "start=FreeStart(ca.SX([0, 0]), ca.SX([1, 0]), 1)", False),
    "periodic twice": ("start=None", "start=FreeStart(ca.SX([0, 0]), ca.SX([1, 0]), (1, 1))", True),
    "bounds crossed": ("u_lower=-1", "u_lower=2", False),
    "bounds NaN": ("u_lower=-1", "u_lower=np.nan", False),
    "bounds by the state": ("u_lower=-1", "u_lower=x[0]", False),
    "bounds a list": ("u_lower=-1", "u_lower=[-1]", True),
    "bounds numpy": ("u_lower=-1", "u_lower=np.float64(-1)", True),
    "bounds infinite the wrong way": ("u_lower=-1", "u_lower=ca.inf", False),
    "state bounds too many": ("u_lower=-1", "u_lower=-1, x_lower=ca.SX([0, 0, 0])", False),
    "x0 infinite": ("x0=ca.SX([1, 0])", "x0=ca.SX([ca.inf, 0])", False),
    "x0 a list": ("x0=ca.SX([1, 0])", "x0=[1, 0]", True),
    "x0 by the state": ("x0=ca.SX([1, 0])", "x0=x", False),
    "x0 a row": ("x0=ca.SX([1, 0])", "x0=ca.SX([1, 0]).T", True),
    "cost NaN": ("ca.sumsqr(u)", "ca.sumsqr(u) * np.nan", False),
    "cost infinite": ("ca.sumsqr(u)", "ca.sumsqr(u) + ca.inf", False),
    "cost a vector": ("ca.sumsqr(u)", "x", False),
    "terminal cost by an input": ("ca.sumsqr(x)", "ca.sumsqr(u)", False),
    "du alone": ("u_lower=-1", "u_lower=-1, du=ca.SX.sym('du')", False),
    "du an expression": ("u_lower=-1", "u_lower=-1, du=u + 1, u_before=ca.SX([0])", False),
    "parameters another table": ("parameters=p", "parameters=table(params)", False),
    "parameters a mapping": ("parameters=p", "parameters={'m': 1.0}", False),
    "settings unknown": ("settings={}", "settings={'no_such_setting': 1}", True),
    "settings of objects": ("settings={}", "settings={'a': object()}", False),
    "settings NaN": ("settings={}", "settings={'a': float('nan')}", True),
    "settings numpy": ("settings={}", "settings={'a': np.float64(1)}", True),
    "settings without text": ("settings={}", "settings={1: 2}", False),
    "settings deep": ("settings={}", "settings={'a': {'b': {'c': 1}}}", True),
    "no problem": ("    return Problem(", "    Problem(", False),
    "a class for a problem": ("    return Problem(", "    return dict(", False),
    "step size NaN": ("h=0.1", "h=float('nan')", False),
    "step size zero": ("h=0.1", "h=0", False),
    "step size negative": ("h=0.1", "h=-0.1", False),
    "step size None": ("h=0.1", "h=None", False),
    "mass NaN": ('mass=p["m"]', "mass=float('nan')", False),
    "mass zero": ('mass=p["m"]', "mass=0.0", False),
    "distance NaN": ("distance=lambda q: q", "distance=lambda q: q * np.nan", False),
    "distance None": ("distance=lambda q: q", "distance=lambda q: None", False),
    "impulse infinite": ("impulse=lambda q, v, u: u", "impulse=lambda q, v, u: u + ca.inf", False),
    "one state name twice": ('"q [m]; v [m/s]"', '"q [m]; q [m/s]"', False),
    "a state without a name": ('"q [m]; v [m/s]"', '"[m]; v [m/s]"', False),
    "a state with a surrogate": ('"q [m]; v [m/s]"', '"q [m]; v\\ud800 [m/s]"', False),
    "a unit with controls": ('"q [m]; v [m/s]"', '"q [m]; v [m\\x1b[2J/s]"', False),
    "a state named as a tensor": ('"q [m]; v [m/s]"', '"q/../x [m]; v [m/s]"', True),
    "an input called like a state": ('"u [N s]"', '"q [N s]"', True),
    "a name beyond a folder": ('name = "mine"', 'name = "../mine"', False),
    "a name with a space": ('name = "mine"', 'name = "my problem"', False),
    "a name with a newline": ('name = "mine"', 'name = "mine\\n"', False),
    "a name too long": ('name = "mine"', 'name = "m" * 5000', False),
    "an empty name": ('name = "mine"', 'name = ""', False),
    "a foreign name": ('name = "mine"', 'name = "größe"', True),
    "a shipped problem's name": ('name = "mine"', 'name = "push-1d"', True),
    "a title of many lines": ('"My problem"', '"My\\nproblem"', False),
    "a title in markup": ('"My problem"', '"#panic() $ @x <b>"', True),
    "a citation's key no text": ('Citation("me2025", "My notes")', "Citation(1, 2)", False),
    "a citation's text None": ('Citation("me2025", "My notes")', "Citation('a', None)", False),
    "a citation as a text": ('Citation("me2025", "My notes")', "'me2025'", False),
    "axes of three": ('("x [m]", "y [m]")', '("x", "y", "z")', False),
    "axes of numbers": ('("x [m]", "y [m]")', "(1, 2)", False),
    "axes a text": ('("x [m]", "y [m]")', "'xy'", False),
    "axes in markup": ('("x [m]", "y [m]")', r"(r'$\frac{$', '$')", True),
    "golden a number": ("Golden(0.5)", "0.5", False),
    "golden NaN": ("Golden(0.5)", "Golden(float('nan'))", False),
    "golden a text": ("Golden(0.5)", "Golden('low')", False),
    "golden's tolerance None": ("Golden(0.5)", "Golden(0.5, tolerance=None)", False),
    "golden's settings": ("Golden(0.5)", "Golden(0.5, settings=3)", False),
    "golden's key a number": ('{"exact"', "{3", False),
    "golden's note no text": ("Golden(0.5)", "Golden(0.5, note=3)", False),
    "equations unbalanced": ("m (v^+ - v) = u + lambda", "m (v^+ - = ) ) $ #x", True),
    "equations a program": ("m (v^+ - v) = u + lambda", '#panic("x")', True),
    "equations with a surrogate": ("u + lambda\n", "u + \\ud800\n", False),
    "equations with a foreign name": ("u + lambda", "u + nosuchsymbol", True),
    "equations that read a file": ("u + lambda", 'u #read("/etc/passwd")', True),
    "a default out of range": ('1.0, "kg", "mass", above=0', '-1.0, "kg", "mass", above=0', False),
    "a default of another type": ('1.0, "kg"', '"heavy", "kg"', False),
    "a default NaN": ('1.0, "kg"', 'float("nan"), "kg"', False),
    "a default None": ('1.0, "kg"', 'None, "kg"', False),
    "a unit no text": ('"kg"', "3", True),
    "a meaning no text": ('"mass"', "3", False),
    "a meaning with a surrogate": ('"mass"', '"ma\\ud800ss"', False),
    "a parameter without default": ('m: float = quantity(1.0, "kg", "mass", above=0)', "m: float", False),
    "a parameter of any type": ("    N: int", "    extra: object = object()\n    N: int", False),
    "a parameter a list": ("    N: int", "    extra: list[float] = [1.0]\n    N: int", True),
    "a parameter called N()": ("    N: int", "    json: float = 1.0\n    N: int", True),
    "Params a plain class": ("class Params(Parameters)", "class Params", False),
    "Params that raise": ("    N: int", "    def model_post_init(self, _):\n        raise OSError('x')\n    N: int", False),
    "a file that deletes itself": ('name = "mine"', 'import os; os.remove(__file__)', False),
    "no name": ('name = "mine"\n', "", False),
    "no title": ('title = "My problem"\n', "", False),
    "two builds": ("def guess", "def build(a, b):\n    pass\n\ndef guess", False),
    "build of no arguments": ("def build(params):", "def build():", False),
    "build that yields": ("    return Problem(", "    yield Problem(", False),
    "build of a coroutine": ("def build(params):", "async def build(params):", False),
    "guess of no arguments": ("def guess(problem, p):", "def guess():", False),
    "a missing module": ("import numpy as np", "import numpy as np, no_such_module", False),
    "a missing name": ("import casadi as ca", "import casadi as ca\nfrom problems import nothing", False),
    "an import of itself": ("import casadi as ca", "import casadi as ca\nimport broken", False),
    "a star import": ("import numpy as np", "import numpy as np\nfrom numpy import *", True),
    "an endless recursion": ("    p = table(params)", "    return build(params)", False),
}  # fmt: skip
"""Old text, new text, and whether it works all the same."""

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
"""What a file does beside describing a problem; it works all the same."""

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
    """Everything of :data:`RAISED` in every function."""
    for place, head in FUNCTIONS.items():
        for what in RAISED:
            indent = "" if place == "the file" else "    "
            text = GOOD.replace(head, f"{head}{indent}raise {what}\n")
            yield _made(f"{place} raises {what[:40]}", text, place)


def wrong_types() -> Iterator[Broken]:
    """Everything of :data:`WRONG` for every name of the file and every argument of the problem."""
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
    """Everything of :data:`RETURNED`."""
    for place, values in RETURNED.items():
        for value in values:
            text = GOOD.replace(FUNCTIONS[place], f"{FUNCTIONS[place]}    return {value}\n")
            yield _made(f"{place} returns {value[:60]}", text, place)


def particular() -> Iterator[Broken]:
    """What :data:`PARTICULAR`, :data:`HABITS` and :data:`BYTES` have, each once."""
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
    """All of them, some 600."""
    return [*particular(), *wrong_returns(), *raising(), *wrong_types()]


def sample(n: int, seed: int) -> list[Broken]:
    """``n`` of them, drawn without repetition."""
    return random.Random(seed).sample(every(), n)


def _made(name: str, text: str, place: str, works: bool = False) -> Broken:
    needs = "collect" if place == "region" else "solve"
    return Broken(name, text.encode("utf-8", "surrogatepass"), needs, works)
