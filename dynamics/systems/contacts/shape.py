"""What a contact asks of the shape of a body."""

from __future__ import annotations

from abc import ABC, abstractmethod

import casadi as ca

from dynamics.systems.contacts.pose import Point, Pose, Scalar


class Shape(ABC):
    """All points within ``radius`` [m] of a convex core, in the frame of a body."""

    radius: Scalar

    @property
    @abstractmethod
    def corners(self) -> tuple[Point, ...]:
        """Corners of the core in the body's frame [m]; none where it is unbounded."""

    @abstractmethod
    def beside(self, point: ca.SX, pose: Pose) -> tuple[ca.SX, ca.SX]:
        """Signed distance [m] of a world point from the surface, and the unit normal out there."""
