"""Contact forces of a run as arrows, and the friction cones that they must stay in."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import casadi as ca
import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.patches import Wedge

from problems.drawing import ContactFrame
from reports.style import PURPLE, VERMILLION
from reports.view import RunView

if TYPE_CHECKING:
    pass

LEAST = 0.02
"""Forces below this fraction of the largest are not drawn."""
_LONGEST, _ACROSS, CONE = 0.18, 0.4, 0.7
"""Longest arrow in sides of the view, the longer and the shorter, and a cone in arrows."""


@dataclass(frozen=True)
class Forces:
    """Forces of every contact over a trajectory, in scenario 0.

    ``normal`` and ``friction`` (N, points) are along the normal and the tangent of the contact's
    :class:`~problems.drawing.ContactFrame`, both in ``unit``: impulses of one step [N s], or
    forces [N] where the system's multipliers are forces.
    """

    normal: np.ndarray
    friction: np.ndarray
    unit: str

    @property
    def largest(self) -> float:
        """Size of the largest finite force, 0 where there is none."""
        size = np.hypot(self.normal, self.friction)
        return float(np.max(size[np.isfinite(size)], initial=0.0))


def forces_of(view: RunView, suffix: str = "") -> Forces | None:
    """Forces of the plan, or with suffix ``"_replay"`` of its replay; None for a run without.

    From the stored ``normal_impulse`` and ``friction_impulse``, else from the system's map of the
    multipliers, else every multiplier is a normal impulse.
    """
    lam = view.array(f"lam{suffix}")
    if lam is None:
        return None
    normal, friction = (view.array(f"{kind}_impulse{suffix}") for kind in ("normal", "friction"))
    if normal is not None and friction is not None:
        return Forces(normal[0], friction[0], "N s")
    signals = view.signals("contacts")
    # lam of a law averaged over noise has one block a node; the mean is what moves the system.
    mean = [lam[0, :, i :: len(signals)].mean(axis=-1) for i in range(len(signals))]
    pushed = np.stack(mean, axis=1) if mean else np.zeros((lam.shape[1], 0))
    if view.problem is not None and (sums := view.problem.system.forces) is not None:
        system, parameters = view.problem.system, view.problem.parameters
        outputs = [sums.normal, sums.tangential]
        add_up = ca.Function("forces", [system.lam, parameters.vector], outputs)
        normal, tangential = (np.asarray(one).T for one in add_up(pushed.T, parameters.values))
        return Forces(normal, tangential, "N s")
    return Forces(pushed, np.zeros_like(pushed), signals[0].unit if signals else "")


def caption(largest: float, unit: str, rough: bool) -> str:
    """Caption of arrows and, where contacts are ``rough``, of cones."""
    cones = "; shaded: friction cone" if rough else ""
    what = "impulse" if unit == "N s" else "force"
    return f"arrows: contact {what}, the longest {largest:.3g} {unit}{cones}"


def acting_contacts(view: RunView) -> tuple[dict[str, np.ndarray], dict[int, str]]:
    """Sizes (N, points) of the forces of plan and replay by suffix, and the contacts that act.

    These are names by column: contacts with a visible force in the plan or in its replay.
    """
    found = {suffix: forces_of(view, suffix) for suffix in ("", "_replay")}
    sizes = {key: np.hypot(one.normal, one.friction) for key, one in found.items() if one}
    if not sizes:
        return {}, {}
    most = np.max([np.nanmax(size, axis=0, initial=0.0) for size in sizes.values()], axis=0)
    acting = np.flatnonzero((most > LEAST * most.max(initial=0.0)) & (most > 0))
    names = [signal.name for signal in view.signals("contacts")]
    if "point" in view.run.data.coords and view.run.data.sizes["point"] == most.size:
        names = [str(name) for name in view.run.data["point"].values]
    return sizes, {int(i): names[i] for i in acting}


def longest_arrow(size: np.ndarray) -> float:
    """Length [m] of the arrow of the largest force, inside a view of ``size`` (2,)."""
    return min(_LONGEST * float(size.max()), _ACROSS * float(size.min()))


def visible(
    contacts: Sequence[ContactFrame], pushes: tuple[np.ndarray, np.ndarray], largest: float
) -> Iterator[tuple[ContactFrame, float, float]]:
    """Contacts with their normal and friction force, without the smallest forces."""
    for frame, normal, friction in zip(contacts, *pushes, strict=False):
        if math.hypot(normal, friction) >= LEAST * largest > 0:
            yield frame, float(normal), float(friction)


def draw_contacts(
    axis: Axes,
    contacts: Sequence[ContactFrame],
    pushes: tuple[np.ndarray, np.ndarray],
    largest: float,
    alpha: float = 1,
    cones: float = 1,
) -> list[Artist]:
    """Draw the forces ``pushes``, normal and friction (points,), and cones this strong, 0 for none.

    The ``largest`` force is as long as :func:`longest_arrow`; the smallest are left out.
    """
    longest = longest_arrow(np.ptp([axis.get_xlim(), axis.get_ylim()], axis=1))
    drawn = list[Artist]()
    for frame, normal, friction in visible(contacts, pushes, largest):
        if frame.friction and cones:
            drawn.append(draw_cone(axis, frame, longest, cones))
        drawn.append(draw_force(axis, frame, normal, friction, longest / largest, alpha))
    return drawn


def draw_force(
    axis: Axes, frame: ContactFrame, normal: float, friction: float, scale: float, alpha: float = 1
) -> Artist:
    """Draw the force as an arrow from the contact, ``scale`` [m per unit] times its size long."""
    tx, ty = frame.tangent
    tip = (
        frame.x + scale * (normal * frame.nx + friction * tx),
        frame.y + scale * (normal * frame.ny + friction * ty),
    )
    return axis.annotate(
        "", xytext=(frame.x, frame.y), xy=tip, zorder=5, annotation_clip=False,
        arrowprops={"arrowstyle": "-|>", "color": VERMILLION, "linewidth": 1.0, "shrinkA": 0,
                    "shrinkB": 0, "alpha": alpha, "mutation_scale": 6},
    )  # fmt: skip


def draw_cone(axis: Axes, frame: ContactFrame, length: float, strength: float = 1) -> Artist:
    """Draw the friction cone, half as wide as atan(friction) on either side of the normal."""
    middle = math.degrees(math.atan2(frame.ny, frame.nx))
    half = math.degrees(math.atan(frame.friction))
    cone = Wedge((frame.x, frame.y), CONE * length, middle - half, middle + half, zorder=3,
                 facecolor=(PURPLE, 0.22 * strength),
                 edgecolor=(PURPLE, 0.8 * strength), linewidth=0.6)  # fmt: skip
    return axis.add_patch(cone)
