"""Optima of box-slide, cart-transport, ball-throw and hopper-1d, found without the workbench."""

from __future__ import annotations

import functools

import numpy as np
import pytest
from scipy.optimize import minimize

from dynamics.contact import Barrier, Exact
from ocp import Direct, MultipleShooting, SingleShooting, Solution, Status, solve
from ocp.problem.rollout import initial_guesses
from ocp.solve.judging import judge_outcome
from ocp.solve.solve import new_session
from problems import get, spec
from problems.library import ball_throw, hopper_1d
from tests.golden import schedules

FOUR = ("box-slide", "ball-throw", "cart-transport", "hopper-1d")


@functools.cache
def exact(name: str) -> Solution:
    return solve(get(name), Exact(), Direct(), settings={"tol": 1e-10}, effort="quick")


def slid(found: Solution) -> np.ndarray:
    """Return 1, -1 or 0 for every step, if it slides forward, backward or not."""
    forward, backward = found.data["lam"].values[0].T > 1e-7
    return forward.astype(int) - backward.astype(int)


@pytest.mark.cheap_cases("box-slide")
@pytest.mark.parametrize("name", FOUR)
def test_the_answer_is_exact(name: str) -> None:
    found = exact(name)
    assert found.status is Status.SOLVED
    assert found.audit.exact_cost == pytest.approx(found.cost, rel=1e-6)
    assert found.audit.complementarity < 1e-10


@pytest.mark.costly_cases("cart-transport-peer1")
@pytest.mark.parametrize(("name", "peer"), [("box-slide", schedules.box()), ("cart-transport", schedules.cart())])
def test_dry_friction_is_the_best_of_the_convex_programs_around_it(name: str, peer) -> None:
    found = exact(name)
    modes = slid(found)
    start, end = np.flatnonzero(modes)[[0, -1]] + [0, 1]
    assert np.array_equal(modes, schedules.window(start, end)), "stick, slide forward, stick"
    assert peer.best(modes) == pytest.approx(found.cost, rel=1e-8)
    around = [(start + a, min(end + b, 40)) for a in (-1, 0, 1) for b in (-1, 0, 1)]
    assert min(peer.best(schedules.window(*w)) for w in around) > found.cost * (1 - 1e-8)


@pytest.mark.slow
@pytest.mark.parametrize(("name", "peer"), [("box-slide", schedules.box()), ("cart-transport", schedules.cart())])
def test_the_stated_value_is_the_best_of_all_schedules(name: str, peer) -> None:
    golden = spec(name).golden["exact"]
    costs = [peer.best(schedules.window(a, b)) for a in range(40) for b in range(a + 1, 41)]
    assert f"all {len(costs)} schedules" in golden.independent
    assert min(costs) == pytest.approx(golden.cost, rel=golden.tolerance)


def test_the_cart_carries_the_box_and_brakes_it_forward() -> None:
    found = exact("cart-transport")
    x = found.data["x"].values[0]
    assert x[-1] == pytest.approx([1, 0.2, 0, 0], abs=0.03)
    cart, box = np.diff(x[:, 2]) / 0.05, np.diff(x[:, 2] + x[:, 3]) / 0.05
    slides = slid(found) == 1
    assert box[slides] == pytest.approx(np.full(slides.sum(), -0.2 * 9.81), rel=1e-6)
    assert np.abs(box[~slides]).max() <= 0.2 * 9.81 + 1e-6
    assert cart[slides][0] < box[slides][0], "the cart brakes harder than friction holds"


def idle_cost(found: Solution) -> float:
    """Return the sum of squares of inputs after the throw: angle [rad], and speed over the largest."""
    idle = found.data["u"].values[0, 1:] / [1.0, found.values["speed_max"]]
    return float((idle**2).sum())


@pytest.mark.costly
def test_the_throw_is_the_best_of_a_simulation() -> None:
    p = ball_throw.Params()
    goal = np.array([p.goal_x, p.goal_z, p.goal_vx, p.goal_vz])

    def cost(decision: np.ndarray) -> float:
        off = ball_throw.roll(p, *decision)[-1, :4] - goal
        weights = np.array([p.w_end, p.w_end, p.w_v, p.w_v])
        return float(p.w_speed * decision[1] ** 2 + weights @ off**2)

    peer = minimize(cost, [0.6, 3.0], method="Nelder-Mead", options={"xatol": 1e-9, "fatol": 1e-15})
    found = exact("ball-throw")
    assert spec("ball-throw").golden["exact"].cost == pytest.approx(peer.fun, rel=1e-9)
    assert found.cost - idle_cost(found) == pytest.approx(peer.fun, rel=1e-9)
    assert found.data["u"].values[0, 0] == pytest.approx(peer.x, abs=1e-4)
    assert np.abs(found.data["u"].values[0, 1:]).max() < 1e-4
    assert cost(np.array([0.6, 3.0])) == pytest.approx(9 * p.w_speed, abs=1e-6), "in reach"


def highest(params: hopper_1d.Params) -> float:
    """Return the largest ``zc_N - zc_0 - w_v vc_N²`` [m], in closed form.

    The ground pushes with ``lam/h`` in [0, u_max + mf g], so the centre of mass accelerates within
    [-g, a], a = (u_max - mb g)/M, M = mb + mf. The largest distance in a given time needs the
    minimum time for that distance, and Pontryagin's principle gives one switch: full force for t
    with ``a t = g (T - t)``, then flight; the distance is ``a t T/2``.

    Implicit Euler has ``zc_N - zc_0 = h² sum_j (N - j + 1) a_j`` and ``vc_N = h sum_j a_j``: early
    steps count most, so that s steps have full force and one, j = s + 1, a share of it, at which
    ``vc_N = h (N - s)/(2 w_v)`` unless the share leaves [0, 1]. With t on a node the height is
    ``h² a s N/2 + h² (N - s)²/(4 w_v)``. It is reached if the leg is long enough for the body's
    distance in stance, (u_max/mb - g) t²/2.
    """
    N, h, g, w = params.N, params.h, params.g, params.w_v
    push = (params.u_max + params.mf * g) / (params.mb + params.mf)

    def value(s: int) -> float:
        share = float(np.clip(((N - s) / (2 * w) + g * N) / push - s, 0, 1))
        distance = push * (s * (2 * N - s + 1) / 2 + share * (N - s)) - g * N * (N + 1) / 2
        return h**2 * distance - w * (h * (push * (s + share) - g * N)) ** 2

    return max(value(s) for s in range(N))


@pytest.mark.costly
def test_the_hopper_pushes_and_flies_as_the_maximum_principle_says() -> None:
    found, p = exact("hopper-1d"), hopper_1d.Params()
    assert found.cost == pytest.approx(-highest(p), rel=1e-8)
    force = found.data["lam"].values[0, :, 0] / p.h
    assert force[:10] == pytest.approx(np.full(10, p.u_max + p.mf * p.g), rel=1e-6)
    assert force[11:] == pytest.approx(np.zeros(9), abs=1e-6)


@pytest.mark.parametrize("values", [{}, {"N": 13}, {"u_max": 70.0}, {"mb": 3.0, "w_v": 2.0}])
def test_the_highest_jump_is_that_of_a_linear_program(values: dict) -> None:
    """In the accelerations a_j in [-g, a] the problem is a QP."""
    p = hopper_1d.Params(**values)
    M, N, h = p.mb + p.mf, p.N, p.h
    top = (p.u_max - p.mb * p.g) / M
    count = N - np.arange(N)

    def loss(a: np.ndarray) -> tuple[float, np.ndarray]:
        return p.w_v * a.sum() ** 2 - count @ a, 2 * p.w_v * a.sum() - count

    found = minimize(
        loss, np.zeros(N), jac=True, method="SLSQP", bounds=[(-p.g, top)] * N, options={"ftol": 1e-13, "maxiter": 1000}
    )
    assert highest(p) == pytest.approx(-(h**2) * found.fun, rel=1e-8)


def test_the_highest_jump_tends_to_half_the_largest_velocity_times_the_time() -> None:
    p = hopper_1d.Params(N=2000, h=0.5 / 2000, w_v=1e4)
    a = (p.u_max - p.mb * p.g) / (p.mb + p.mf)
    assert highest(p) == pytest.approx(a * 0.25 * 0.5 / 2, rel=1e-4)


@pytest.mark.cheap_cases("cart-transport-method0")
@pytest.mark.parametrize("method", [MultipleShooting(), SingleShooting()])
@pytest.mark.parametrize("name", ["box-slide", "cart-transport"])
def test_methods_agree_on_the_barrier_optimum(name: str, method) -> None:
    direct, found = (solve(get(name), Barrier(mu=1e-3), m) for m in (Direct(), method))
    assert direct.success
    assert found.success
    assert found.cost == pytest.approx(direct.cost, rel=1e-6)
    np.testing.assert_allclose(found.data["lam"] * found.data["gap"], 1e-3, atol=1e-9)


def test_shooting_throws_as_well_without_any_homotopy() -> None:
    """The bounce is differentiated correctly, so that the exact gradient leads to the best throw."""
    golden = spec("ball-throw").golden["exact"]
    settings = {"homotopy": False, "tol": 1e-10}
    found = solve(get("ball-throw"), Exact(), SingleShooting(), settings=settings)
    assert found.success
    assert found.cost == pytest.approx(golden.cost, rel=golden.tolerance)


@pytest.mark.cheap_cases("method1-own1-1e-08")
@pytest.mark.parametrize(
    "tol",
    [1e-8, 1e-11, *(pytest.param(tol, marks=pytest.mark.slow) for tol in (1e-9, 1e-10))],
)
@pytest.mark.parametrize(("method", "own"), [(Direct(), {}), (SingleShooting(), {"homotopy": False})])
def test_idle_inputs_cost_what_the_interior_point_leaves(method, own, tol) -> None:
    """They cost at most (N - 1) tol / 2, which falls with the solver's tolerance."""
    golden = spec("ball-throw").golden["exact"]
    found = solve(get("ball-throw"), Exact(), method, settings={**own, "tol": tol})
    excess = found.cost - golden.cost
    assert -1e-9 * golden.cost < excess <= 49 * tol / 2
    assert excess == pytest.approx(idle_cost(found), abs=1e-9 * golden.cost)


@pytest.mark.costly
@pytest.mark.parametrize("name", ["box-slide", "cart-transport", "hopper-1d"])
def test_shaken_guesses_end_at_the_same_optimum(name: str) -> None:
    session = new_session(get(name), Exact(), Direct())
    for guess in initial_guesses(session.evaluation, 4, 7)[1:]:
        found = judge_outcome(session, session.solve(guess=guess), 7)
        assert found.success
        assert found.cost == pytest.approx(exact(name).cost, rel=1e-6)


def test_a_push_that_friction_holds_is_no_progress_for_a_gradient() -> None:
    found = solve(get("box-slide"), Exact(), SingleShooting(), settings={"homotopy": False})
    assert found.status is Status.NO_PROGRESS
    assert np.all(found.data["x"].values[0] == pytest.approx(0, abs=1e-9))
