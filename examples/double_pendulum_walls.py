"""A double pendulum stands up between two walls, which are too near for it to swing freely."""

import casadi as ca
import numpy as np

from dynamics.systems import Chain, Link, signals, time_stepping
from dynamics.systems.shapes import Contact, Disc, HalfPlane, Pose
from ocp import Problem, Scaling, solve
from problems import drawing
from problems.parameters import Parameters, quantity, structure, table

name = "double-pendulum-walls"
title = "A double pendulum between two walls"
axes = ("x [m]", "z [m]")
RADIUS = 0.05
BALLS = ("elbow", "tip")
WALLS = {"left": 1, "right": -1}


class Params(Parameters):
    """Two links of the same length, that hang at angle 0; angles count clockwise, about +y."""

    m: float = quantity(1.0, "kg", "mass of either link", above=0)
    length: float = quantity(0.5, "m", "length of either link", above=0)
    wall: float = quantity(0.58, "m", "distance of either wall from the middle", above=0)
    friction: float = quantity(0.2, "1", "Coulomb's coefficient with the walls", least=0)
    u_max: float = quantity(4.0, "N m", "largest torque of either motor", above=0)
    h: float = quantity(0.02, "s", "step size", above=0)
    N: int = structure(100, "number of steps", least=1)


def arm(p) -> Chain:
    """Shoulder at the origin, both joints with a motor."""
    link = {"mass": p["m"], "inertia": p["m"] * p["length"] ** 2 / 12, "gear": 1.0, "damping": 0.05}
    com, end = (0.0, -p["length"] / 2), (0.0, -p["length"])
    return Chain([Link("upper", None, com=com, **link), Link("lower", "upper", com=com, anchor=end, **link)])


def contacts(p, q) -> list[Contact]:
    """Elbow and tip, a ball each, against either wall."""
    chain, ball = arm(p), Disc(RADIUS, (0.0, -p["length"]))
    return [
        Contact.between(ball, chain.pose(q, link), HalfPlane((-side * p["wall"], 0), (side, 0)), Pose.fixed())
        for link in ("upper", "lower")
        for side in WALLS.values()
    ]


def build(params: Params) -> Problem:
    """u are the torques in shoulder and elbow [N m]; the end is both links upright, at rest."""
    p = table(params)
    chain, h = arm(p), p["h"]
    system = time_stepping(
        name,
        states=(*chain.coordinates, *chain.velocities),
        inputs=signals("shoulder [N m]; elbow [N m]"),
        contacts=signals("; ".join(f"{ball} on {wall} [N s]" for ball in BALLS for wall in WALLS)),
        h=h,
        mass=chain.mass,
        impulse=lambda q, v, u: h * (chain.B @ u - chain.bias(q, v)),
        damping=-ca.jacobian(chain.damping(v := ca.SX.sym("v", 2)), v),
        distance=lambda q: ca.vertcat(*(contact.phi for contact in contacts(p, q))),
        sliding=lambda q: ca.vertcat(*(contact.jacobians(q)[1] for contact in contacts(p, q))),
        friction=p["friction"],
        parameters=p,
    )
    x = system.x
    off = x - ca.DM([np.pi, 0, 0, 0])
    return Problem(
        name,
        system,
        params.N,
        stage_cost=h * 0.1 * ca.sumsqr(system.u),
        terminal_cost=100 * ca.sumsqr(off[:2]) + 10 * ca.sumsqr(off[2:]),
        x0=ca.SX.zeros(4),
        parameters=p,
        u_lower=-p["u_max"],
        u_upper=p["u_max"],
        guess=turning,
        scaling=Scaling(impulse=0.5, gap=0.1, x=0.5, u=2.0),
    )


def turning(problem: Problem, p: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Turn up evenly, straight through the wall: a guess need not obey the model.

    Hanging still, the default, is an equilibrium; from there the search takes three times as long,
    or does not end.
    """
    X = np.zeros((problem.N + 1, 4))
    X[:, 0] = np.linspace(0, np.pi, problem.N + 1)
    return X, np.zeros((problem.N, 2))


def draw(params: Params, state: np.ndarray) -> list[drawing.Shape]:
    """Walls, links and the balls at their ends."""
    p, q = params.model_dump(), ca.SX(ca.DM(state[:2]))
    chain = arm(p)
    ends = [chain.position(q, link, (0, -params.length)) for link in ("upper", "lower")]
    (x1, z1), (x2, z2) = ((float(end[0]), float(end[1])) for end in ends)
    return [
        *(drawing.Wall(-side * params.wall, 0, side, 0) for side in WALLS.values()),
        drawing.Stadium(0, 0, x1, z1, 0.02),
        drawing.Stadium(x1, z1, x2, z2, 0.02),
        drawing.Circle(x1, z1, RADIUS),
        drawing.Circle(x2, z2, RADIUS),
    ]


def frames(params: Params, state: np.ndarray) -> list[drawing.ContactFrame]:
    """Where the balls touch the walls, or come near to them."""
    q = ca.SX(ca.DM(state[:2]))
    found = contacts(params.model_dump(), q)
    return [drawing.ContactFrame(*map(float, (*c.point.nz, *c.normal.nz)), params.friction) for c in found]


if __name__ == "__main__":
    print(solve(__file__, contact="exact").verdict)
