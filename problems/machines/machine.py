"""What a published machine's table holds."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dynamics.systems import Machine


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
