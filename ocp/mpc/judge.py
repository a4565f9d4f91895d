"""An independent certificate of a plan, beside the loop."""

from __future__ import annotations

import numpy as np

from ocp.mpc.stages import Plan
from ocp.session import Session
from ocp.stationarity.certificate import certify

_FEASIBLE = 1e-6
"""Largest violation of constraints, in their characteristic sizes."""


class PlanJudge:
    """Judges plans of a session's problem, at the session's present values."""

    def __init__(self, session: Session) -> None:
        self.session = session

    def verdict(self, plan: Plan, values: dict[str, float]) -> str:
        """``B`` or ``KKT`` for a stationary plan, ``not``, ``undecided`` or ``infeasible``.

        ``B`` is B-stationarity for the exact law, ``KKT`` that of the smoothed problem.
        """
        nlp = self.session.judging_nlp()
        found = {"x": plan.x[None, 1:], "u": plan.u[None], "lam": plan.lam[None],
                 "gap": plan.gap[None]}  # fmt: skip
        point = nlp.variables.pack({k: v for k, v in found.items() if k in nlp.variables})
        p, bounds = nlp.parameter_vector(values), nlp.bounds(values)
        g = nlp.values(point, p)[1]
        off = np.maximum(bounds["lbg"] - g, g - bounds["ubg"]) / nlp.natural.g
        box = np.maximum(bounds["lbx"] - point, point - bounds["ubx"]) / nlp.natural.x
        if not max(off.max(initial=0.0), box.max(initial=0.0)) <= _FEASIBLE:
            return "infeasible"
        return certify(nlp, point, p, bounds).stationarity
