"""Calls of public constructors with a plausible wrong argument, and the message that each must raise."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import casadi as ca
import numpy as np

from dynamics.batch import Gaussian
from dynamics.contact import Adaptive, Barrier, Exact, Randomized
from dynamics.learned.region import Region
from dynamics.systems import (
    Link,
    Machine,
    Parameter,
    ParameterTable,
    Part,
    Sphere,
    quasi_dynamic,
    signals,
    time_stepping,
)
from dynamics.systems.shapes import Box, Capsule, Disc, HalfPlane
from ocp import (
    Constraint,
    Feedback,
    Problem,
    Scaling,
    Scenarios,
    estimate,
    free,
    load,
    roll_out,
    solve,
)
from ocp.problem.problem import FreeStart
from problems import get
from problems.scenes import Body, Goal, Obstacle, Pusher, Scene
from tests.unit.ocp.user_problems import defaults

Call = Callable[[], Any]
WALL = get("wall-1d")
OTHER = ca.SX.sym("stranger")
LINK = Link("torso", None, 1.0, 0.1)
BALL = Body("ball", Disc(0.1), at=(0, 0))


def stepping(**more: Any) -> Any:
    given: dict[str, Any] = {
        "states": signals("x [m]; v [m/s]"),
        "inputs": signals("u [N]"),
        "contacts": signals("c [N s]"),
        "h": 0.1,
        "mass": 1.0,
        "impulse": lambda q, v, u: u,
        "distance": lambda q: q,
        "parameters": ParameterTable([Parameter("m", 1.0, "kg")]),
    }
    return time_stepping("t", **given | more)


def pushing(**more: Any) -> Any:
    given: dict[str, Any] = {
        "states": signals("x [m]; a [m]"),
        "inputs": signals("u [m]"),
        "contacts": signals("c [N s]"),
        "h": 0.1,
        "mass": ca.SX(1),
        "stiffness": ca.SX(10),
        "distance": lambda q: q[0] - q[1],
        "parameters": ParameterTable(),
    }
    return quasi_dynamic("t", **given | more)


def problem(**more: Any) -> Problem:
    return replace(WALL, **more)


def region(**more: Any) -> Region:
    given: dict[str, Any] = {
        "states": {"x": (-1, 1), "v": (-1, 1)},
        "inputs": {"u": (-1, 1)},
        "start": (0, 0),
        "goal": (1, 0),
        "spread": (0.1, 0.1),
    }
    return Region(**given | more)


U = np.zeros((1, WALL.N, 1))
SHAPES: dict[str, Call] = {
    "Box half_size must be two numbers": lambda: Box(0.1, 0.1),  # pyright: ignore
    "Box half_size must be two numbers ": lambda: Box((0.1, 0.1, 0.1)),  # pyright: ignore
    "Box half_size must be positive": lambda: Box((0.1, -0.1)),
    "Box radius must not be negative": lambda: Box((0.1, 0.1), radius=-1),
    "Box radius must be a number": lambda: Box((0.1, 0.1), radius="0.1"),  # pyright: ignore
    "Disc radius must not be negative": lambda: Disc(-0.1),
    "Disc radius must be finite": lambda: Disc(np.nan),
    "Disc radius must be a number": lambda: Disc("r"),  # pyright: ignore
    "Disc radius must be a number ": lambda: Disc((0.1, 0.2)),  # pyright: ignore
    "Disc centre must be two numbers": lambda: Disc(0.1, centre=1.0),  # pyright: ignore
    "Capsule start must be two numbers": lambda: Capsule(0, 1, 0.1),  # pyright: ignore
    "Capsule end must be two numbers": lambda: Capsule((0, 0), 1, 0.1),  # pyright: ignore
    "Capsule radius must be positive": lambda: Capsule((0, 0), (1, 0), 0),
    "HalfPlane normal must have length 1": lambda: HalfPlane((0, 0), (0, 0)),
    "HalfPlane normal must be two numbers": lambda: HalfPlane((0, 0), 1.0),  # pyright: ignore
    "HalfPlane origin must be two numbers": lambda: HalfPlane(0.0),  # pyright: ignore
}
SCENES: dict[str, Call] = {
    "ball: shape must be a Disc, Box": lambda: Body("ball", 0.1, at=(0, 0)),  # pyright: ignore
    "ball: at must be two numbers": lambda: Body("ball", Disc(0.1), at=0.5),  # pyright: ignore
    "ball: mass must be positive": lambda: Body("ball", Disc(0.1), at=(0, 0), mass=0),
    "ball: inertia must be positive": lambda: Body("ball", Disc(0.1), at=(0, 0), inertia=-1),
    "the name of the Body must be": lambda: Body("", Disc(0.1), at=(0, 0)),
    "the name of the Obstacle must be": lambda: Obstacle(3, Disc(0.1), at=(0, 0)),  # pyright: ignore
    "p: stiffness must be positive": lambda: Pusher("p", Disc(0.1), at=(0, 0), stiffness=-1),
    "p: axis must have length 1": lambda: Pusher("p", Disc(0.1), at=(0, 0), axis=(0, 0)),
    "post: angle must be a number": lambda: Obstacle("post", Disc(0.1), (0, 0), "x"),  # pyright: ignore
    "goal of ball: at must be two numbers": lambda: Goal("ball", at=1.0),  # pyright: ignore
    "the things of a scene must be a sequence": lambda: Scene(BALL),  # pyright: ignore
    "but contains Disc": lambda: Scene([Disc(0.1)]),  # pyright: ignore
    "two things are called": lambda: Scene([BALL, BALL]),
    "did you mean 'ball'?": lambda: Scene([BALL], non_colliding=[("ball", "bal")]),
    "the friction of a scene must not be negative": lambda: Scene([BALL], friction=-0.1),
    "the friction of a scene must be a number": lambda: Scene([BALL], friction="rough"),  # pyright: ignore
    "a goal is for 'box'; there are ball": lambda: Scene([BALL, Goal("box", at=(0, 0))]),
}
SYSTEMS: dict[str, Call] = {
    "signals": lambda: signals(""),
    "signals ": lambda: signals(3),  # pyright: ignore
    "the name of a parameter must be": lambda: Parameter("", 1.0),
    "the value of parameter 'm' must be a number": lambda: Parameter("m", "1"),  # pyright: ignore
    "the value of parameter 'm' must be finite": lambda: Parameter("m", np.inf),
    "two different parameters share the name 'm'": lambda: ParameterTable([Parameter("m", 1), Parameter("m", 2)]),
    "must be a sequence of Parameter": lambda: ParameterTable(["m"]),  # pyright: ignore
    "no parameter 'M'": lambda: ParameterTable([Parameter("m", 1)])["M"],
    "states must be a sequence of Signal": lambda: stepping(states="x; v"),
    "expected positions and as many velocities": lambda: stepping(states=signals("x [m]")),
    "inputs must be a sequence of Signal": lambda: stepping(inputs=1),
    "mass": lambda: stepping(mass=ca.SX.eye(2)),
    "impulse": lambda: stepping(impulse=lambda q, v, u: ca.vertcat(u, u)),
    "impulse must be a function": lambda: stepping(impulse=1.0),
    "distance": lambda: stepping(distance=lambda q: ca.vertcat(q, q)),
    "distance ": lambda: stepping(distance=None),
    "h must be a number": lambda: stepping(h="0.1"),
    "h must be positive": lambda: stepping(h=-0.1),
    "parameters must be a ParameterTable": lambda: stepping(parameters={"m": 1.0}),
    "stranger": lambda: stepping(mass=OTHER),
    "cone": lambda: stepping(cone="round", sliding=lambda q: ca.SX(1), friction=0.1),
    "stiffness": lambda: pushing(stiffness=ca.SX.eye(3)),
    "mass ": lambda: pushing(mass=ca.SX.eye(4)),
    "link 'a': mass must be positive": lambda: Link("a", None, -1.0, 0.1),
    "link 'a': inertia must be positive": lambda: Link("a", None, 1.0, 0.0),
    "link 'a': joint must be": lambda: Link("a", None, 1.0, 0.1, joint="ball"),  # pyright: ignore
    "link 'a': com must be two numbers": lambda: Link("a", None, 1.0, 0.1, com=0.1),  # pyright: ignore
    "'a' floats freely": lambda: Link("a", None, 1, 1, joint="free", gear=1.0),
    "link 'a': limits are 1 to -1": lambda: Link("a", None, 1.0, 0.1, limits=(1.0, -1.0)),
    "which does not exist": lambda: Machine((LINK,), (Sphere("foot", "leg", (0, 0), 0.1),)),
    "links must be": lambda: Machine(LINK, ()),  # pyright: ignore
    "two links are named 'torso'": lambda: Machine((LINK, LINK), ()),
    "has the parent 'hip'": lambda: Machine((Link("leg", "hip", 1.0, 0.1),), ()),
    "sphere 'foot': radius must be positive": lambda: Sphere("foot", "torso", (0, 0), -0.1),
    "sphere 'foot': centre must be two numbers": lambda: Sphere("foot", "torso", 0.0, 0.1),  # pyright: ignore
    "part 'foot': shape must be a": lambda: Part("foot", "torso", 0.1),  # pyright: ignore
}
LAWS: dict[str, Call] = {
    "mu must be a number > 0": lambda: Barrier(mu=-1.0),
    "mu must be ": lambda: Barrier(mu="x"),  # pyright: ignore
    "mu or kappa": lambda: Barrier(mu=1.0, kappa=1.0),
    "sigma must be": lambda: Adaptive(sigma=-1.0),
    "law": lambda: Adaptive("gausian"),
    "samples": lambda: Randomized(samples=0),
    "scheme": lambda: Randomized(scheme="sobel"),
    "base must be a ContactLaw": lambda: Randomized(base="exact"),  # pyright: ignore
    "sigma": lambda: Gaussian(-1.0, 0),
    "penalty": lambda: Feedback(penalty=-1.0),
    "start": lambda: region(start=(0,)).check(WALL.system),
    "u": lambda: region(inputs={"u": (1, -1)}).check(WALL.system),
}
PROBLEMS: dict[str, Call] = {
    "N": lambda: problem(N=0),
    "N ": lambda: problem(N=2.5),
    "a problem's name": lambda: problem(name=""),
    "system": lambda: problem(system=WALL),
    "x0 has 3 entries": lambda: problem(x0=[0, 0, 0]),
    "u_upper has 2 entries": lambda: problem(u_upper=[1, 2]),
    "stage_cost must be numbers or": lambda: problem(stage_cost="x"),
    "stage_cost uses stranger": lambda: problem(stage_cost=OTHER),
    "terminal_cost uses u": lambda: problem(terminal_cost=WALL.system.u**2),
    "a cost on du needs both": lambda: problem(du=ca.SX.sym("du")),
    "path": lambda: problem(path=[WALL.system.u]),
    "a constraint's name": lambda: Constraint("", WALL.system.u, 0, 1),
    "lower of constraint c": lambda: Constraint("c", WALL.system.u, [0, 0], 1),  # pyright: ignore
    "scenarios": lambda: Scenarios(n=0),
    "scenarios ": lambda: Scenarios(n=2, std=(-1.0,)),
    "impulse": lambda: Scaling(impulse=0.0),
    "periodic": lambda: problem(start=FreeStart(ca.SX.zeros(2), ca.SX.zeros(2), (5,))),
    "needs 0 < lower <= upper": lambda: free(0.05, 0.01),
    "unknown problem 'push-disk'": lambda: solve("push-disk"),
    "unknown contact law 'hard'": lambda: solve("wall-1d", "hard"),
    "unknown method 'shooting'": lambda: solve("wall-1d", Exact(), "shooting"),
    "starts": lambda: solve("wall-1d", n_starts=0),
    "unknown parameter 'mass'": lambda: get("wall-1d", mass=1.0),
    "parameter m": lambda: get("wall-1d", m="heavy"),
    "unknown estimator 'fo'": lambda: estimate("heaviside", ["fo"]),
    "samples must be a whole number >= 2": lambda: estimate("heaviside", samples=1),
    "no run": lambda: load("nothing"),
    "inputs": lambda: roll_out(WALL, np.zeros((1, 3, 1)), defaults(WALL)),
    "inputs ": lambda: roll_out(WALL, "u", defaults(WALL)),  # pyright: ignore
    "x0": lambda: roll_out(WALL, U, defaults(WALL), x0=np.zeros((1, 5))),
}
TABLES = {
    "shapes": SHAPES,
    "scenes": SCENES,
    "systems": SYSTEMS,
    "laws": LAWS,
    "problems": PROBLEMS,
}
