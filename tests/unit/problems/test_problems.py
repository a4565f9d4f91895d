"""The registry, parameters, and hand-computed steps of the first five problems."""

from __future__ import annotations

from dataclasses import asdict

import casadi as ca
import numpy as np
import pytest
import typst

import problems
from dynamics.contact import Exact
from dynamics.settings import settings_of
from ocp.errors import InputError
from ocp.problem.problem import Problem
from problems import registry
from problems.parameters import is_structural
from problems.tasks import registry as tasks
from reports.cli.request import parse_assignments

NAMES = ["wall-1d", "push-1d", "push-disc", "ball-bounce", "cart-walls"]
MACHINES = ("hopper", "half-cheetah")
FINGERS = ("spinner", "finger-disc")
PARAMETERS = [(name, parameter) for name in NAMES for parameter in problems.spec(name).Params.model_fields]


def other_value(name: str, parameter: str) -> float:
    """Return a valid value of a parameter near its default."""
    default = problems.spec(name).Params.model_fields[parameter].default
    return default + 1 if isinstance(default, int) else 1.01 * default or 0.01


def expressions(problem: Problem) -> ca.SX:
    """Return all expressions of a problem that can depend on a parameter, as one vector."""
    system = problem.system
    bounds = [problem.u_lower, problem.u_upper, problem.x_lower, problem.x_upper]
    before = [] if problem.u_before is None else [problem.u_before]
    parts = [system.residual, system.gap, problem.stage_cost, problem.terminal_cost, problem.x0]
    return ca.vertcat(*parts, *before, *(ca.SX(bound) for bound in bounds))


def test_the_first_five_problems_are_registered_in_order():
    assert problems.names()[:5] == NAMES


def test_titles_read_from_sources_are_those_of_the_modules():
    modules = {**registry.PROBLEM_MODULES, **registry.ARENA_MODULES}
    assert registry.titles(modules) == {name: problems.spec(name).title for name in modules}
    objectives = {name: registry.objective_spec(name).title for name in registry.OBJECTIVE_MODULES}
    assert registry.titles(registry.OBJECTIVE_MODULES) == objectives
    assert registry.titles(tasks.TASK_MODULES) == {name: tasks.spec(name).title for name in tasks.TASK_MODULES}


@pytest.mark.one_case_in(6)
@pytest.mark.parametrize(("name", "parameter"), PARAMETERS)
def test_every_parameter_can_be_set_and_reaches_the_problem(name: str, parameter: str):
    value = other_value(name, parameter)
    given: dict[str, object] = {parameter: str(value)}
    if parameter.startswith("scenario_"):
        given["scenarios"] = 3
    problem = problems.get(name, **given)
    if is_structural(settings_of(problems.spec(name).Params)[parameter]):
        assert problem.origin.settings[parameter] == value
    else:
        assert problem.parameters.defaults[parameter] == value
        assert ca.depends_on(expressions(problem), problem.parameters[parameter])


@pytest.mark.cheap_cases("wall-1d", "push-1d", "ball-bounce", "cart-walls", "box-slide", "ball-throw", "hopper-1d")
@pytest.mark.parametrize("name", problems.names())
def test_a_run_records_every_parameter_that_built_its_problem(name: str):
    """A run records parameters as symbols or as settings; without friction some problems have no symbol for it."""
    spec = problems.spec(name)
    rough = (*MACHINES, *FINGERS, "idto-hopper", "planar-push", "planar-hand")
    smooth = {"friction": 0.0} if name in rough else {}
    for given in ({}, {"N": 3}, smooth):
        problem = spec.problem(given)
        symbols = dict(zip(problem.parameters.names, problem.parameters.values, strict=True))
        assert {**symbols, **problem.origin.settings} == spec.params(given).model_dump()
        assert not symbols.keys() & problem.origin.settings.keys()
        assert spec.citation is not None and problem.origin.citation == spec.citation.key


def test_structural_parameters_shape_the_problem():
    assert problems.get("wall-1d", N=7).N == 7
    many = problems.get("push-disc", scenarios=8)
    starts = many.initial_states(many.parameters.values)
    assert starts.shape == (8, 4)
    assert np.all(starts[:, 2:] == [-1, 0.2])
    assert np.all(np.abs(starts[:, :2]) < 4 * 0.03)
    assert len(np.unique(starts[:, 0])) == 8
    again = problems.get("push-disc", scenarios=8)
    other = problems.get("push-disc", scenarios=8, scenario_seed=1)
    assert np.array_equal(starts, again.initial_states(again.parameters.values))
    assert not np.array_equal(starts, other.initial_states(other.parameters.values))
    wide = problems.get("push-disc", scenarios=8, scenario_std=0.06)
    assert np.allclose(wide.initial_states(wide.parameters.values)[:, :2], 2 * starts[:, :2])


@pytest.mark.parametrize("name", NAMES)
def test_every_parameter_is_described(name: str):
    for row in problems.describe(problems.spec(name)):
        assert row["description"], row
        assert row["unit"], row
        assert np.isfinite(row["value"])


# Costs with their published numbers, functions from (x, u, du) to (stage, terminal).
HAND = {
    "wall-1d": lambda x, u, du: (
        (x[0] + 0.5) ** 2 + 0.1 * x[1] ** 2 + 0.01 * u[0] ** 2,
        10 * (x[0] + 0.5) ** 2,
    ),
    "push-1d": lambda x, u, du: ((x[0] - 1) ** 2 + 0.1 * du[0] ** 2, 100 * (x[0] - 1) ** 2),
    "push-disc": lambda x, u, du: (
        0.01 * ((x[0] - 1) ** 2 + (x[1] - 0.5) ** 2) + 0.1 * (du[0] ** 2 + du[1] ** 2),
        10 * ((x[0] - 1) ** 2 + (x[1] - 0.5) ** 2),
    ),
    "ball-bounce": lambda x, u, du: (
        0.01 * 0.05 * (u[0] ** 2 + u[1] ** 2),
        100 * ((x[0] - 2) ** 2 + (x[1] - 0.5) ** 2) + x[2] ** 2 + x[3] ** 2,
    ),
    "cart-walls": lambda x, u, du: (
        10 * x[0] ** 2 + 50 * x[1] ** 2 + x[2] ** 2 + 5 * x[3] ** 2 + 0.1 * u[0] ** 2,
        100 * float(np.sum(x**2)),
    ),
}
STARTS = {
    "wall-1d": ([1, 0], [0], 1, 30, 0.1),
    "push-1d": ([0, -0.5], [-0.5], 2, 20, 0.1),
    "push-disc": ([0, 0, -1, 0.2], [-1, 0.2], 3, 20, 0.1),
    "ball-bounce": ([0, 1, 1, -6], [0, 0], 15, 40, 0.05),
    "cart-walls": ([0.1, 0.2, 0.5, 2.0], [0], 4, 50, 0.04),
}


@pytest.mark.parametrize("name", NAMES)
def test_costs_match_the_hand_computed_ones(name: str):
    problem = problems.get(name)
    rng = np.random.default_rng(3)
    for _ in range(5):
        x, u = rng.normal(size=problem.system.nx), rng.normal(size=problem.system.nu)
        du = rng.normal(size=problem.system.nu)
        got = problem.cost_terms(x, u, du, 0, problem.parameters.values)
        assert np.allclose([float(value) for value in got], HAND[name](x, u, du), rtol=1e-13)


@pytest.mark.parametrize("name", NAMES)
def test_start_bounds_horizon_and_step_are_those_of_the_issue(name: str):
    problem = problems.get(name)
    x0, before, u_max, steps, h = STARTS[name]
    p = problem.parameters.values
    limits = [np.array(value).ravel() for value in problem.limits(p)]
    assert np.array_equal(limits[0], x0)
    assert np.array_equal(limits[1], before)
    assert np.all(limits[2] == -u_max)
    assert np.all(limits[3] == u_max)
    assert steps == problem.N
    step = ca.Function("h", [problem.parameters.vector], [problem.system.h])
    assert float(step(p)) == h


def exact_step(name: str, x: list[float], u: list[float]) -> tuple[np.ndarray, np.ndarray]:
    problem = problems.get(name)
    x_next, lam = Exact().close(problem.system).map(x, u, problem.parameters.values)
    return np.array(x_next).ravel(), np.array(lam).ravel()


def test_wall_stops_the_mass():
    # z = 0.05 + 0.1 (-1 + 0.2) = -0.03, lam = 0.03 m / h
    assert np.allclose(exact_step("wall-1d", [0.05, -1], [0.2])[0], [0, -0.5])
    assert np.allclose(exact_step("wall-1d", [0.05, -1], [0.2])[1], 0.3)


def test_pusher_moves_the_mass_by_the_ratio_of_stiffnesses():
    # rho = h² K / (M + h² K) = 1/2, pushed by u - (qu - width) = 0.3
    x_next, lam = exact_step("push-1d", [0, -0.5], [0.1])
    assert np.allclose(x_next, [0.15, -0.05])
    assert np.allclose(lam, 0.15 / 0.1)


def test_disc_moves_along_the_line_of_centres():
    x_next, lam = exact_step("push-disc", [0, 0, -0.6, 0], [-0.3, 0])
    share = 0.01 * 50 / (1 + 0.01 * 50)
    assert np.allclose(x_next, [0.3 * share, 0, -0.6 + 0.3 * share, 0])
    assert np.allclose(lam, 0.3 * share / 0.1)
    assert np.allclose(exact_step("push-disc", [0, 0, -1, 0.2], [-1, 0.2])[1], 0)


def test_ball_lands_without_bouncing():
    x_next, lam = exact_step("ball-bounce", [0, 0.1, 1, -6], [2, 9.81])
    assert np.allclose(x_next, [0.05 * 1.1, 0, 1.1, -2])
    assert np.allclose(lam, 4)
    x_next, lam = exact_step("ball-bounce", [0, 1, 0, 0], [0, 0])
    assert np.allclose(x_next, [0, 1 - 9.81 * 0.05**2, 0, -9.81 * 0.05])
    assert np.allclose(lam, 0)


def test_cart_obeys_the_matrices_of_the_issue():
    h, length, k = 0.04, 0.5, 100
    A = np.zeros((4, 4))
    A[0, 2] = A[1, 3] = 1
    A[2, 1], A[3, 1] = 9.81 * 0.1, 9.81 * 1.1 / length
    B, C = np.array([0, 0, 1, 1 / length]), np.zeros((4, 2))
    C[3] = -1 / (length * 0.1), 1 / (length * 0.1)
    x, u = np.array([0.3, 0.2, 0.5, 2]), 1.5
    x_next, lam = exact_step("cart-walls", list(x), [u])
    assert np.allclose(x_next, x + h * (A @ x_next + B * u + C @ lam), atol=1e-12)
    tip = x_next[0] + length * x_next[1]
    assert lam[0] > 0
    assert np.allclose([lam[0] / k + 0.35 - tip, lam[1]], 0, atol=1e-12)


@pytest.mark.parametrize("name", NAMES)
def test_drawings_are_plain_data_that_moves_with_the_state(name: str):
    spec, problem = problems.spec(name), problems.get(name)
    assert spec.draw is not None
    assert spec.frames is not None
    params, start = spec.params({}), problem.initial_states(problem.parameters.values)[0]
    here, there = spec.draw(params, start), spec.draw(params, start + 0.1)
    assert here != there
    assert here == spec.draw(params, start)
    for shape in here:
        assert all(isinstance(value, float | int | str) for value in asdict(shape).values())
    frames = spec.frames(params, start)
    assert len(frames) == problem.system.nlam
    assert np.allclose([np.hypot(frame.nx, frame.ny) for frame in frames], 1)


def test_equations_are_valid_typst():
    lines = [line for name in NAMES for line in problems.spec(name).equations]
    assert len(lines) > len(NAMES)
    document = "\n\n".join(f"$ {line} $" for line in lines)
    assert typst.compile(document.encode(), format="pdf")


@pytest.mark.parametrize(
    ("name", "values", "sentence"),
    [
        ("push-disk", {}, "did you mean 'push-disc'"),
        ("nothing-like-it", {}, "wall-1d, push-1d, push-disc, ball-bounce, cart-walls"),
        ("push-disc", {"M": -1}, r"M \(mass of the object\) must be a number > 0 \[kg\], got -1"),
        ("push-disc", {"M": "heavy"}, r"must be a number > 0 \[kg\], got 'heavy'"),
        ("push-disc", {"M": float("nan")}, r"must be a number > 0 \[kg\], got nan"),
        ("push-disc", {"M": float("inf")}, r"\[kg\], got inf"),
        ("push-disc", {"goalx": 1}, r"unknown parameter 'goalx' \(did you mean 'goal_x'\?\)"),
        ("push-disc", {"N": 0}, "N .* must be a whole number >= 1, got 0"),
        ("push-disc", {"N": 1.5}, "N .* must be a whole number >= 1, got 1.5"),
        ("push-disc", {"scenario_std": -0.1}, r"scenario_std .* >= 0 \[m\]"),
        ("push-disc", {"ox0": -0.9}, "starts inside the object"),
        ("push-1d", {"qa0": 0.1}, "starts inside the object"),
    ],
)
def test_bad_input_gets_its_sentence(name: str, values: dict, sentence: str):
    with pytest.raises(InputError, match=sentence) as raised:
        problems.get(name, **values)
    assert "\n" not in str(raised.value)


@pytest.mark.parametrize(
    ("assignment", "sentence"),
    [
        (["M"], "expected name=value, got 'M'"),
        (["=2"], "expected name=value"),
        (["M="], "expected name=value"),
        (["M=1", "M=2"], "M is given twice"),
        (["M=1,5"], "got '1,5'"),
    ],
)
def test_bad_assignments_get_their_sentence(assignment: list[str], sentence: str):
    with pytest.raises(InputError, match=sentence):
        problems.spec("push-disc").params(parse_assignments("-p", assignment))
