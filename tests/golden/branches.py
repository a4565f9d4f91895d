"""From a point that is not stationary on to one that is, by the branch that the LPEC proposes."""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp

from ocp.certificate import RADII, SECONDS, Certificate, certify
from ocp.lpec import LinearModel
from ocp.routes.legs import WARM
from ocp.routes.outcome import Outcome
from ocp.session import Session
from ocp.solver import Point


def onward(session: Session, outcome: Outcome, rounds: int = 3) -> tuple[float, Certificate]:
    """Cost and certificate after at most ``rounds`` branches, each an NLP of its own.

    The pairs that the steepest direction takes to their other side are held there, the others where
    they are; what remains has no complementarity.
    """
    nlp, point = session.judging_nlp(), outcome.result.point
    assert nlp is outcome.nlp, "direct transcription, ended by an active set"
    values = {**session.values, "penalty": 0.0}
    p, limits = nlp.parameter_vector(values), nlp.bounds(values)
    for _ in range(rounds):
        judge = certify(nlp, point.x, p, limits, point.lam_g)
        if judge.certified:
            break
        f, gradient = (np.array(v).ravel() for v in nlp.gradient(point.x, p))
        g, jacobian = nlp.jacobian(point.x, p)
        rows = sp.csr_matrix(jacobian.sparse())
        model = LinearModel.at(
            point.x, gradient, np.array(g).ravel(), rows, limits, nlp.sizes(), nlp.pairs
        )
        descent = model.descend(RADII[0], True, SECONDS, judge.tolerance)
        acts = model.members[0] > model.members[1]
        acts[descent.near] = descent.acts > 0.5
        bounds = {key: value.copy() for key, value in limits.items()}
        bounds["ubx"][np.where(acts, nlp.pairs[1], nlp.pairs[0])] = 0.0
        inside = np.clip(point.x, bounds["lbx"], bounds["ubx"])
        start = Point(inside, point.lam_x, point.lam_g)
        found = session.solver.run(nlp, start, p, bounds, **WARM, mu_init=1e-6)
        assert found.ok and found.f < f[0]
        point = found.point
    judge = certify(nlp, point.x, p, limits, point.lam_g)
    return float(nlp.gradient(point.x, p)[0]), judge
