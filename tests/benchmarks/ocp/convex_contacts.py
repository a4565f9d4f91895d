"""Formulations of the contact of two polygons, on the same scenes under the exact law.

``python -m tests.benchmarks.ocp.convex_contacts [SCENE [WAY]]`` prints pairs per step, IPOPT's
iterations, seconds, cost and verdict of each; solves are stopped after 150 s.
"""

from __future__ import annotations

import multiprocessing as mp
import sys
import time
from collections.abc import Callable

import casadi as ca
import numpy as np

from dynamics.systems import Parameter, ParameterTable
from dynamics.systems.shapes import Contact, Pose, Shape
from dynamics.systems.shapes.planar import as_column
from dynamics.systems.shapes.polygon import vertex_pairs
from ocp import solve
from ocp.problem.problem import Problem, Scaling
from problems.scenes import Body, Box, Disc, Goal, Obstacle, Pusher, Scene, things

LIMIT = 150
FINGER = Pusher("finger", Disc(0.1), at=(-0.5, 0.0), stiffness=50.0)
BOX = Body("box", Box((0.2, 0.2)), at=(0.0, 0.0), mass=1.0, inertia=0.03)
SCENES = {
    "box, block": ([FINGER, BOX, Obstacle("block", Box((0.1, 0.1)), at=(0.5, -0.25))], (1.0, 0.2)),
    "box along a wall": ([FINGER, BOX, Obstacle("wall", Box((1.0, 0.1)), at=(0.4, -0.32))], (0.7, -0.02)),
    "finger, box": ([FINGER, BOX], (0.6, 0.2)),
    "disc among boxes": (
        [
            FINGER,
            Body("box", Disc(0.2), at=(0, 0), mass=1.0, inertia=0.02),
            Obstacle("low", Box((0.1, 0.1)), at=(0.5, -0.25)),
            Obstacle("high", Box((0.1, 0.1)), at=(0.6, 0.4)),
        ],
        (1.0, 0.1),
    ),
}
BETWEEN = Contact.between


def one_pair(one: Shape, other: Shape) -> list[tuple[Shape, Shape]]:
    """Return a single pair, that of the shapes themselves."""
    return [(one, other)]


def separating(one: Shape, a: Pose, other: Shape, b: Pose) -> Contact:
    """Return the contact at the side, of either shape, from which all corners of the other are farthest."""
    if min(len(one.corners), len(other.corners)) < 3:
        return BETWEEN(one, a, other, b)
    found = []
    for sign, face, at, solid, there in ((1, other, b, one, a), (-1, one, a, other, b)):
        corners = [there.to_world(c) for c in solid.corners]
        ring = [at.to_world(c) for c in face.corners]
        for i, start in enumerate(ring):
            along = ring[(i + 1) % len(ring)] - start
            n = ca.vertcat(along[1], -along[0]) / ca.norm_2(along)
            low, point = ca.dot(n, corners[0] - start), corners[0]
            for corner in corners[1:]:
                height = ca.dot(n, corner - start)
                point = ca.if_else(height < low, corner, point)
                low = ca.fmin(low, height)
            found.append((low, sign * n, point if sign > 0 else point - low * n))
    phi, normal, point = found[0]
    for more in found[1:]:
        normal, point = (
            ca.if_else(more[0] > phi, new, old) for new, old in zip(more[1:], (normal, point), strict=True)
        )
        phi = ca.fmax(phi, more[0])
    return Contact(a, b, phi, normal, as_column(point))


WAYS: dict[str, tuple[Callable[..., object], Callable[..., Contact]]] = {
    "vertex pairs": (vertex_pairs, BETWEEN),
    "nearest corner": (one_pair, BETWEEN),
    "separating side": (one_pair, separating),
}


def measure(scene: str, way: str, answer: mp.Queue[str]) -> None:
    """Solve one scene with the contacts of scenes replaced, in a separate process."""
    things.vertex_pairs, Contact.between = WAYS[way]  # type: ignore[assignment,attr-defined]
    there, goal = SCENES[scene]
    parameters = ParameterTable([Parameter("h", 0.05, "s")])
    made = Scene([*there, Goal("box", at=goal)], friction=0.3)
    system = made.quasi_dynamic("scene", parameters, h=parameters["h"])
    off, du = made.coordinates_of("box", system.x)[:2] - np.array(goal), ca.SX.sym("du", system.nu)
    problem = Problem(
        "scene",
        system,
        30,
        stage_cost=0.01 * ca.sumsqr(off) + 0.1 * ca.sumsqr(du),
        terminal_cost=10 * ca.sumsqr(off),
        x0=made.at_rest(system),
        parameters=parameters,
        du=du,
        u_before=made.hold,
        scaling=Scaling(impulse=0.5, gap=0.1, x=0.5, u=0.5),
    )
    began = time.perf_counter()
    found = solve(problem, contact="exact")
    took = time.perf_counter() - began
    answer.put(
        f"{system.nlam:5d} {found.iterations:6d} {took:7.1f} {found.cost:10.4f}"
        f"  {'solved' if found.success else 'not solved'}, {found.verdict}"
    )


def main() -> None:
    """Print one line for each scene and way."""
    chosen = sys.argv[1:]
    for scene in chosen[:1] or SCENES:
        for way in chosen[1:] or (list(WAYS) if "box, " in scene or "wall" in scene else [*WAYS][:1]):
            answer: mp.Queue[str] = mp.Queue()
            process = mp.Process(target=measure, args=(scene, way, answer))
            process.start()
            process.join(LIMIT)
            process.kill()
            print(f"{scene:18s} {way:16s}", answer.get() if not answer.empty() else "  no answer", flush=True)


if __name__ == "__main__":
    main()
