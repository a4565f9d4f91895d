"""Descriptions of contact laws, and their messages on bad settings."""

from __future__ import annotations

import math

import casadi as ca
import numpy as np
import pytest

import problems
from dynamics.contact import Adaptive, Barrier, Exact, Randomized
from dynamics.contact.law import law_parameter
from dynamics.laws import LAWS


@pytest.mark.parametrize(
    ("make", "sentence"),
    [
        (lambda: Barrier(mu=0), r"barrier: mu must be a number > 0 \[N s m\], got 0; for mu = 0 use the exact law"),
        (lambda: Barrier(mu=-1), r"barrier: mu must be a number > 0 \[N s m\], got -1"),
        (lambda: Barrier(mu=math.nan), "got nan"),
        (lambda: Barrier(kappa=math.inf), r"barrier: kappa must be a finite number > 0 \[1/J\], got inf"),
        (lambda: Barrier(mu=1, kappa=1), "give mu or kappa, not both"),
        (lambda: Adaptive(sigma=-0.1), r"adaptive: sigma must be a number > 0 \[m\], got -0.1"),
        (lambda: Adaptive(sigma=0), "adaptive: sigma must be a number > 0"),
        (lambda: Adaptive(law="cubic"), "law must be 'gaussian' or 'quartic' or .*, got 'cubic'"),
        (lambda: Adaptive(mu_max=0.1), "mu_max does not belong to law 'gaussian'; it takes sigma"),
        (lambda: Adaptive(law="quartic", sigma=1), "it takes mu_max, scale, power"),
        (lambda: Adaptive(law="quartic", power=0), "adaptive: power must be a number > 0, got 0"),
        (lambda: Adaptive(gradient="partial"), "gradient must be 'total' or 'frozen'"),
        (lambda: Randomized(sigma=-1), r"randomized: sigma must be a number > 0 \[SI\], got -1"),
        (lambda: Randomized(samples=3), "samples must be even, got 3"),
        (lambda: Randomized(samples=1), "samples must be a whole number >= 2 and <= 4096, got 1"),
        (lambda: Randomized(samples=2.5), "whole number"),  # pyright: ignore[reportArgumentType]
        (lambda: Randomized(samples=math.nan), "whole number"),  # pyright: ignore[reportArgumentType]
        (lambda: Randomized(seed=-1), "seed must be a whole number >= 0"),
        (lambda: Randomized(scheme="halton"), "scheme must be 'sobol' or 'monte-carlo' or"),
        (lambda: Randomized(noise="contact"), "noise must be 'input' or 'state'"),
        (lambda: Randomized(base=Randomized()), "base law must not be randomized"),
    ],
)
def test_bad_settings_get_their_sentence(make, sentence):
    with pytest.raises(ValueError, match=sentence) as raised:
        make()
    assert "\n" not in str(raised.value)


@pytest.mark.parametrize("value", [0.0, -1.0, math.nan, math.inf])
def test_a_laws_own_parameter_is_positive_and_finite(value):
    with pytest.raises(ValueError, match="contact: rigidity must be positive and finite, got"):
        law_parameter("rigidity", value, "N/m", "of a user's law")
    assert law_parameter("rigidity", 2.5, "N/m", "of a user's law").value == 2.5


def test_laws_that_a_system_cannot_take_say_why():
    cart, wall = problems.get("cart-walls").system, problems.get("wall-1d").system
    with pytest.raises(ValueError, match=r"no log-barrier energy that converts kappa; give mu"):
        Barrier(kappa=10).close(cart)
    with pytest.raises(ValueError, match="the base law has a sigma of its own"):
        Randomized(base=Adaptive()).close(wall)
    with pytest.raises(ValueError, match=r"81 nodes|more than 4096; use scheme=sobol"):
        Randomized(scheme="gauss-hermite", samples=9, noise="state").close(cart)


@pytest.mark.parametrize(
    ("name", "factor"), [("wall-1d", 0.1), ("ball-bounce", 0.05), ("push-1d", 1), ("push-disc", 1)]
)
def test_kappa_converts_as_the_models_energy_says(name, factor):
    # gap in position: mu = h / kappa; quasi-dynamics: mu = 1 / kappa
    problem = problems.get(name)
    p = problem.parameters.values
    x, u = problem.initial_states(p)[0], np.zeros(problem.system.nu)
    by_kappa = Barrier(kappa=50).close(problem.system)
    by_mu = Barrier(mu=factor / 50).close(problem.system)
    mus = [float(step.data(x, u, step.p.values)[4]) for step in (by_kappa, by_mu)]
    assert mus == pytest.approx([factor / 50] * 2, rel=1e-14)


@pytest.mark.parametrize("law", [Exact, Barrier, Adaptive, Randomized])
def test_laws_describe_themselves(law):
    chosen = law()
    assert LAWS[chosen.name] is law
    assert chosen.summary
    system = problems.get("wall-1d").system
    parameters = chosen.parameters(system)
    assert all(name.startswith("contact.") for name in parameters.names)
    assert np.all(parameters.values > 0)
    schedule = chosen.schedule(1.0, 0.1)
    assert schedule is None or schedule.parameter in parameters
    again = chosen.at()
    assert again.settings() == chosen.settings()


@pytest.mark.parametrize(
    ("law", "parameter", "value"),
    [
        (Barrier(mu=1e-3), "mu", 1e-5),
        (Barrier(kappa=100), "kappa", 1e4),
        (Adaptive(sigma=0.1), "sigma", 0.01),
        (Adaptive(law="quartic"), "mu_max", 1e-4),
        (Randomized(sigma=0.1, samples=8, seed=3), "sigma", 0.01),
    ],
)
def test_a_law_at_another_parameter(law, parameter, value):
    moved = law.at(**{parameter: value})
    assert type(moved) is type(law)
    assert moved.settings() == {**law.settings(), parameter: value}
    # the parameter is a symbol: the step built once gives the same with the other value
    system = problems.get("wall-1d").system
    step, other = law.close(system), moved.close(system)
    assert other.p.names == step.p.names
    x, u = [0.05, -0.5], [0.1]  # z = 0.01: noise of either size reaches the wall
    here = step.map(x, u, other.p.values)[0]
    assert np.allclose(np.array(here), np.array(other.map(x, u, other.p.values)[0]), atol=1e-15)
    assert np.max(np.abs(np.array(here - step.map(x, u, step.p.values)[0]))) > 1e-9


def test_the_quartic_law_measures_the_nearest_inactive_contact():
    system = problems.get("cart-walls").system
    law = Adaptive(law="quartic")
    z, F = ca.SX.sym("z", 2), ca.SX.sym("F", 2, 2)
    parameters = law.parameters(system)
    mu = ca.Function("mu", [z, F, parameters.vector], [law.target(system, z, F, parameters)])

    def at(*gaps: float) -> np.ndarray:
        return np.array(mu(list(gaps), np.eye(2), parameters.values)).ravel()

    def quartic(d: float) -> float:
        return 1e-2 * (100 * d**2 + 1) ** -4

    assert np.allclose(at(0.1, 0.4), quartic(0.1), rtol=1e-12)
    assert np.allclose(at(0.4, 0.1), quartic(0.1), rtol=1e-12)
    # an impulse above 1 N s makes the first contact active: the other one counts
    assert np.allclose(at(-5.0, 0.4), quartic(0.4), rtol=1e-12)
    assert np.allclose(at(-5.0, -5.0), 1e-10, rtol=1e-12)
    own = Adaptive(law="quartic-per-contact")
    target = own.target(system, z, F, parameters)
    per_contact = ca.Function("mu", [z, F, parameters.vector], [target])
    got = np.array(per_contact([0.1, 0.4], np.eye(2), parameters.values)).ravel()
    assert np.allclose(got, [quartic(0.1), quartic(0.4)], rtol=1e-12)


def test_the_exact_law_has_no_parameters_and_says_so():
    law = Exact()
    assert law.exact
    assert len(law.parameters(problems.get("wall-1d").system)) == 0
    assert not Barrier().exact
    assert Randomized().exact
    assert not Randomized(base=Barrier()).exact
