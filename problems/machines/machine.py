"""What a published machine's table holds."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np

from dynamics.systems import Machine

_ROUNDING = 1e-9


@dataclass(frozen=True, eq=False)
class PublishedMachine(Machine):
    """A machine with the constants of the environment that its table comes from.

    ``pose`` is the pose the table is checked at, one value for each coordinate [m, rad];
    ``friction`` Coulomb's coefficient with the ground; ``h`` the environment's time step [s]; it
    starts ``lift`` [m] above the pose, off by up to ``noise`` in every coordinate and velocity.
    """

    pose: tuple[float, ...]
    friction: float
    h: float
    lift: float
    noise: float

    def reset(self, seed: int = 0) -> np.ndarray:
        """State (q, v) that the environment starts at, (2 nq,): the pose lifted, plus noise.

        The noise is uniform in [-noise, noise], in m, rad, m/s and rad/s alike.
        """
        start = np.concatenate([self.pose, np.zeros(len(self.pose))])
        start[1] += self.lift
        return start + np.random.default_rng(seed).uniform(-self.noise, self.noise, len(start))

    def check_start(self, q: Sequence[float], spheres: Collection[str]) -> None:
        """Refuse a pose ``q`` (nq,) with one of ``spheres`` in the ground or a joint past a limit.

        Raises ``ValueError`` that names the sphere or the joint, and by how much to mend it.
        """
        chain = self.chain()
        touches = self.contacts(chain, ca.SX(q), spheres)
        depths = {name: -float(touches[name].phi) for name in spheres}
        deepest = max(depths, key=lambda name: depths[name])
        if depths[deepest] > _ROUNDING:
            raise ValueError(
                f"the {deepest} starts {depths[deepest]:.3g} m inside the ground; raise the start"
                f" by as much, to a height of {q[1] + depths[deepest]:.6g} m"
            )
        for index, low, high in chain.limits:
            if not low - _ROUNDING <= q[index] <= high + _ROUNDING:
                raise ValueError(
                    f"the joint {chain.coordinates[index].name} starts at {q[index]:.3g} rad, past"
                    f" its limits of {low:.3g} to {high:.3g} rad; start it between them or leave"
                    " limits out"
                )
