"""A controller at a multiple of its plans' rate: the linear regulator's inputs, costs, bits, gains, bad rates."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import solve_discrete_are

from ocp.errors import InputError
from ocp.mpc import Controller, Disturbance, simulate
from ocp.mpc.rates import gains_along, interpolate_plan
from ocp.mpc.stages import Plan
from problems import get

NOISE = Disturbance(noise_state=0.003, noise_input=0.01, delay=True)
CALM = {"p0": 0.02, "theta0": 0.01, "dp0": 0.03, "dtheta0": -0.02}


def dynamics(p: dict[str, float]) -> tuple[np.ndarray, np.ndarray]:
    """Return A, B of the pole on a cart, without walls: x' = A x + B u."""
    A, g = np.zeros((4, 4)), 9.81
    A[0, 2] = A[1, 3] = 1.0
    A[2, 1], A[3, 1] = g * p["mp"] / p["mc"], g * (p["mc"] + p["mp"]) / (p["lc"] * p["mc"])
    return A, np.array([[0.0], [0.0], [1 / p["mc"]], [1 / (p["lc"] * p["mc"])]])


@pytest.mark.costly
@pytest.mark.parametrize("r", [1, 2, 5])
def test_away_from_walls_each_sample_has_the_linear_regulators_input(r: int) -> None:
    """The terminal cost is the value of going on, so that u = K x with K of steps h at any rate, held over h / r."""
    problem = get("soft-walls", N=6, **CALM)
    p = problem.parameters.defaults
    A, B = dynamics(p)
    Q, R = np.diag([p["w_p"], p["w_theta"], p["w_dp"], p["w_dtheta"]]), np.array([[p["w_u"]]])
    A_h, B_h = np.eye(4) + p["h"] * A, p["h"] * B
    S = solve_discrete_are(A_h, B_h, Q, R)
    K = -np.linalg.solve(R + B_h.T @ S @ B_h, B_h.T @ S @ A_h)
    loop = simulate(Controller(problem, rate=r / p["h"]), 8 * r)
    x, u = loop.data["x"].values[0], loop.data["u"].values[0]
    assert u == pytest.approx(x[:-1] @ K.T, abs=1e-5 * abs(u).max())
    assert x[1:] == pytest.approx(x[:-1] + p["h"] / r * (x[:-1] @ A.T + u @ B.T), abs=1e-9)
    stages = (np.einsum("ki,ij,kj->k", x[:-1], Q, x[:-1]) + R[0, 0] * u[:, 0] ** 2) / r
    assert loop.data["cost"].values[0] == pytest.approx(stages, rel=1e-9)


@pytest.mark.costly
@pytest.mark.parametrize("phase", ["qpcc", "policy"])
def test_one_sample_per_step_has_the_bits_of_no_rate(phase: str) -> None:
    problem = get("soft-walls")
    first, second = (simulate(Controller(problem, phase=phase, rate=rate), 25, "exact", NOISE) for rate in (None, 100))
    for name in ("x", "u", "plan", "cost", "merit", "end_cost"):
        assert first.data[name].values.tobytes() == second.data[name].values.tobytes(), name


@pytest.mark.costly
def test_the_same_seed_gives_the_same_bits_at_any_rate() -> None:
    controller = Controller(get("soft-walls"), rate=300)
    first, second = (simulate(controller, 30, "exact", NOISE, seeds=2, seed=4) for _ in range(2))
    for name in ("x", "u", "plan", "cost", "merit"):
        assert first.data[name].values.tobytes() == second.data[name].values.tobytes(), name
    assert not np.array_equal(first.data["x"][0], first.data["x"][1])


@pytest.mark.costly
def test_the_spinner_is_turned_at_five_times_the_rate_of_its_plans() -> None:
    """The goal moves at 1 rad/s; plans have 20 steps a second."""
    loop = simulate(Controller(get("spinner"), rate=100), 300)
    assert loop.survived.all()
    assert loop.data["x"].values[0, -1, 2] > 1.5


def test_plans_and_gains_between_steps_are_interpolated() -> None:
    rng = np.random.default_rng(0)
    x, u, K = rng.standard_normal((5, 3)), rng.standard_normal((4, 2)), rng.standard_normal((4, 2, 3))
    plan, zeros = Plan(x, u, np.zeros((4, 1)), np.zeros((4, 1))), np.zeros((4, 1))
    shifted = Plan(x + 1, u + 2, zeros + 3, zeros + 4)
    quarter = interpolate_plan(plan, shifted, 0.25)
    for name, change in (("x", 0.25), ("u", 0.5), ("lam", 0.75), ("gap", 1.0)):
        assert getattr(quarter, name) == pytest.approx(getattr(plan, name) + change)
    assert interpolate_plan(plan, shifted, 1.0) is shifted
    gains = gains_along(plan, K, 4)
    for k in range(16):
        j, share = k // 4, k % 4 / 4
        state = x[j] + share * (x[j + 1] - x[j])
        planned = u[j] + share * (u[min(j + 1, 3)] - u[j])
        assert gains.input(k, state) == pytest.approx(planned)
        assert gains.K[k] == pytest.approx(K[j])


@pytest.mark.costly
def test_a_users_policy_gets_the_step_of_the_plan() -> None:
    steps = []

    def policy(x: np.ndarray, k: int) -> np.ndarray:
        steps.append(k)
        return np.zeros(1)

    simulate(Controller(get("soft-walls", N=5), phase="policy", policy=policy, rate=300), 7)
    assert steps == [0, 0, 0, 1, 1, 1, 2]


@pytest.mark.parametrize(
    ("name", "rate", "sentence"),
    [
        ("soft-walls", 150, "a rate of 150 Hz is 1.5 samples per step of 0.01 s; give a multiple of 100 Hz"),
        ("soft-walls", 50, "a rate of 50 Hz is 0.5 samples per step"),
        ("soft-walls", 1e9, "samples per step of 0.01 s must be a whole number <= 10000"),
        ("soft-walls", 0, "rate must be greater than 0"),
        ("wall-1d", 20, "a rate above 10 Hz needs a plant with smaller steps, but an input is an impulse per step"),
    ],
)
def test_rates_that_cannot_be_get_one_sentence(name: str, rate: float, sentence: str) -> None:
    with pytest.raises(InputError, match=sentence):
        Controller(get(name), rate=rate)


def test_the_phase_full_has_no_higher_rate() -> None:
    with pytest.raises(InputError, match="phase full plans whole steps"):
        Controller(get("soft-walls"), phase="full", rate=200)
