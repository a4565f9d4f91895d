"""P3: Coulomb friction relaxed within a slip tolerance, and its empirical bias."""

from __future__ import annotations

import numpy as np
import xarray as xr

from dynamics.batch import Gaussian
from ocp.studies import SampledObjective, estimate_gradient
from ocp.studies.estimators import SAMPLED
from problems.objectives import objective_spec
from problems.spec import Citation
from problems.studies.study import CHOICE, CODE, Claim, Study, StudyParams, quantity_of, setting

ORDERS = ("zobg", "fobg")
_PLACE = "Pathologies, "


class Params(StudyParams):
    """Parameters of P3; values of the authors' code, fewer tolerances."""

    sigma: float = setting(0.1, "m/s", "standard deviation of the noise", CODE, above=0)
    theta: float = setting(0.1, "m/s", "decision of the panel over samples", CODE)
    nu: float = setting(0.005, "m/s", "slip tolerance of the panel over samples", CODE, above=0)
    n_samples: int = setting(1000, "1", "samples", CODE, least=2)
    tolerances: int = setting(81, "1", "slip tolerances from 1e-5 to 1e-1 m/s", CHOICE, least=5)
    many: int = setting(400_000, "1", "samples of the expected variance", CHOICE, least=1000)


def run(params: Params) -> xr.Dataset:
    """Estimates over sample count, variances over tolerance, and the block on a belt behind it."""
    nus = np.geomspace(1e-5, 1e-1, params.tolerances)
    coarse = nus[:: max(1, params.tolerances // 8)]
    coulomb = objective_spec("coulomb").objective({"theta": 0.0})
    block = objective_spec("belt-block").objective()
    here = objective_spec("coulomb").objective({"theta": params.theta, "nu": params.nu})
    running = np.stack([_running_mean(here, name, params) for name in ORDERS])
    at = [coulomb.at({"nu": nu}) for nu in nus]
    few = [_variances(o, i, params.n_samples, params) for i, o in enumerate(at)]
    forms = [objective.reference(params.sigma) for objective in at]
    wide = [
        [_variances(o.at({"nu": nu}), 1000 + i, params.many, params) for i, nu in enumerate(coarse)]
        for o in (coulomb, block)
    ]
    slip = np.linspace(-1, 1, 401)
    known = here.reference(params.sigma)
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
            "variance": quantity_of(("order", "nu"), np.transpose(few), "s^2/m^2",
                                    "empirical variance of one sample"),
            "zobg_variance": quantity_of("nu", [c.zobg_variance[0] for c in forms if c],
                                         "s^2/m^2", "of one sample, closed form"),
            "fobg_variance": quantity_of("nu", [c.fobg_variance[0] for c in forms if c],
                                         "s^2/m^2", "of one sample, closed form"),
            "wide_variance": quantity_of(("system", "order", "coarse"),
                                         np.transpose(wide, (0, 2, 1)), "s^2/m^2",
                                         "empirical variance of one sample, many samples"),
        },
        {
            "order": list(ORDERS),
            "system": ["relaxation", "block"],
            "width": quantity_of("width", (1e-3, 0.2), "m/s", "slip tolerance"),
            "slip": quantity_of("slip", slip, "m/s", "sliding velocity"),
            "n": quantity_of("n", np.arange(1, params.n_samples + 1), "1", "samples"),
            "nu": quantity_of("nu", nus, "m/s", "slip tolerance"),
            "coarse": quantity_of("coarse", coarse, "m/s", "slip tolerance"),
        },
    )  # fmt: skip


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


def claims(data: xr.Dataset) -> list[Claim]:
    """What ex. III.5 and fig. 3 say."""
    sigma, n = data.attrs["sigma"], data.attrs["n_samples"]
    nu, coarse = data["nu"].values, data["coarse"].values
    first = data["variance"].sel(order="fobg").values
    zeroth = data["variance"].sel(order="zobg").values
    wide = data["wide_variance"].sel(system="relaxation", order="fobg").values
    told = (coarse >= 1e-4) & (coarse <= 1e-2)
    slope = float(np.polyfit(np.log(coarse[told]), np.log(wide[told]), 1)[0])
    c = 1 / (np.sqrt(2 * np.pi) * sigma)
    expected = 4 * c / coarse[told]
    ratio = wide[told] / expected
    empty = nu[first == 0]
    running = data["running_mean"].sel(order="fobg").values
    hit = int(np.argmax(running != 0)) + 1 if np.any(running != 0) else n + 1
    flat = zeroth.max() / zeroth.min()
    p = 2 * c * 1e-6 / 2  # P(|theta + w| <= nu/2) ~ c nu for small nu, at nu = 1e-6
    block = data["wide_variance"].sel(system="block", order="fobg").values
    stays = float(block[0] / block[coarse <= 1e-3].min())
    return [
        Claim("As nu falls the variance of the first order scales with 1/nu", _PLACE + "ex. III.5",
              "4 c/nu, c = 1/(sqrt(2 pi) sigma)", f"nu to the power {slope:.3f}, {ratio.min():.3f}"
              f" to {ratio.max():.3f} of 4 c/nu", bool(abs(slope + 1) < 0.05)),
        Claim("First-order values are zero where few samples are taken", _PLACE + "fig. 3",
              "0 until a sample falls within nu", f"0 up to sample {hit - 1}", hit > 1),
        Claim("At a fixed sample count the empirical variance falls to zero as nu does",
              _PLACE + "fig. 3", "empty on a log scale",
              f"{len(empty)} of {len(nu)} are exactly 0, all at nu <="
              f" {empty.max(initial=0):.2g} m/s", bool(len(empty) and empty.max() < 2e-3)),
        Claim("The variance of the zeroth order does not depend on nu", _PLACE + "fig. 3",
              "flat", f"within a factor {flat:.3g}", bool(flat < 2)),
        Claim("At theta = nu/2 the gradient is c = 1/(sqrt(2 pi) sigma)", _PLACE + "ex. III.5",
              f"{c:.4g} s/m", f"{_gradient(1e-4, sigma):.4g} s/m at nu = 1e-4: twice that",
              False),
        Claim("The gradient is zero with probability at least c nu", _PLACE + "ex. III.5",
              f"{p:.1e} at nu = 1e-6 m/s",
              f"1 - {p:.1e}: the text has the probability of the other event", False),
        Claim("With a body behind the friction the variance grows no further than its mass lets it",
              "our check, fig. 3 left", "constant for nu well below 2 N h F/m = 0.01 m/s",
              f"{stays:.2f} times larger at nu = 1e-5 m/s than at 1e-3", stays < 1.5),
    ]  # fmt: skip


def _gradient(nu: float, sigma: float) -> float:
    known = objective_spec("coulomb").objective({"theta": nu / 2, "nu": nu}).reference(sigma)
    assert known is not None
    return float(known.gradient[0])


study = Study(
    id="P3",
    title="Coulomb friction and empirical bias",
    citation=Citation("suh2022pathologies", "Fig. 3, example III.5"),
    Params=Params,
    run=run,
    claims=claims,
    notes=(
        "The relaxation is one of the sign, 2 H - 1, not of H.",
        "The closed form of F in the text is that of neither; the one used here is checked by"
        " quadrature.",
        "Behind it a block of 100 kg dragged from rest by a belt with at most 5 N for 0.1 s.",
    ),
)
