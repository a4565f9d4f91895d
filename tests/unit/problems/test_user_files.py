"""Problems in users' files: a file works like a registered problem, and a broken one gets a sentence."""

from __future__ import annotations

import textwrap
from pathlib import Path

import pytest

import problems
from ocp.errors import InputError

USER = """
import casadi as ca
from dynamics.systems import signals, time_stepping
from ocp.problem.problem import Problem
from problems import Parameters, quantity, structure, table

name, title = "my-wall", "A mass of my own"


class Params(Parameters):
    m: float = quantity(2.0, "kg", "mass", above=0)
    N: int = structure(4, "number of steps", least=1)


def build(params):
    p = table(params)
    system = time_stepping(
        name, states=signals("x [m]; v [m/s]"), inputs=signals("u [N s]"),
        contacts=signals("wall [N s]"), h=0.1, mass=p["m"], impulse=lambda q, v, u: u,
        distance=lambda q: q, parameters=p,
    )
    return Problem(
        name=name, system=system, N=params.N, stage_cost=ca.sumsqr(system.u),
        terminal_cost=(system.x[0] - 1) ** 2, x0=ca.SX([1, 0]), parameters=p,
    )
"""


def user_file(folder: Path, text: str) -> Path:
    path = folder / "mine.py"
    path.write_text(textwrap.dedent(text))
    return path


def test_a_users_file_works_like_a_registered_problem(tmp_path: Path):
    path = user_file(tmp_path, USER)
    spec = problems.load(path)
    assert (spec.name, spec.title, spec.path) == ("my-wall", "A mass of my own", path)
    assert problems.spec(str(path)).name == "my-wall"
    problem = problems.get(str(path), m=3.0, N=6)
    assert problem.N == 6
    assert problem.parameters.values == [3.0]
    with pytest.raises(InputError, match=r"my-wall: parameter m .* > 0 \[kg\]"):
        problems.get(str(path), m=0)


def test_a_changed_file_is_read_again(tmp_path: Path):
    path = user_file(tmp_path, USER)
    assert problems.load(path).title == "A mass of my own"
    user_file(tmp_path, USER.replace("of my own", "of another's"))
    assert problems.load(path).title == "A mass of another's"


# The problem's arguments end here, so that the test can insert others.
END = "x0=ca.SX([1, 0]), parameters=p,"

BROKEN = {
    "raises": (USER + "\n1 / 0\n", r"raised at line \d+: ZeroDivisionError"),
    "syntax": (USER + "\ndef (\n", r"line \d+: SyntaxError"),
    "exits": (USER + "\nraise SystemExit(3)\n", "SystemExit"),
    "no build": (USER.replace("def build", "def make"), "build is missing"),
    "nothing": ("", "name, title, Params, build are missing"),
    "Params": (USER.replace("(Parameters)", ""), "Params must be a class derived from"),
    "name": (USER.replace('"my-wall"', '"../my wall"'), "name must be a word"),
    "title": (USER.replace('"A mass of my own"', "7"), "title must be a text"),
    "returns": (USER.replace("return Problem(", "dict("), "returned nothing, expected"),
    "build raises": (USER.replace('p["m"]', 'p["n"]'), r"build\(params\) failed: line \d+: KeyE"),
    "x0": (USER.replace("ca.SX([1, 0])", "ca.SX([1, 0, 0])"), "x0 has 3 entries, expected 2"),
    "odd": (USER.replace("v [m/s]", "v [m/s]; w [m]"), "3 states; expected positions and as many"),
    "mass": (USER.replace("v [m/s]", "v [m/s]; w [m]; a [1]"), r"mass has shape \(1, 1\), exp"),
    "contacts": (USER.replace("wall [N s]", "a [N s]; b [N s]"), r"distance\(q\) has shape"),
    "strange": (USER.replace("v, u: u,", "v, u: ca.SX.sym('a'),"), "uses a, which is not a state"),
    "bound": (
        USER.replace(END, END + "u_upper=ca.SX([1, 2]),"),
        "u_upper has 2 entries, expected 1",
    ),
    "guess": (
        USER.replace(END, END + "guess=lambda problem, p: ([0], [0]),"),
        "the guess has states",
    ),
    "nan": (USER.replace("ca.SX([1, 0])", "ca.SX([1, float('nan')])"), "x0 is not finite"),
    "nan cost": (
        USER.replace("(system.x[0] - 1) **", "(system.x[1]) ** -"),
        "cost is not a finite",
    ),
    "horizon": (
        USER.replace("N=params.N", "N=0"),
        "horizon N must be greater than or",
    ),
    "draw": (
        USER + "\ndef draw(params, state):\n    return state[9]\n",
        r"draw\(params, state\) failed: line \d+: IndexError",
    ),
}


@pytest.mark.parametrize("case", BROKEN)
def test_a_broken_file_gets_its_sentence(tmp_path: Path, case: str):
    text, sentence = BROKEN[case]
    path = user_file(tmp_path, text)
    with pytest.raises(InputError, match=sentence) as raised:
        problems.load(path)
    assert "mine.py" in str(raised.value)
    assert "\n" not in str(raised.value)


def test_a_missing_file_gets_its_sentence(tmp_path: Path):
    with pytest.raises(InputError, match="there is no such file"):
        problems.spec(str(tmp_path / "absent.py"))
    with pytest.raises(InputError, match="is a directory"):
        problems.load(tmp_path)
