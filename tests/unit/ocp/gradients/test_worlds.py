"""Verdicts on worlds whose maps are formulas, and measures against formulas."""

from __future__ import annotations

import numpy as np
import pytest

from dynamics.batch import Gaussian
from ocp.gradients.estimators import SAMPLED
from ocp.gradients.sampling import quadrature, run_estimator
from ocp.gradients.worlds import Question, ReportSettings, World
from ocp.gradients.worlds.measures import measure_secants, rounding_noise
from ocp.gradients.worlds.world import WorldObjective
from ocp.jobs.gradients import measure_worlds

NOMINAL = np.array([1.0003])
TOOTH = 1e-3
SINE = World("sine", np.sin, lambda theta: np.cos(theta)[:, :, None])


def saw(rise: float) -> World:
    """Return the sine plus a sawtooth of period TOOTH whose teeth rise at the slope ``rise``."""
    return World(
        "saw",
        lambda theta: np.sin(theta) + rise * (theta % TOOTH),
        lambda theta: (np.cos(theta) + rise)[:, :, None],
    )


STAIRS = World(
    "stairs",
    lambda theta: np.sin(TOOTH * np.floor(theta / TOOTH)),
    lambda theta: np.zeros((*theta.shape, 1)),
)
DOUBLED = World("doubled", np.sin, lambda theta: 2 * np.cos(theta)[:, :, None])
ROUGH = World("rough", lambda theta: np.sin(theta) + 0.1 * np.sin(1e13 * theta))
STEP = World("step", lambda theta: np.sin(theta) + (theta > 1.02), lambda theta: np.cos(theta)[:, :, None])
NAN = World("nan", np.sin, lambda theta: np.full((*theta.shape, 1), np.nan))
# A ripple that the amplitudes of differences do not see, and samples of sigma 0.1 do.
FAR_KINK = World(
    "kink",
    lambda theta: np.sin(theta) + (theta > 1.15),
    lambda theta: np.cos(theta)[:, :, None],
)
FINE = {"h": 0.01}
RIPPLE = World(
    "ripple",
    lambda theta, h: np.sin(theta) + h**2 * np.sin(theta / h**3),
    lambda theta, h: (np.cos(theta) + np.cos(theta / h**3) / h)[:, :, None],
    FINE,
    {"h": 0.5},
)
SOFT = World(
    "soft",
    lambda theta, h: np.sin(theta) * (1 + 20 * h),
    lambda theta, h: (np.cos(theta) * (1 + 20 * h))[:, :, None],
    FINE,
    {"h": 0.5},
)
VERDICTS = {
    "right": (SINE, SINE),
    "of-the-discrete-map": (saw(3.0), SINE),
    "wrong-sign": (saw(-3.0), SINE),
    "zero": (STAIRS, SINE),
    "exploding": (RIPPLE, SINE),
    "undefined": (SINE, STEP),
    "noise": (ROUGH, SINE),
    "not-the-derivative": (DOUBLED, SINE),
    "not-finite": (NAN, SINE),
    "biased-at-sigma": (FAR_KINK, FAR_KINK),
    "consistent": (SINE, None),
    "differs-from-secant": (saw(3.0), None),
}


def judged(world: World, truth: World | None, **settings):
    question = Question(NOMINAL, 1.0, truth)
    (row,) = measure_worlds([world], question, ReportSettings(**settings)).rows
    return row


@pytest.mark.one_case_in(2)
@pytest.mark.parametrize("verdict", VERDICTS)
def test_each_verdict(verdict: str) -> None:
    world, truth = VERDICTS[verdict]
    row = judged(world, truth, samples=4000)
    assert row["verdict"] == verdict, row["sentence"]
    if verdict not in ("right", "consistent"):
        assert row["findings"][-1]["code"].startswith("use-")


@pytest.mark.parametrize("has_gradient", [True, False])
@pytest.mark.parametrize("truth_known", [True, False])
def test_the_zero_slope_of_a_constant_is_right_and_no_other(has_gradient: bool, truth_known: bool) -> None:
    def slope(value: float):
        return (lambda theta: np.full((*theta.shape, 1), value)) if has_gradient else None

    flat = World("flat", lambda theta: 0 * theta + 5, slope(0.0))
    truth = flat if truth_known else None
    assert judged(flat, truth, samples=100)["verdict"] == ("right" if truth_known else "consistent")
    if has_gradient:
        assert judged(World("tilted", flat.simulate, slope(0.1)), truth, samples=100)["verdict"] == "not-the-derivative"


def test_a_jump_at_the_nominal_parameter_is_no_noise() -> None:
    jump = World("jump", lambda theta: np.sin(theta) + (theta > NOMINAL))
    for truth in (jump, None):
        row = judged(jump, truth, samples=100)
        assert row["verdict"] == "undefined", row["sentence"]
        assert row["findings"][0]["numbers"]["size"] == pytest.approx(1, abs=1e-3) if truth else True


def test_a_jump_out_of_reach_and_one_that_only_zeroth_order_samples_are_no_fault_of_the_slope() -> None:
    jump = World("jump", lambda theta: np.sin(theta) + (theta > 3), lambda theta: np.cos(theta)[:, :, None])
    assert judged(jump, jump)["verdict"] == "right"
    assert judged(World("kink", FAR_KINK.simulate), FAR_KINK)["verdict"] == "right"


def test_an_error_that_vanishes_with_the_step_is_told_from_one_that_does_not() -> None:
    soft = judged(SOFT, SINE)
    errors = [each["error"] for each in soft["refinements"]]
    np.testing.assert_allclose(np.divide(errors[1:], errors[:-1]), 0.5, rtol=1e-6)
    assert soft["findings"][1]["code"] == "use-finer"
    stubborn = World(
        "stubborn", lambda t, h: 1.2 * np.sin(t), lambda t, h: 1.2 * np.cos(t)[:, :, None], FINE, {"h": 0.5}
    )
    assert "does not lower the median error" in judged(stubborn, SINE)["sentence"]


def tent(theta: np.ndarray, steps: float) -> np.ndarray:
    """Return ``steps`` iterations of the map 1 - |1 - 2 y|: a triangle wave of 2^(steps - 1) periods."""
    return 1 - np.abs(1 - 2 * (2.0 ** (steps - 1) * theta % 1))


def tent_slopes(theta: np.ndarray, steps: float) -> np.ndarray:
    return (np.where(2.0 ** (steps - 1) * theta % 1 < 0.5, 1, -1) * 2.0**steps)[:, :, None]


def logistic(theta: np.ndarray, steps: float) -> np.ndarray:
    """Return ``steps`` iterations of 4 y (1 - y), as sin^2(2^steps asin(sqrt(theta)))."""
    return np.sin(2.0**steps * np.arcsin(np.sqrt(theta))) ** 2


def logistic_slopes(theta: np.ndarray, steps: float) -> np.ndarray:
    angle = 2.0**steps * np.arcsin(np.sqrt(theta))
    return (2.0**steps * np.sin(2 * angle) / (2 * np.sqrt(theta * (1 - theta))))[:, :, None]


CHAOS = {
    "tent": World("tent", tent, tent_slopes, {"steps": 6.0}, longer={"steps": 2.0}),
    "logistic": World("logistic", logistic, logistic_slopes, {"steps": 8.0}, longer={"steps": 2.0}),
}


@pytest.mark.parametrize("name", CHAOS)
def test_slopes_of_chaotic_maps_explode_at_the_rate_of_their_lyapunov_exponent(name: str) -> None:
    """Both maps stretch by 2 per step, so that slopes grow as 2^steps; neither has a step size to refine."""
    question = Question(np.array([0.3003]), 1.0)
    (row,) = measure_worlds([CHAOS[name]], question, ReportSettings(samples=100)).rows
    assert row["verdict"] == "exploding", row["sentence"]
    sizes, steps = ([each[key] for each in row["horizons"]] for key in ("typical", "settings"))
    rates = np.diff(np.log(sizes)) / np.diff([each["steps"] for each in steps])
    np.testing.assert_allclose(rates, np.log(2), rtol=1e-9 if name == "tent" else 0.2)
    assert ("exp(0.693 steps)" in row["sentence"]) == (name == "tent")


def power(exponent: float) -> World:
    """Return a sawtooth with the mean slope 1 whose teeth rise at the slope steps^exponent."""
    rise = lambda steps: steps**exponent - 1  # noqa: E731
    return World(
        "power",
        lambda theta, steps: theta + rise(steps) * (theta % TOOTH),
        lambda theta, steps: np.full((*theta.shape, 1), 1 + rise(steps)),
        {"steps": 6.0},
        longer={"steps": 2.0},
    )


def test_powers_of_the_horizon_and_the_right_slope_of_an_unstable_map_are_not_exploding() -> None:
    """The slope a^n of the linear map is exact, for it is that of all secants."""
    assert judged(power(3.0), SINE)["verdict"] == "of-the-discrete-map"
    linear = World(
        "linear",
        lambda theta, steps: 1.5**steps * theta,
        lambda theta, steps: np.full((*theta.shape, 1), 1.5**steps),
        {"steps": 6.0},
        longer={"steps": 2.0},
    )
    assert judged(linear, linear.at({}), samples=100)["verdict"] == "right"
    assert judged(linear, None, samples=100)["verdict"] == "consistent"


def test_at_a_kink_slopes_of_both_sides_are_right_and_no_others() -> None:
    """The slopes of max(-t, 2 t) at 0 are -1 and 2; simulators may return either, or one between."""
    offset = lambda t: t - NOMINAL  # noqa: E731
    kink = lambda t: np.maximum(-offset(t), 2 * offset(t))  # noqa: E731

    def slopes(at_kink: float):
        return lambda t: np.where(offset(t) == 0, at_kink, np.where(offset(t) > 0, 2.0, -1.0))[:, :, None]

    truth = World("kink", kink, slopes(2.0))
    for at_kink in (-1.0, 2.0):
        row = judged(World("one-sided", kink, slopes(at_kink)), truth, samples=100)
        assert row["verdict"] == "right" and row["findings"][1]["code"] == "truth-has-a-kink"
        assert row["findings"][1]["numbers"] == pytest.approx({"low": -1.0, "high": 2.0})
    assert judged(World("between", kink), truth, samples=100)["verdict"] == "right"
    steep = World("steep", lambda t: 1.5 * kink(t), lambda t: 1.5 * slopes(2.0)(t))
    assert judged(steep, truth, samples=100)["verdict"] == "of-the-discrete-map"
    reversed_kink = World("reversed", lambda t: -kink(t), lambda t: -slopes(2.0)(t))
    assert judged(reversed_kink, truth, samples=100)["verdict"] == "of-the-discrete-map"


def test_at_an_optimum_slopes_are_compared_with_those_in_reach() -> None:
    """The slope of 1 - cos at 0 is rounding error or zero, and up to a/2 over the secants in reach."""
    valley = World("valley", lambda t: 1 - np.cos(t - NOMINAL), lambda t: np.sin(t - NOMINAL)[:, :, None])
    beside = World("beside", lambda t: 1 - np.cos(t - 1.0), lambda t: np.sin(t - 1.0)[:, :, None])
    shifted = World("shifted", lambda t: 1 - np.cos(t - 0.95), lambda t: np.sin(t - 0.95)[:, :, None])
    assert judged(valley, valley)["verdict"] == judged(beside, valley)["verdict"] == "right"
    assert judged(valley, None)["verdict"] == "consistent"
    row = judged(shifted, valley)
    assert row["verdict"] == "of-the-discrete-map" and f"off by {np.sin(NOMINAL[0] - 0.95):.3g}" in row["sentence"]


def test_the_amplitude_from_which_secants_are_right_is_that_of_the_sawtooth() -> None:
    """A secant over a is off by at most 3 TOOTH/(2 a), so that it is within 5 % from a few dozen teeth on."""
    advice = judged(saw(3.0), SINE)["findings"][1]
    assert advice["code"] == "use-secant"
    low, high = advice["numbers"]["low"], advice["numbers"]["high"]
    assert 3 * TOOTH / 2 < low < 3 * TOOTH / (2 * 0.05 * np.cos(NOMINAL[0])) * 2.2 and high == pytest.approx(0.1)


def test_rounding_noise_is_that_which_was_added() -> None:
    for deviation in (1e-3, 1e-7):
        world = World("noisy", lambda t, s=deviation: np.sin(t) + s * np.sqrt(2) * np.sin(1e14 * t))
        measured = rounding_noise(WorldObjective(world, NOMINAL), 1.0)
        assert deviation / 4 < measured < 4 * deviation
    assert rounding_noise(WorldObjective(SINE, NOMINAL), 1.0) < 1e-15


def test_secants_are_the_formula_within_their_errors() -> None:
    secants = measure_secants(WorldObjective(SINE, NOMINAL), 1.0)
    exact = np.cos(NOMINAL[0]) * np.sin(secants.amplitudes) / secants.amplitudes
    assert (np.abs(secants.slopes - exact) <= 2 * secants.errors).all()
    np.testing.assert_allclose(secants.slopes, (secants.ahead + secants.behind) / 2, rtol=1e-6)


@pytest.mark.costly
@pytest.mark.parametrize("estimator", ["zobg-antithetic", "fobg"])
def test_intervals_of_smoothed_gradients_cover_the_truth(estimator: str) -> None:
    """Intervals of 95 % contain the quadrature in 200 seeds as a binomial of 0.95 says, within 3 deviations."""
    objective = WorldObjective(World("x", lambda t: np.sin(3 * t), lambda t: 3 * np.cos(3 * t)[:, :, None]), NOMINAL)
    truth = quadrature(objective, 0.1).gradient[0]
    np.testing.assert_allclose(truth, 3 * np.cos(3 * NOMINAL[0]) * np.exp(-0.5 * 0.3**2), rtol=1e-6)
    covered = 0
    for seed in range(200):
        moments = run_estimator(objective, SAMPLED[estimator], Gaussian(0.1, seed), 2000).moments
        covered += abs(moments.mean[0] - truth) <= 1.96 * moments.standard_error[0]
    assert abs(covered - 190) <= 3 * np.sqrt(200 * 0.95 * 0.05)


def test_an_uncertain_estimate_says_how_many_samples_it_needs() -> None:
    """The standard error falls with the square root of the samples, so that the number that is said suffices."""
    wide = World("wide stairs", lambda theta: np.sin(0.1 * np.floor(theta / 0.1)), STAIRS.differentiate)
    few = judged(wide, SINE, samples=200)["findings"][1]
    assert few["code"] == "use-more-samples" and few["numbers"]["sigma"] == 0.1
    assert judged(wide, SINE, samples=4 * few["numbers"]["count"])["findings"][1]["code"] == "use-smoothed"
