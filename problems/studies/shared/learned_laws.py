"""Transitions of a problem at its default parameters, and contact laws learned from them."""

from __future__ import annotations

from dynamics.learned.collecting import collect_transitions
from dynamics.learned.ewda import EwdaModel
from dynamics.learned.laws import Ewda, Mlp
from dynamics.learned.training import Recipe, train_network
from dynamics.learned.transitions import Transitions
from problems.regions import region_of
from problems.registry import spec


def draw_transitions(name: str, n: int, seed: int) -> Transitions:
    """Draw n exact transitions of the problem ``name`` at its default parameters, from its region."""
    problem_spec = spec(name)
    problem = problem_spec.problem()
    return collect_transitions(problem.exact_step, region_of(problem_spec, problem_spec.params({}), problem), n, seed)


def average_law(data: Transitions, sigma: float, seed: int, trust: float = 0.0) -> Ewda:
    """Return the law of the distance-weighted average g_sigma, with sigma in standard deviations of the data."""
    model = EwdaModel(data.z, data.x_next, data.normalisation, sigma, data.origin, seed)
    return Ewda(model, trust)


def network_law(data: Transitions, sigma: float, seed: int, epochs: int, batch: int = Recipe.batch) -> Mlp:
    """Train a network on inputs with noise sigma (0 for no noise), and return the law of its best epoch."""
    model = train_network(data.samples(), sigma, seed, epochs=epochs, patience=epochs, batch=batch)
    return Mlp(model)
