"""ARS, likelihood ratios, alpha-order gradients and total propagation on a scalar system by hand.

x+ = 0.9 x + 0.5 u, u = 2 tanh(w (x - m) / s + b), reward -(x+ - 1)² - 0.1 u², theta = (w, b).
"""

from __future__ import annotations

from math import log, sqrt, tanh

import numpy as np
import pytest

from ocp.learning.total_propagation import TotalPropagation
from ocp.learning.unroll_gradients import ARS, FOPG, ZOPG, AoBG, mixing_weight, search_direction
from ocp.learning.unrolling import ascend
from tests.unit.ocp.learning.scalar import A, B, scalar
from tests.unit.ocp.learning.scalar import experiment as scalar_experiment

MEAN, SCALE = 0.3, 0.6
PLAIN = {"rate": 1.0, "optimiser": "plain"}
SEEN = {
    "normaliser.n": np.array(4.0),
    "normaliser.mean": np.array([MEAN]),
    "normaliser.m2": np.array([4 * SCALE**2]),
}
THETA = np.array([0.4, -0.2])


def experiment(algorithm, **given):
    """Return an experiment with constant statistics of the observations, so that updates change theta alone."""
    return scalar_experiment(algorithm, normalise=False, **given)


def follow(x: float, theta: np.ndarray, noise: np.ndarray, discount: float = 1.0):
    """Compute the return, the score times sigma², and the states of actions w o + b + noise, step by step."""
    total, score, states = 0.0, np.zeros(2), [x]
    for t, w in enumerate(noise):
        o = (x - MEAN) / SCALE
        u = 2 * tanh(theta[0] * o + theta[1] + w)
        score += w * np.array([o, 1.0])
        x = A * x + B * u
        total += discount**t * (-((x - 1) ** 2) - 0.1 * u**2)
        states.append(x)
    return total, score, states


def slope(x: float, theta: np.ndarray, noise: np.ndarray) -> np.ndarray:
    """Return the gradient of the return by theta, by complex steps, independent of the package's derivatives."""
    found = []
    for k in range(2):
        turned = theta.astype(complex)
        turned[k] += 1e-30j
        z, total = complex(x), 0.0
        for w in noise:
            u = 2 * np.tanh(turned[0] * (z - MEAN) / SCALE + turned[1] + w)
            z = A * z + B * u
            total += -((z - 1) ** 2) - 0.1 * u**2
        found.append(total.imag / 1e-30)
    return np.array(found)


def test_random_search_by_hand():
    algorithm = ARS(directions=3, top=2, spread=0.2, rate=0.3)
    e = experiment(algorithm)
    state = {**algorithm.begin(e), **SEEN, "theta": THETA}
    after, row = algorithm.iterate(e, state, 5)
    delta = e.rng(5, "directions").standard_normal((3, 2))
    starts = e.first_states(3, e.rng(5, "starts"))[:, 0]
    still = np.zeros(2)
    plus, minus = (
        [follow(x, THETA + sign * 0.2 * d, still) for x, d in zip(starts, delta, strict=True)] for sign in (1, -1)
    )
    best = sorted(range(3), key=lambda i: -max(plus[i][0], minus[i][0]))[:2]
    used = [each[i][0] for i in best for each in (plus, minus)]
    change = sum((plus[i][0] - minus[i][0]) * delta[i] for i in best) * 0.3 / (2 * np.std(used))
    assert after["theta"] == pytest.approx(THETA + change, rel=1e-12)
    assert row["return_mean"] == pytest.approx(np.mean([v for v, *_ in plus + minus]), rel=1e-12)


def test_what_was_seen_moves_no_policy():
    """The statistics become those of all states so far, and theta changes such that the inputs stay the same."""
    e = scalar_experiment(ARS(directions=3, top=2, spread=0.2, rate=0.3))
    still = experiment(e.algorithm)
    state = {**e.algorithm.begin(e), **SEEN, "theta": THETA}
    (after, _), (fixed, _) = (each.algorithm.iterate(each, state, 5) for each in (e, still))
    delta = e.rng(5, "directions").standard_normal((3, 2))
    starts = e.first_states(3, e.rng(5, "starts"))[:, 0]
    ways = [
        follow(x, THETA + sign * 0.2 * d, np.zeros(2))[2]
        for sign in (1, -1)
        for x, d in zip(starts, delta, strict=True)
    ]
    seen = np.concatenate([states[:-1] for states in ways])
    whole = (4 * MEAN + seen.sum()) / (4 + len(seen))
    assert after["normaliser.mean"] == pytest.approx([whole], rel=1e-12)
    squares = 4 * (SCALE**2 + MEAN**2) + (seen**2).sum() - (4 + len(seen)) * whole**2
    assert after["normaliser.m2"] == pytest.approx([squares], rel=1e-12)
    x = np.linspace(-1, 2, 7)[:, None]
    assert np.abs(after["theta"] - fixed["theta"]).max() > 1e-3
    moved, kept = (e.inputs(e.algorithm.policy(e, each), x) for each in (after, fixed))
    assert moved == pytest.approx(kept, rel=1e-12)


def test_random_search_stays_where_all_returns_agree():
    assert search_direction(np.ones((2, 3)), np.eye(3), 2) == pytest.approx(np.zeros(3))


def test_likelihood_ratio_by_hand():
    """Samples are pairs of w and -w; the baseline is the mean of the other pairs."""
    algorithm = ZOPG(samples=6, unroll=2, sigma=0.3, **PLAIN)
    e = experiment(algorithm)
    state = {**algorithm.begin(e), **SEEN, "theta": THETA}
    after, row = algorithm.iterate(e, state, 2)
    noise = e.noise(0.3, 2, "actions").draw(3, 2, 1)[..., 0]
    starts = state["starts.x"][:, 0]
    gradients = []
    for i in range(3):
        pairs = [[follow(starts[j], THETA, sign * noise[j]) for sign in (1, -1)] for j in range(3)]
        others = np.mean([v for j in range(3) if j != i for v, *_ in pairs[j]])
        gradients.append(np.mean([(v - others) * s / 0.09 for v, s, _ in pairs[i]], axis=0))
    assert after["theta"] == pytest.approx(THETA + np.mean(gradients, axis=0), rel=1e-10)
    assert row["gradient_variance"] == pytest.approx(np.var(gradients, axis=0, ddof=1).sum())


def test_likelihood_ratio_tends_to_the_gradient():
    """It agrees with the first-order estimate of the same gradient, that of the mean return over the noise."""
    e = experiment(ZOPG(samples=200_000, unroll=2, sigma=0.3, **PLAIN))
    state = {**e.algorithm.begin(e), **SEEN, "theta": THETA}
    after, row = e.algorithm.iterate(e, state, 0)
    noise = np.random.default_rng(0).standard_normal((4000, 2)) * 0.3
    starts = np.random.default_rng(1).uniform(0.25, 0.75, 4000)
    first = np.array([slope(x, THETA, w) for x, w in zip(starts, noise, strict=True)])
    error = sqrt(row["gradient_variance"] / 100_000 + first.var(axis=0).sum() / 4000)
    assert np.linalg.norm(after["theta"] - THETA - first.mean(axis=0)) < 3 * error


def test_alpha_order_by_hand():
    """Alpha weighs the first-order gradient; each order has its own batch."""
    algorithm = AoBG(samples=5, unroll=2, sigma=0.3, **PLAIN, gamma=1e3)
    e = experiment(algorithm)
    state = {**algorithm.begin(e), **SEEN, "theta": THETA}
    starts = state["starts.x"][:, 0]
    draws = {k: e.noise(0.3, 1, k).draw(5, 2, 1)[..., 0] for k in ("first", "zeroth")}
    first = np.array([slope(x, THETA, w) for x, w in zip(starts, draws["first"], strict=True)])
    values = [follow(x, THETA, w) for x, w in zip(starts, draws["zeroth"], strict=True)]
    returns = np.array([v for v, *_ in values])
    zeroth = np.array([(v - (returns.sum() - v) / 4) * s / 0.09 for v, s, _ in values])
    v1, v0 = first.var(axis=0, ddof=1).sum(), zeroth.var(axis=0, ddof=1).sum()
    alpha = v0 / (v0 + v1)
    mixed = alpha * first.mean(axis=0) + (1 - alpha) * zeroth.mean(axis=0)
    after, row = algorithm.iterate(e, state, 1)
    assert row["alpha"] == pytest.approx(alpha, rel=1e-10)
    assert after["theta"] == pytest.approx(THETA + mixed, rel=1e-10)
    assert e.take_step_count() == 20


def test_the_bias_bound_pulls_alpha_back():
    """A step's first-order gradient is 0 without variance, so that alpha would be 1; the bound forbids it."""
    zeroth = np.array([[1.0], [3.0], [2.0], [2.0]])
    none = np.zeros((4, 1))
    level = log(2 / 0.05)
    eps = sqrt(2 * (2 / 3) * level / 4) + 2 * 1.0 * level / 12
    assert mixing_weight(none, zeroth, 1e6, 0.05) == (pytest.approx(1.0), 2.0)
    assert mixing_weight(none, zeroth, eps + 0.5, 0.05)[0] == pytest.approx(0.25)
    assert mixing_weight(none, zeroth, 0.9 * eps, 0.05)[0] == 0.0
    equal = zeroth + np.array([[0.5], [-0.5], [0.0], [0.0]])
    v1, v0 = equal.var(ddof=1), zeroth.var(ddof=1)
    assert mixing_weight(equal, zeroth, 1e6, 0.05)[0] == pytest.approx(v0 / (v0 + v1))


def test_nothing_but_a_number_of_the_user_s_lets_a_step_s_first_order_in():
    """The Heaviside's first-order gradient is always 0; with few samples alpha is 0 by default."""
    w = 0.1 * np.random.default_rng(0).standard_normal(64)
    zeroth = ((w > 0) - 0.5) * w / 0.01
    assert mixing_weight(np.zeros((64, 1)), zeroth[:, None], AoBG().gamma, AoBG().delta)[0] == 0


@pytest.mark.parametrize("done", [None, 0.4])
def test_total_propagation_by_hand(done):
    """Two backward steps of five particles are written out term by term, also with an early end."""
    sigma, n, discount = 0.1, 5, 0.9
    algorithm = TotalPropagation(samples=n, unroll=2, sigma=sigma, **PLAIN)
    e = experiment(algorithm, task=scalar(horizon=5, done=done), discount=discount)
    state = {**algorithm.begin(e), **SEEN, "theta": THETA}
    noise = e.rng(4, "states").standard_normal((2, n, 1))[..., 0]
    after, row = algorithm.iterate(e, state, 4)
    x = np.stack([state["starts.x"][:, 0], np.zeros(n), np.zeros(n)])
    alive, o, u, r = np.ones((3, n), dtype=bool), *np.zeros((3, 2, n))
    for t in range(2):
        o[t] = (x[t] - MEAN) / SCALE
        u[t] = 2 * np.tanh(THETA[0] * o[t] + THETA[1])
        x[t + 1] = np.where(alive[t], A * x[t] + B * u[t] + sigma * noise[t], x[t])
        r[t] = np.where(alive[t], discount**t * (-((x[t + 1] - 1) ** 2) - 0.1 * u[t] ** 2), 0)
        alive[t + 1] = alive[t] & ~(x[t + 1] > done if done else np.zeros(n, bool))
    if done:
        assert 0 < alive[1].sum() < n, "one ends early"
    squash = 2 * (1 - (u / 2) ** 2)
    features = np.stack([o, np.ones((2, n))], axis=-1)
    togo, g, total, shares = np.zeros(n), np.zeros(n), np.zeros((n, 2)), []
    for t in (1, 0):
        on = alive[t]
        togo = togo + r[t]
        base = np.array([togo[on & (np.arange(n) != i)].mean() for i in range(n)])
        way_L = np.where(on, (togo - base) * noise[t] / sigma, 0)
        way_R = np.where(on, -2 * discount**t * (x[t + 1] - 1) + g, 0)
        by_theta = [(w * B * squash[t])[:, None] * features[t] for w in (way_L, way_R)]
        v_L, v_R = (each.var(axis=0, ddof=1).sum() for each in by_theta)
        k = 1 / (1 + v_L / v_R)
        shares.append(k)
        mixed = k * way_L + (1 - k) * way_R
        by_u = np.where(on, mixed * B - 0.2 * discount**t * u[t], 0)
        total += (by_u * squash[t])[:, None] * features[t]
        g = np.where(on, mixed * A + by_u * squash[t] * THETA[0] / SCALE, 0)
    assert after["theta"] == pytest.approx(THETA + total.mean(axis=0), rel=1e-10)
    assert row["likelihood_ratio_share"] == pytest.approx(np.mean(shares), rel=1e-10)
    assert row["return_mean"] == pytest.approx(r.sum(axis=0).mean(), rel=1e-12)
    assert e.take_step_count() == alive[:2].sum()


def test_total_propagation_is_first_order_where_the_likelihood_ratio_is_noise():
    """With little noise on the states the likelihood ratio's share vanishes, and complex steps agree."""
    algorithm = TotalPropagation(samples=4, unroll=3, sigma=1e-9, **PLAIN)
    e = experiment(algorithm, task=scalar(horizon=9))
    state = {**algorithm.begin(e), **SEEN, "theta": THETA}
    after, row = algorithm.iterate(e, state, 0)
    first = [slope(x, THETA, np.zeros(3)) for x in state["starts.x"][:, 0]]
    assert row["likelihood_ratio_share"] < 1e-12
    assert after["theta"] - THETA == pytest.approx(np.mean(first, axis=0), rel=1e-6)


@pytest.mark.costly_cases("hidden1")
@pytest.mark.parametrize("hidden", [None, (3, 2)])
def test_total_propagation_through_layers(hidden):
    """With little noise it equals the first-order gradient, for any policy."""
    changes = []
    for algorithm in (
        TotalPropagation(samples=4, unroll=3, sigma=1e-9, **PLAIN),
        FOPG(samples=4, unroll=3, sigma=1e-9, **PLAIN),
    ):
        e = experiment(algorithm, task=scalar(horizon=3), hidden=hidden, initial=1.0)
        state = {**algorithm.begin(e), **SEEN}
        changes.append(algorithm.iterate(e, state, 0)[0]["theta"] - state["theta"])
    assert changes[0] == pytest.approx(changes[1], rel=1e-5, abs=1e-9)


def test_long_gradients_are_cut_to_the_median_length():
    gradients = np.array([[3.0, 4.0], [0.0, 1.0], [0.0, -20.0]])
    cut = FOPG(clip=2.0).clip_gradients(gradients)
    assert cut == pytest.approx(np.array([[3.0, 4.0], [0.0, 1.0], [0.0, -10.0]]))
    assert FOPG().clip_gradients(gradients) is gradients
    assert FOPG(clip=1.0).clip_gradients(0 * gradients) == pytest.approx(np.zeros((3, 2)))


@pytest.mark.parametrize("algorithm", [FOPG, ZOPG, TotalPropagation])
def test_a_step_goes_along_the_plain_mean_unless_samples_are_cut(algorithm):
    """Without ``clip`` the step is the mean gradient; with it the step is different."""
    e = experiment(algorithm(samples=64, unroll=3, rate=1.0, optimiser="plain"))
    state = {**e.algorithm.begin(e), **SEEN, "theta": THETA}
    cut = algorithm(samples=64, unroll=3, rate=1.0, optimiser="plain", clip=1.0)
    steps, rows = zip(*(one.iterate(e, state, 0) for one in (e.algorithm, cut)), strict=True)
    plain, shorter = (step["theta"] - THETA for step in steps)
    for step, row in zip((plain, shorter), rows, strict=True):
        assert np.linalg.norm(step) == pytest.approx(row["gradient_norm"], rel=1e-12)
    assert rows[1]["gradient_variance"] < rows[0]["gradient_variance"]
    assert np.abs(plain - shorter).max() > 1e-3


def test_alpha_order_gradients_have_no_clip():
    with pytest.raises(TypeError, match="clip"):
        AoBG(clip=1.0)  # pyright: ignore[reportCallIssue]


def test_rules_of_ascent():
    state = {"theta": np.array([1.0, 2.0])}
    g = np.array([0.5, -2.0])
    assert ascend("plain", state, g, 0.1)["theta"] == pytest.approx([1.05, 1.8])
    assert ascend("normalised", state, g, 0.1)["theta"] == pytest.approx([1.025, 1.9])
    assert ascend("normalised", state, 1e3 * g, 0.1)["theta"] == pytest.approx([1.0, 2.0])
    assert ascend("normalised", state, 0 * g, 0.1)["theta"] == pytest.approx([1.0, 2.0])
    once = ascend("adam", state, g, 0.1)
    assert once["theta"] == pytest.approx([1.1, 1.9], abs=1e-7)
    twice = ascend("adam", once, -g, 0.1)
    m, v = (0.9 * 0.1 - 0.1) * g, (0.999 * 0.001 + 0.001) * g**2
    step = m / (1 - 0.81) / (np.sqrt(v / (1 - 0.999**2)) + 1e-8)
    assert twice["theta"] == pytest.approx(once["theta"] + 0.1 * step, rel=1e-12)
