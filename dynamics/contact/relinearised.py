"""Steps with curved gaps by linearising them where the step ends, again and again."""

from __future__ import annotations

from dataclasses import replace
from functools import cached_property

import casadi as ca
import numpy as np

from dynamics.contact.step import Step
from dynamics.systems import Parameter, ParameterTable

_ROUNDS = 30
_ARRIVED = 1e-9
_SOLVED = 1e-7


class Relinearised:
    """Josephy-Newton for one closed step under the exact law, where its path leads nowhere.

    The gaps are expanded at a guess of the next state, which leaves the complementarity problem of
    bodies without curvature; its end is the next guess. Started where the bodies are, so that a
    body in the way stays in the way; then where they would go without contact, which itself is the
    end of a step so long that it leads past the other body altogether.
    """

    def __init__(self, step: Step) -> None:
        self.step = step

    @cached_property
    def _flat(self) -> Step:
        """The step with its gaps expanded at a centre, which is a parameter behind the others."""
        system = self.step.system
        centre = ParameterTable(
            Parameter(f"centre of {signal.name}", 0.0, signal.unit) for signal in system.states
        )
        slope = ca.jacobian(system.gap, system.x_next)
        here, slope = ca.substitute([system.gap, slope], [system.x_next], [centre.vector])
        gap = here + slope @ (system.x_next - centre.vector)
        return self.step.law.close(
            replace(system, gap=gap, parameters=system.parameters + centre, redundant=True)
        )

    @cached_property
    def _open(self) -> ca.Function:
        """Map ``(x, u, p)`` to ``(x_next, lam, gap)`` where no contact acts, whatever the gaps.

        What slides is free to: the slip of a contact is what its friction pairs need.
        """
        system = self.step.system
        nothing = ca.SX.zeros(system.nlam)
        free = ca.substitute(system.landing, system.lam, nothing)
        unknown = ca.vertcat(system.x_next, system.lam)
        gap = ca.substitute(system.gap, unknown, ca.vertcat(free, nothing))
        lam = ca.SX.zeros(system.nlam)
        for i, pair in enumerate(system.pairs):
            if pair.kind == "slip":
                rubs = [j for j, other in enumerate(system.pairs)
                        if other.kind == "friction" and other.contact == pair.contact]  # fmt: skip
                lam[i] = ca.mmax(ca.vertcat(0, -gap[rubs]))
        gap = ca.substitute(system.gap, unknown, ca.vertcat(free, lam))
        given = [system.x, system.u, self.step.p.vector]
        return ca.Function("open", given, [ca.densify(part) for part in (free, lam, gap)])

    def solve(self, x: np.ndarray, u: np.ndarray, p: np.ndarray) -> tuple[np.ndarray, ...]:
        """Return ``x_next, lam, gap, error`` as ``step.solve`` does, error infinite for no end."""
        found = self._settle(x, u, p, x)
        if np.all(found[3] <= _SOLVED):
            return found
        free, lam, gap = (np.array(part).ravel() for part in self._open(x, u, p))
        if np.all(gap >= 0):
            return free, lam, gap, np.zeros(self.step.n)
        return self._settle(x, u, p, free)

    def _settle(
        self, x: np.ndarray, u: np.ndarray, p: np.ndarray, centre: np.ndarray
    ) -> tuple[np.ndarray, ...]:
        found, none = (), np.full(self.step.n, np.inf)
        for _ in range(_ROUNDS):
            values = self._flat.solve(x, u, np.concatenate([p, centre]))
            found = tuple(np.array(value).ravel() for value in values)
            if not (np.all(found[3] <= _SOLVED) and np.all(np.isfinite(found[0]))):
                break
            moved, centre = float(np.abs(found[0] - centre).max()), found[0]
            if moved <= _ARRIVED * (1 + np.abs(centre).max()):
                return found
        return *found[:3], none
