"""A model of a step with known derivatives that is neither learned nor a CasADi graph."""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from dynamics.learned.transitions import DataOrigin
from dynamics.systems import ContactSystem


class Wavy:
    """Model ``y = A z + z'Qz / 2 + a sin(z)``; the output after the states replaces log p."""

    kind: ClassVar[str] = "ewda"

    def __init__(self, system: ContactSystem, seed: int = 0) -> None:
        rng = np.random.default_rng(seed)
        z = (*system.states, *system.inputs)
        self.origin = DataOrigin(z, system.states, data_hash="wavy")
        self.n_in, self.n_out = system.nx + system.nu, system.nx + 1
        carried = [np.eye(system.nx), 0.3 * rng.standard_normal((system.nx, system.nu))]
        self.A = np.vstack([np.hstack(carried), rng.standard_normal(self.n_in)])
        Q = 0.05 * rng.standard_normal((self.n_out, self.n_in, self.n_in))
        Q[-1] -= np.eye(self.n_in)
        self.Q = Q + Q.transpose(0, 2, 1)
        self.a = 0.05 * rng.standard_normal((self.n_out, self.n_in))
        self.asked = 0

    def values(self, z: np.ndarray) -> np.ndarray:
        curved = np.einsum("oij,ni,nj->no", self.Q, z, z) / 2
        return z @ self.A.T + curved + np.sin(z) @ self.a.T

    def jacobians(self, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        self.asked += len(z)
        slopes = self.A + np.einsum("oij,nj->noi", self.Q, z) + self.a * np.cos(z)[:, None]
        return self.values(z), slopes

    def curvatures(self, z: np.ndarray, weights: np.ndarray) -> np.ndarray:
        found = np.einsum("no,oij->nij", weights, self.Q)
        diagonal = np.arange(self.n_in)
        found[:, diagonal, diagonal] -= np.sin(z) * (weights @ self.a)
        return found
