"""P3: Coulomb friction relaxed within a slip tolerance, and its empirical bias."""

from __future__ import annotations

import numpy as np
import xarray as xr

from dynamics.batch import Gaussian
from ocp.gradients import SampledObjective, estimate_gradient
from ocp.gradients.estimators import SAMPLED
from problems.objectives import objective_spec
from problems.studies.study import CODE, StudyParams, quantity_of, setting

ORDERS = ("zobg", "fobg")
BATCHES = (1, 3, 10, 30, 100, 300, 1000)
_RATIOS = np.geomspace(1e-4, 10, 21)
"""nu/sigma at which theta = nu/2 is looked at; the text says it of small ones."""


class Params(StudyParams):
    """Parameters of P3; values of the authors' code, fewer tolerances."""

    sigma: float = setting(0.1, "m/s", "standard deviation of the noise", CODE, above=0)
    theta: float = setting(0.1, "m/s", "decision of the panel over samples", CODE)
    nu: float = setting(0.005, "m/s", "slip tolerance of the panel over samples", CODE, above=0)
    n_samples: int = setting(1000, "1", "samples", CODE, least=2)
    tolerances: int = setting(81, "1", "slip tolerances from 1e-4 to 1 sigma", least=20)
    many: int = setting(400_000, "1", "samples of the expected variance", least=1000)


def run(params: Params) -> xr.Dataset:
    """Estimates over sample count, variances over tolerance, and the block on a belt behind it."""
    nus = params.sigma * np.geomspace(1e-4, 1, params.tolerances)
    coarse = nus[:: max(1, params.tolerances // 8)]
    widths = _stick_width() * np.geomspace(1e-3, 10, 9)
    coulomb = objective_spec("coulomb").objective({"theta": 0.0})
    block = objective_spec("belt-block").objective()
    here = objective_spec("coulomb").objective({"theta": params.theta, "nu": params.nu})
    running = np.stack([_running_mean(here, name, params) for name in ORDERS])
    at = [coulomb.at({"nu": nu}) for nu in nus]
    few = [_variances(o, i, params.n_samples, params) for i, o in enumerate(at)]
    forms = [objective.closed_form(params.sigma) for objective in at]
    wide, behind = (
        [_variances(o.at({"nu": nu}), 1000 + i, params.many, params) for i, nu in enumerate(grid)]
        for o, grid in ((coulomb, coarse), (block, widths))
    )
    slip = np.linspace(-1, 1, 401)
    half, silent = _at_half(coulomb, params), _silent(here, params)
    known = here.closed_form(params.sigma)
    assert known is not None
    unit = "s/m"
    return xr.Dataset(
        {
            "friction": quantity_of(("width", "slip"),
                [coulomb.at({"nu": nu}).costs(slip[:, None]) for nu in (1e-3, 0.2)], "1",
                "friction over its limit"),
            "block_impulse": quantity_of(("width", "slip"),
                [block.at({"nu": nu}).costs(slip[:, None]) for nu in (1e-3, 0.2)], "1",
                "impulse on the block over its limit"),
            "running_mean": quantity_of(("order", "n"), running, unit, "estimate of n samples"),
            "truth": quantity_of((), known.gradient[0], unit, "gradient at theta"),
            "silent": quantity_of("batch", silent, "1",
                                  "share of batches whose first-order samples are all zero"),
            "chance": quantity_of("nu", [c.gradient[0] * nu / 2 for c, nu in zip(forms, nus,
                                  strict=True) if c], "1", "of a first-order sample not zero"),
            "half_gradient": quantity_of("ratio", half[:, 0], unit, "gradient at theta = nu/2"),
            "half_chance": quantity_of("ratio", half[:, 1], "1", "of a sample not zero there"),
            "half_share": quantity_of("ratio", half[:, 2], "1", "of samples not zero there"),
            "half_spread": quantity_of("ratio", half[:, 3], unit,
                                       "largest sample there with theta + w outside the tolerance"),
            "stick": quantity_of((), _stick_width(), "m/s",
                                 "2 N h F/m, below which the block's mass limits the slope"),
            "variance": quantity_of(("order", "nu"), np.transpose(few), "s^2/m^2",
                                    "empirical variance of one sample"),
            "zobg_variance": quantity_of("nu", [c.zobg_variance[0] for c in forms if c],
                                         "s^2/m^2", "of one sample, closed form"),
            "fobg_variance": quantity_of("nu", [c.fobg_variance[0] for c in forms if c],
                                         "s^2/m^2", "of one sample, closed form"),
            "wide_variance": quantity_of(("order", "coarse"), np.transpose(wide), "s^2/m^2",
                                         "empirical variance of one sample, many samples"),
            "block_variance": quantity_of(("order", "block_nu"), np.transpose(behind), "s^2/m^2",
                                          "the same of the block on a belt"),
        },
        {
            "order": list(ORDERS),
            "width": quantity_of("width", (1e-3, 0.2), "m/s", "slip tolerance"),
            "slip": quantity_of("slip", slip, "m/s", "sliding velocity"),
            "n": quantity_of("n", np.arange(1, params.n_samples + 1), "1", "samples"),
            "nu": quantity_of("nu", nus, "m/s", "slip tolerance"),
            "coarse": quantity_of("coarse", coarse, "m/s", "slip tolerance"),
            "block_nu": quantity_of("block_nu", widths, "m/s", "slip tolerance under the block"),
            "batch": quantity_of("batch", BATCHES, "1", "samples of one batch"),
            "ratio": quantity_of("ratio", _RATIOS, "1", "nu/sigma"),
        },
    )  # fmt: skip


def _at_half(coulomb: SampledObjective, params: Params) -> np.ndarray:
    """At theta = nu/2, (len(_RATIOS), 4): F', the chance p of a sample not zero, its share of

    ``many`` samples, and the largest sample where theta + w is outside the tolerance.
    """
    rows = []
    for index, nu in enumerate(params.sigma * _RATIOS):
        here = coulomb.at({"theta": nu / 2, "nu": nu})
        known = here.closed_form(params.sigma)
        assert known is not None
        seed = np.random.SeedSequence(params.seed, spawn_key=(2000 + index,))
        noise = Gaussian(params.sigma, seed)
        samples = here.differentiated(noise, params.many).direction[:, 0]
        outside = np.abs(nu / 2 + noise.draw(params.many, 1, 1)[:, 0, 0]) > nu / 2
        gradient = known.gradient[0]
        rows.append((gradient, gradient * nu / 2, np.mean(samples != 0),
                     np.abs(samples[outside]).max(initial=0)))  # fmt: skip
    return np.array(rows)


def _silent(objective: SampledObjective, params: Params) -> np.ndarray:
    """Share of batches of first-order samples that are all zero, (len(BATCHES),)."""
    seed = np.random.SeedSequence(params.seed, spawn_key=(3000,))
    samples = objective.differentiated(Gaussian(params.sigma, seed), params.many).direction[:, 0]
    return np.array([
        np.mean(~np.any(samples[: len(samples) // size * size].reshape(-1, size), axis=1))
        for size in BATCHES
    ])  # fmt: skip


def _stick_width() -> float:
    block = objective_spec("belt-block").params({})
    return 2 * block.N * block.h * block.friction_force / block.m


def _running_mean(objective: SampledObjective, name: str, params: Params) -> np.ndarray:
    estimator = SAMPLED[name]
    noise = Gaussian(
        params.sigma, np.random.SeedSequence(params.seed, spawn_key=(estimator.stream,))
    )
    samples = estimator.sampler(objective, noise, params.n_samples)(noise, params.n_samples)
    return np.cumsum(samples[:, 0]) / np.arange(1, params.n_samples + 1)


def _variances(objective: SampledObjective, key: int, n: int, params: Params) -> list[float]:
    seed = np.random.SeedSequence(params.seed, spawn_key=(key,))
    found = estimate_gradient(objective, ORDERS, n, params.sigma, seed, reference="none")
    return [float(found[name].variance[0]) for name in ORDERS]
