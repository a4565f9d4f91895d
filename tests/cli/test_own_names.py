"""Parameters and signals of users may have the names of ours."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from ocp import solve
from ocp.store import load
from problems import get
from problems.registry import spec
from reports.documents.sweep import estimate_page, sweep_page
from reports.drawing.view import RunView

OURS = (
    "mu",
    "kappa",
    "sigma",
    "penalty",
    "relaxation",
    "x",
    "u",
    "lam",
    "gap",
    "cost",
    "success",
    "exact_cost",
    "iterations",
    "status",
    "seed",
    "node",
    "state",
    "scenario",
    "barrier",
    "exact",
    "contact",
    "method",
    "value",
    "point",
    "params",
    "problem",
    "samples",
    "theta",
)
BLOCK = '''"""A block on a rough floor is pushed towards a wall."""
import casadi as ca
from dynamics.systems import signals, time_stepping
from ocp.problem.problem import Problem, Scaling
from problems.parameters import Parameters, quantity, structure, table

name, title = "{name}", "A block on a rough floor"


class Params(Parameters):
    {a}mu: float = quantity(0.3, "1", "Coulomb's coefficient", least=0)
    {a}kappa: float = quantity(1.0, "kg", "mass", above=0)
    {a}sigma: float = quantity(0.6, "m", "goal")
    {a}penalty: float = quantity(10.0, "1/m^2", "terminal weight", least=0)
    {a}relaxation: float = quantity(0.01, "1/N^2", "weight of the inputs", least=0)
    {a}x: float = quantity(0.0, "m", "start")
    {a}u: float = quantity(20.0, "N", "largest input", above=0)
    {a}lam: float = quantity(0.5, "m", "place of the wall")
    {a}gap: float = quantity(0.0, "m", "height of the floor")
    {a}cost: float = quantity(0.1, "s^2/m^2", "weight of the velocity", least=0)
    h: float = quantity(0.05, "s", "step", above=0)
    N: int = structure(10, "steps", least=1)
{factors}


def build(params):
    p = table(params)
    weight = p["{a}penalty"]
    for factor in {names!r}:
        weight = weight * p[factor]
    system = time_stepping(
        name, states=signals("{states}"), inputs=signals("{inputs}"),
        contacts=signals("{contacts}"), h=p["h"], mass=p["{a}kappa"] * ca.SX.eye(2),
        impulse=lambda q, v, w: p["h"] * ca.vertcat(w[0], w[1] - 9.81 * p["{a}kappa"]),
        distance=lambda q: ca.vertcat(q[1] - p["{a}gap"], p["{a}lam"] - q[0]),
        sliding=lambda q: ca.SX.eye(2), friction=ca.vertcat(p["{a}mu"], 0), parameters=p,
    )
    s = system.x
    return Problem(
        name, system, params.N, stage_cost=p["{a}relaxation"] * ca.sumsqr(system.u),
        terminal_cost=weight * (s[0] - p["{a}sigma"]) ** 2 + p["{a}cost"] * ca.sumsqr(s[2:]),
        x0=ca.vertcat(p["{a}x"], p["{a}gap"], 0, 0), parameters=p, u_lower=-p["{a}u"],
        u_upper=p["{a}u"], scaling=Scaling(impulse=0.5, gap=0.1, x=0.5, u=5),
    )
'''


@pytest.fixture
def files(tmp_path: Path) -> tuple[Path, Path]:
    """Return the files of the same problem with names that the package uses, and with others."""
    written = []
    for name, a, signals in (
        ("ours", "", ("x [m]; lam [m]; mu [m/s]; gap [m/s]", "cost [N]; u [N]", "kappa [N s]; sigma [N s]")),
        ("theirs", "my_", ("a [m]; b [m]; c [m/s]; d [m/s]", "e [N]; f [N]", "floor [N s]; wall [N s]")),
    ):
        names = [a + one for one in OURS[10:]]
        factors = "\n".join(f'    {one}: float = quantity(1.0, "1", "factor")' for one in names)
        text = BLOCK.format(
            name=name,
            a=a,
            names=names,
            factors=factors,
            states=signals[0],
            inputs=signals[1],
            contacts=signals[2],
        )
        (tmp_path / f"{name}.py").write_text(text)
        written.append(tmp_path / f"{name}.py")
    return written[0], written[1]


def numbers(text: str) -> list[str]:
    return re.findall(r"[-\d.]+(?:e-?\d+)?", text)


@pytest.mark.costly
@pytest.mark.parametrize(("law", "settings"), [("exact", {}), ("barrier", {"mu": 1e-4})])
def test_a_plan_is_that_of_the_same_problem_with_other_names(files, law, settings) -> None:
    """A terminal weight called penalty is not confused with the penalty of a route."""
    changed = {"mu": 0.4, "penalty": 20.0, "relaxation": 0.02, "seed": 1.5}
    plans = [
        solve(get(str(path), **{a + key: value for key, value in changed.items()}), law, contact_settings=settings)
        for path, a in zip(files, ("", "my_"), strict=True)
    ]
    ours, theirs = plans
    assert ours.success and ours.cost == pytest.approx(theirs.cost, rel=1e-9) and ours.cost > 1
    np.testing.assert_allclose(ours.data["u"].values, theirs.data["u"].values, atol=1e-7)
    assert numbers(ours.verdict.partition("\n")[0]) == numbers(theirs.verdict.partition("\n")[0])
    assert [ours.values[key] for key in changed] == list(changed.values())
    if law == "exact":
        return
    assert ours.values["contact.mu"] == 1e-4 and ours.record["contact_settings"]["mu"] == 1e-4
    for key in ("mu", "penalty", "relaxation"):
        slopes = ours.sensitivity(key), theirs.sensitivity(f"my_{key}")
        assert float(slopes[0]["cost"]) == pytest.approx(float(slopes[1]["cost"]), rel=1e-5)
    assert float(ours.sensitivity("contact.mu")["cost"]) < -100


@pytest.mark.costly
def test_a_sweep_of_ones_own_mu_is_no_place_on_the_central_path(files, ocp) -> None:
    def page(over: str) -> dict[str, Any]:
        done = ocp("sweep", str(files[0]), "--contact", "barrier", "--over", over, "--json", "-q")
        return sweep_page(RunView.of(load(Path(done.json["run"])), spec(str(files[0]))))[0]

    friction, law = page("mu=0.1:0.3:2"), page("contact.mu=1e-4:1e-3:2")
    assert friction["law"]["place"] == law["law"]["place"] == ""
    assert "mu" not in {row[0] for row in friction["parameters"]}
    assert "mu" in {row[0] for row in law["parameters"]}, "the friction is constant there"
    assert ["law", "barrier (μ = 0.001)"] in friction["request"] and ["law", "barrier"] in law["request"]
    seeds = page("seed=1:2:2")
    assert "seed" not in {row[0] for row in seeds["parameters"]}
    assert "seed" in {row[0] for row in seeds["settings"]}, "the seed of the solve"


@pytest.mark.costly
def test_ones_own_sigma_is_not_the_noise_of_an_estimate(files, ocp) -> None:
    plain = ("estimate", str(files[0]), "--samples", "50", "--estimators", "fobg", "--json", "-q")
    found = ocp(*plain, "-p", "sigma=0.7", "--sigma", "0.01").json
    stored = load(Path(found["run"]))
    assert (stored.record["params"]["sigma"], stored.record["sigma"]) == (0.7, 0.01)
    noise = ocp(*plain, "--sweep", "sigma=0.01:0.02:2", "-p", "sigma=0.7").json
    content, _ = estimate_page(load(Path(noise["run"])), spec(str(files[0])))
    assert ["sigma", "0.7"] in [row[:2] for row in content["parameters"]]
    goals = ocp(*plain, "--sweep", "problem.sigma=0.4:0.7:2").json
    theirs = ocp("estimate", str(files[1]), *plain[2:], "--sweep", "my_sigma=0.4:0.7:2").json
    means = [[row["mean"] for row in one["estimates"]] for one in (goals, theirs)]
    np.testing.assert_allclose(means[0], means[1], rtol=1e-9)
    assert not np.allclose(means[0][0], means[0][1])
    content, _ = estimate_page(load(Path(goals["run"])), spec(str(files[0])))
    assert "sigma" not in {row[0] for row in content["parameters"]} and "[m]" in content["swept"]
    twice = ocp(*plain, "--sweep", "problem.sigma=0.4:0.7:2", "-p", "sigma=1")
    assert twice.code == 2 and "drop -p sigma" in twice.err
