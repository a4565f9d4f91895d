"""One contact and nothing else: ``lam`` over the gap z, its slope and its curvature."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from dynamics.batch import BatchFunction
from dynamics.contact import Adaptive, Barrier, ContactLaw
from dynamics.systems import Parameter, ParameterTable, Signal, lcs


@dataclass(frozen=True)
class ScalarContact:
    """A law's answer over z, all (n,): ``lam``, ``mu``, and total derivatives of lam by z."""

    lam: np.ndarray
    mu: np.ndarray
    slope: np.ndarray
    curvature: np.ndarray


_BARRIER, _GAUSSIAN = Barrier(mu=1.0), Adaptive(sigma=1.0)
"""One object each, since a law is compiled once an object; their own parameters are inputs."""


def barrier_contact(z: ArrayLike, F: ArrayLike, mu: ArrayLike) -> ScalarContact:
    """:func:`scalar_contact` under the barrier law at constant ``mu`` [N s m]."""
    return scalar_contact(_BARRIER, z, F, mu=mu)


def gaussian_contact(z: ArrayLike, F: ArrayLike, sigma: ArrayLike) -> ScalarContact:
    """:func:`scalar_contact` under the adaptive law that is Gaussian smoothing by ``sigma`` [m]."""
    return scalar_contact(_GAUSSIAN, z, F, sigma=sigma)


def scalar_contact(
    law: ContactLaw, z: ArrayLike, F: ArrayLike, **law_values: ArrayLike
) -> ScalarContact:
    """Evaluate ``0 <= lam ⟂ z + F lam >= 0`` as ``law`` closes it, at gaps ``z`` (n,) [m].

    lam is an impulse [N s]; F [m/(N s)] and ``law_values`` (``mu``, ``sigma``) are numbers
    or (n,). The system is ``x+ = lam`` with the gap as its state.
    """
    solve, derive, p = _built(law)
    points, none = np.reshape(np.asarray(z, dtype=float), (-1, 1)), np.zeros(1)
    values = np.broadcast_to(p.pack({"F": F}, **law_values), (len(points), len(p)))
    _, impulse, _, _ = solve(points, none, values)
    found = derive(points, none, values, impulse)
    return ScalarContact(*(array[:, 0] for array in (impulse, *found)))


@lru_cache(maxsize=8)
def _built(law: ContactLaw) -> tuple[BatchFunction, BatchFunction, ParameterTable]:
    """Compile the step of ``law`` and its derivatives, of (z, u, p) and of (z, u, p, lam)."""
    table = ParameterTable([Parameter("F", 1.0, "m/(N s)")])
    compliance = table["F"]
    system = lcs(
        "scalar contact",
        A=[[0.0]], B=[[0.0]], C=[[1.0]], D=[[1.0]], E=[[0.0]], F=compliance,
        states=(Signal("z", "m"),), inputs=(Signal("none", "1"),),
        contacts=(Signal("contact", "N s"),), parameters=table,
    )  # fmt: skip
    step = law.close(system)
    x, u, p, lam = system.x, system.u, step.p.vector, step.lam
    slope = step.contact_jacobian(x)
    curvature = ca.jacobian(slope, x) + ca.jacobian(slope, lam) @ slope
    derive = ca.Function("scalar_contact", [x, u, p, lam], [step.mu, slope, ca.densify(curvature)])
    return BatchFunction(step.solve), BatchFunction(derive), step.p
