"""``ocp.estimate``: gradient estimates for a named objective or for the cost of a problem's rollouts."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from os import PathLike, fspath
from typing import Any

import numpy as np

from dynamics.contact import ContactLaw
from ocp.errors import InputError, abbreviated
from ocp.gradients.case import ObjectiveCase
from ocp.gradients.estimation import Estimate, Sampling, run_sampling
from ocp.gradients.estimators import Rule
from ocp.gradients.sampling import Progress
from ocp.jobs.estimate_parts import JobWorkers
from ocp.jobs.scheduling import Workers
from ocp.problem.policy import Policy
from ocp.validation import Index, Number, validated


def estimate(
    problem: str | PathLike[str],
    estimators: Sequence[str] = ("zobg", "fobg", "alpha"),
    samples: int = 100_000,
    sigma: float | None = None,
    *,
    params: Mapping[str, Any] | None = None,
    contact: ContactLaw | str = "barrier",
    contact_settings: Mapping[str, Any] | None = None,
    policy: Policy | str = "open-loop",
    policy_settings: Mapping[str, Any] | None = None,
    theta: np.ndarray | None = None,
    seed: int = 0,
    reference: str = "auto",
    reference_samples: int | None = None,
    rules: Sequence[Rule] = (),
    progress: Progress | None = None,
    jobs: int = 1,
    scheduler: str | None = None,
    **engine: Any,
) -> dict[str, Estimate]:
    """Estimate the gradient of a smoothed objective, as ``ocp estimate`` does::

        estimate("heaviside", samples=10_000, params={"theta": 0.5})["fobg"].verdict

    ``problem`` is the name of an objective or problem, or the path of a problem's file. ``sigma`` is the
    standard deviation of the noise (default: that of the objective or, for a problem, a tenth of the inputs'
    largest characteristic size). ``theta`` is the decision: the components of an objective, or a problem's
    inputs or gains at all steps (default: the problem's initial guess). ``engine`` may contain ``backend`` and
    ``threads``. Other arguments are those of :class:`Sampling` and :func:`ocp.solve`. Results do not depend on
    the number of processes, ``jobs``, or the Dask cluster at ``scheduler``.

    Raises :class:`~ocp.errors.InputError` for unknown names, parameters out of range, and noise
    above 1e9 times or below 1e-9 times the default.
    """
    if not isinstance(problem, str | PathLike):
        raise InputError(
            "estimate takes the name of an objective or problem, or the path of a file that defines"
            f" one with CasADi, got {abbreviated(problem)}"
        )
    validated("seed", seed, Index)
    if theta is not None:
        theta = np.asarray(validated("theta", np.ravel(theta).tolist(), list[Number]))
    law, policy_request = (contact, contact_settings or {}), (policy, policy_settings or {})
    case = ObjectiveCase(fspath(problem), params or {}, *law, *policy_request, theta, engine)
    named_objective = case.build()
    noise = named_objective.sigma if sigma is None else sigma
    sampling = Sampling(tuple(estimators), samples, noise, seed, rules, reference, reference_samples)
    named_objective.check_sigma([noise])
    # These are the streams of the first point of ocp estimate, so that both give the same numbers.
    streams = np.random.SeedSequence(seed, spawn_key=(0,))
    workers = Workers(jobs, scheduler)
    piece_workers = None if workers.serial else JobWorkers(case, workers)
    return run_sampling(sampling, named_objective.objective, streams, progress, workers=piece_workers)
