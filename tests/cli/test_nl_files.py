"""``ocp solve MODEL.nl``: a model that Pyomo 6.10 wrote, its names, its .sol file, and what is refused.

The model is in tests/data: the leader pays ``(x - 2)² + (y - 3)² + exp(z)`` with z in [-1, 2], and the
follower chooses ``y = min(x, 1)``, as ``y - x + s = 0`` and ``0 <= s ⟂ 1 - y >= 0``. The best x is 2.
Models that Pyomo writes here get their answers back, which have closed forms.
"""

from __future__ import annotations

import json
import shutil
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import pytest

DATA = Path(__file__).parents[1] / "data"
COST = 4 + np.exp(-1)


@pytest.fixture
def model(tmp_path: Path) -> Path:
    for suffix in ("nl", "row", "col"):
        shutil.copy(DATA / f"leader.{suffix}", tmp_path)
    return tmp_path / "leader.nl"


def test_a_model_of_pyomo_is_solved_and_certified(ocp, model: Path) -> None:
    done = ocp("solve", "leader.nl", "--json")
    assert done.code == 0
    document = json.loads(done.out)
    assert document["success"] and document["stationarity"] == "B"
    assert document["cost"] == pytest.approx(COST, abs=1e-7)
    values = {name: document["x"][name] for name in ("x", "y", "z", "s")}
    assert values == pytest.approx({"x": 2, "y": 1, "z": -1, "s": 1}, abs=1e-6)
    lines = model.with_suffix(".sol").read_text().splitlines()
    options = lines.index("Options")
    assert lines[options + 1 : options + 9] == ["3", "1", "1", "0", "3", "3", "5", "5"]
    numbers = [float(line) for line in lines[options + 9 : -1]]
    assert numbers[3:] == pytest.approx([2, 1, -1, 1, 0], abs=1e-6)
    assert numbers[1] == pytest.approx(4, abs=1e-5), "of the pair's row: the cost by 1 - y"
    assert lines[-1] == "objno 0 0"


def test_a_model_without_solution_exits_3_and_names_the_row(ocp, model: Path) -> None:
    model.write_text(
        model.read_text().replace("4 0\t#bal", "4 5\t#bal").replace("3\t#x", "2 0\t#x").replace("2 0\t#s", "0 0 1\t#s")
    )
    done = ocp("solve", "leader.nl")
    assert done.code == 3 and "bal" in done.out
    assert model.with_suffix(".sol").read_text().rstrip().endswith("objno 0 200")


def pyomo(module: str) -> Any:
    """Return a module of Pyomo; its types are too wide for a checker, and its import takes most of a second."""
    return import_module(f"pyomo.{module}")


def round_trip(ocp: Any, folder: Path, model: Any) -> str:
    """Write a Pyomo model, solve its file, and load values and duals; return the last line of the .sol file."""
    pyo, opt = pyomo("environ"), pyomo("opt")

    model.dual = pyo.Suffix(direction=pyo.Suffix.IMPORT)
    pyo.TransformationFactory("mpec.nl").apply_to(model)
    _, symbols = model.write(str(folder / "market.nl"), format="nl", io_options={"symbolic_solver_labels": True})
    ocp("solve", "market.nl")
    with opt.ReaderFactory(opt.ResultsFormat.sol) as reader:
        results = reader(str(folder / "market.sol"), suffixes=["dual"])
    results._smap = model.solutions.symbol_map[symbols]
    model.solutions.load_from(results)
    return (folder / "market.sol").read_text().splitlines()[-1]


@pytest.mark.costly
def test_a_market_of_pyomo_has_the_stackelberg_equilibrium(ocp, tmp_path: Path) -> None:
    """A leader with cost d per unit sells x beside followers with costs c; the price is ``a - x - sum q``.

    A follower that sells chooses ``q = price - c``. With n that sell, price = (a - x + sum c) / (n + 1); the profit
    x (price - d) is largest at x = (a + sum c - (n + 1) d) / 2, where it is x² / (n + 1), with the derivative
    x / (n + 1) by a.
    """
    pyo, mpec = pyomo("environ"), pyomo("mpec")

    a, d, costs = 20.0, 4.0, (3.0, 5.0, 30.0)
    m = pyo.ConcreteModel()
    m.x = pyo.Var(bounds=(0, None), initialize=1.0)
    m.q, m.price = pyo.Var(range(3), bounds=(0, None)), pyo.Var()
    m.profit = pyo.Objective(expr=m.x * (m.price - d), sense=pyo.maximize)
    m.market = pyo.Constraint(expr=m.price + m.x + sum(m.q.values()) == a)
    m.follower = mpec.Complementarity(
        range(3), rule=lambda m, i: mpec.complements(m.q[i] >= 0, m.q[i] + costs[i] >= m.price)
    )
    assert round_trip(ocp, tmp_path, m) == "objno 0 0"
    x = (a + sum(costs[:2]) - 3 * d) / 2
    price = (a - x + sum(costs[:2])) / 3
    assert (m.x.value, m.price.value) == pytest.approx((x, price), abs=1e-5)
    assert [q.value for q in m.q.values()] == pytest.approx([price - 3, price - 5, 0], abs=1e-5)
    assert pyo.value(m.profit) == pytest.approx(x**2 / 3, abs=1e-5)
    assert m.dual[m.market] == pytest.approx(x / 3, abs=1e-4)


@pytest.mark.costly
@pytest.mark.costly
def test_friction_of_pyomo_slides_with_its_limit(ocp, tmp_path: Path) -> None:
    """A force u moves a body at v = u - f against the friction |f| <= 1, which is 1 at v > 0, -1 at v < 0.

    The cost (v + 3)² + u² / 4 of a wanted speed of -3 is lowest at u = -3.2, v = u + 1: it is 3.2.
    """
    pyo, mpec = pyomo("environ"), pyomo("mpec")

    m = pyo.ConcreteModel()
    m.u, m.f = pyo.Var(initialize=-2.0), pyo.Var(initialize=-1.0)
    m.forward, m.back = pyo.Var(bounds=(0, None)), pyo.Var(bounds=(0, None), initialize=1.0)
    v = m.forward - m.back
    m.cost = pyo.Objective(expr=(v + 3) ** 2 + m.u**2 / 4)
    m.motion = pyo.Constraint(expr=v == m.u - m.f)
    m.upper = mpec.Complementarity(expr=mpec.complements(m.forward >= 0, m.f <= 1))
    m.lower = mpec.Complementarity(expr=mpec.complements(m.f >= -1, m.back >= 0))
    assert round_trip(ocp, tmp_path, m) == "objno 0 0"
    assert (m.u.value, pyo.value(v), m.f.value) == pytest.approx((-3.2, -2.2, -1), abs=1e-5)
    assert pyo.value(m.cost) == pytest.approx(3.2, abs=1e-6)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["leader.nl", "--contact", "barrier"], "--contact has no effect on an .nl file"),
        (["leader.nl", "-s", "tol=abc"], "tol"),
        (["other.nl"], "other.nl cannot be read"),
        (["integer.nl"], "2 integer variables"),
    ],
)
def test_bad_input_exits_2(ocp, model: Path, words: list[str], message: str) -> None:
    text = model.read_text().replace(" 0 0 0 0 0 \t# discrete", " 2 0 0 0 0 \t# discrete")
    model.with_name("integer.nl").write_text(text)
    done = ocp("solve", *words)
    assert done.code == 2 and message in done.err
    assert not list(model.parent.glob("*.sol"))
