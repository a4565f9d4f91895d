"""From the variables of an NLP back to trajectories."""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca
import numpy as np

from ocp.programs.solver import Result
from ocp.rollout import Gains
from ocp.transcription.nlp import NLP


@dataclass(frozen=True)
class Trajectories:
    """Planned trajectories of all scenarios; lam, gap, mu (S, N, n) over all branches."""

    x: np.ndarray
    u: np.ndarray
    lam: np.ndarray
    gap: np.ndarray
    mu: np.ndarray
    residual: np.ndarray
    gains: Gains | None


def trajectories(nlp: NLP, result: Result, p: np.ndarray) -> Trajectories:
    """Read the trajectories out of an NLP's variables and recompute gap, mu and residual."""
    blocks = nlp.variables.unpack(result.point.x)
    problem, step = nlp.problem, nlp.step
    S, N, nx = problem.scenarios.n, problem.N, problem.system.nx
    gains = Gains(blocks["K"], blocks["k"]) if "K" in blocks else None
    if nlp.trajectories is not None:
        found = nlp.trajectories(result.point.x, p)
        x, u, lam, _ = (np.array(v).T for v in found)
        x, u, lam = x.reshape(S, N + 1, nx), u.reshape(S, N, -1), lam.reshape(S, N, -1)
    else:
        given = nlp.data.unpack(p[len(nlp.names) :])["x0"][:, None]
        x = np.concatenate([blocks.get("x0", given), blocks["x"]], axis=1)
        u = np.broadcast_to(blocks["u"], (S, N, problem.system.nu))
        lam = blocks.get("lam")
        if lam is None:
            lam = _solved_contacts(nlp, x, u, p)
    columns = (np.asarray(part).reshape(S * N, -1).T for part in (x[:, :-1], u, x[:, 1:], lam))
    found = step.relation.map(S * N)(*columns, _step_values(nlp, p))
    residual, gap, mu = (np.array(ca.densify(v)).T.reshape(S, N, -1) for v in found)
    return Trajectories(x, np.array(u), lam, gap, mu, residual, gains)


def _step_values(nlp: NLP, p: np.ndarray) -> np.ndarray:
    return nlp.step.p.pack(dict(zip(nlp.names, p, strict=False)))


def _solved_contacts(nlp: NLP, x: np.ndarray, u: np.ndarray, p: np.ndarray) -> np.ndarray:
    values = _step_values(nlp, p)
    flat_x, flat_u = x[:, :-1].reshape(-1, x.shape[2]).T, u.reshape(-1, u.shape[2]).T
    lam = nlp.step.solve.map(flat_x.shape[1])(flat_x, flat_u, values)[1]
    return np.array(lam).T.reshape(*u.shape[:2], -1)
