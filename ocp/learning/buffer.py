"""Transitions that were seen, which models are learned from."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ocp.errors import InputError

COLUMNS = ("x", "u", "x_next")


@dataclass(frozen=True, eq=False)
class Buffer:
    """n steps: states ``x`` (n, nx), inputs ``u`` (n, nu), next states ``x_next`` (n, nx).

    Raises :class:`~ocp.errors.InputError` for shapes that disagree and for rows not finite.
    """

    x: np.ndarray
    u: np.ndarray
    x_next: np.ndarray

    def __post_init__(self) -> None:
        if self.x.ndim != 2 or self.u.ndim != 2 or self.x.shape != self.x_next.shape:
            raise InputError(
                f"transitions: x has shape {self.x.shape}, u {self.u.shape}, x_next"
                f" {self.x_next.shape}; expected (n, nx), (n, nu), (n, nx)"
            )
        if len(self.u) != len(self.x):
            raise InputError(
                f"transitions: {len(self.x)} states and {len(self.u)} inputs; pair them"
            )
        whole = np.hstack([self.x, self.u, self.x_next])
        if bad := int(np.count_nonzero(~np.isfinite(whole).all(axis=1))):
            raise InputError(f"transitions: {bad} of {len(whole)} are not finite; leave them out")

    def __len__(self) -> int:
        return len(self.x)

    def __getitem__(self, rows: np.ndarray | slice) -> Buffer:
        return Buffer(self.x[rows], self.u[rows], self.x_next[rows])

    def with_newest(self, more: Buffer, most: int) -> Buffer:
        """Both, this one's first, and of them the last ``most``."""
        columns = (
            np.concatenate([getattr(self, name), getattr(more, name)])[-most:] for name in COLUMNS
        )
        return Buffer(*columns)

    @classmethod
    def solved(cls, x: np.ndarray, u: np.ndarray, x_next: np.ndarray) -> Buffer:
        """The steps whose next state is finite: those of which the contact was solved."""
        good = np.isfinite(x_next).all(axis=1)
        return cls(x[good], u[good], x_next[good])
