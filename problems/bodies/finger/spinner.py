"""A finger that spins a disc on a pin."""

from __future__ import annotations

import casadi as ca
import numpy as np

from dynamics.systems import Signal
from ocp.problem.problem import Problem, Scaling
from problems.bodies.finger.machine import STEPS, FingerParams, finger_frames, finger_shapes, finger_system
from problems.drawing import Shape
from problems.machines.tracking import with_nominal
from problems.parameters import pose_problem, quantity, structure, table
from problems.spec import Citation, Golden

name = "spinner"
title = "A finger that spins a disc"
citation = Citation("kurtz2023idto", "IDTO's spinner; its code, examples/spinner")
axes = ("x [m]", "z [m]")
equations = (
    STEPS
    + r"""theta^+ = theta + h omega, quad e = (q_1 - q_(1,0), q_2 - q_(2,0), q_3 - theta - "lead")
min sum_(k=0)^(N-1) h (w_q norm(e_k)^2 + w_v norm(v_k)^2 + w_u norm(u_k)^2)
  + w_"end" norm(e_N)^2 + w_"rest" norm(v_N)^2
"""
)
golden = {"exact": Golden(8.3918095564, tried=44, note="other minima: 8.3963802, 8.3984789, 8.4031937, 12.55, 17.73")}


class Params(FingerParams):
    """Parameters of ``spinner``, with the source's values as defaults."""

    N: int = structure(40, "number of steps", least=1)
    shoulder0: float = quantity(0.3, "rad", "start and goal of the shoulder")
    elbow0: float = quantity(1.5, "rad", "start and goal of the elbow")
    rate: float = quantity(1.0, "rad/s", "rate omega of the disc's nominal angle theta")
    lead: float = quantity(0.0, "rad", "offset added to the nominal angle")
    w_q: float = quantity(1.0, "1/s", "weight of the distance to the nominal angles", least=0)
    w_v: float = quantity(0.1, "s", "weight of the velocities", least=0)
    w_u: float = quantity(0.1, "1/(N^2 m^2 s)", "weight of the torques", least=0)
    w_end: float = quantity(10.0, "1", "terminal weight of the distance to the nominal pose", least=0)
    w_rest: float = quantity(0.1, "s^2", "terminal weight of the velocities", least=0)


def build(params: Params) -> Problem:
    """Return the problem with steps (spinner.1), contact (spinner.2), nominal (spinner.3) and cost (spinner.4).

    The state is (q, v, nominal); lam are impulses [N s]. The nominal angle starts at zero, the initial angle of the
    disc. It is a state, so that it continues in a closed loop, where the offset ``lead`` can move it to the current
    angle of the disc. Contact is rigid, whereas the source has stiff springs; no force drives the disc, whereas the
    source penalises such a force.
    """
    p = table(params)
    system = with_nominal(finger_system(name, p), p["rate"], Signal("nominal", "rad", "nominal angle of the disc"))
    q, v, nominal = system.x[:3], system.x[3:6], system.x[6]
    error = q - ca.vertcat(p["shoulder0"], p["elbow0"], nominal + p["lead"])
    running = p["w_q"] * ca.sumsqr(error) + p["w_v"] * ca.sumsqr(v)
    return pose_problem(
        params,
        system,
        stage_cost=p["h"] * (running + p["w_u"] * ca.sumsqr(system.u)),
        terminal_cost=p["w_end"] * ca.sumsqr(error) + p["w_rest"] * ca.sumsqr(v),
        x0=ca.vertcat(p["shoulder0"], p["elbow0"], ca.SX.zeros(5)),
        scaling=Scaling(impulse=0.5, gap=0.1, x=0.5, u=5.0),
    )


def draw(params: Params, state: np.ndarray) -> list[Shape]:
    """Draw finger and disc, and the nominal angle of the disc."""
    return finger_shapes(params, state, float(state[6]) + params.lead)


frames = finger_frames
