"""Returns of trained policies under the exact law and in MuJoCo, from the same first states.

``python -m tests.benchmarks.robots.policies_in_mujoco RUN...`` evaluates runs of ``ocp train`` and rewrites the site's
table row by row.
"""

from __future__ import annotations

import math
import sys
from importlib import import_module
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np

from docs.generator.measured import DATA, read, write_table
from ocp.learning.experiment import EXACT, Experiment
from ocp.learning.protocol import TrainedPolicy
from ocp.learning.training import evaluate
from ocp.problem.problem import Problem
from ocp.simulators.mujoco_world import MujocoWorld
from ocp.store.runs import load
from problems.tasks.training import rebuilt

TABLE = "policies-in-mujoco"
COLUMNS = ("task", "h [s]", "algorithm", "iterations", "return", "return in MuJoCo", "steps", "steps in MuJoCo")
EPISODES, SEED = 20, 0
KEPT_SHARE = 0.2
BOUNCE_STIFFNESS = 1e5
"""Stiffness of the floor under the thrown ball [N/m]: an impact takes 10 ms."""
BALL = """<mujoco><option timestep="1e-4" gravity="0 0 {gravity}"/><worldbody><geom name="floor" type="plane"
 size="0 0 1"/><body pos="{x} 0 {z}"><freejoint/><inertial mass="{m}" pos="0 0 0" diaginertia="{m} {m} {m}"/>
 <geom name="ball" type="sphere" size="1e-6" mass="0" solref="-{k} -{d}" solimp="0.9999 0.9999 1e-3" priority="1"
 condim="1"/></body></worldbody></mujoco>"""
"""A point on a floor that is a spring and a damper."""


def thrown(experiment: Experiment, u: np.ndarray) -> np.ndarray:
    """Return the last x, z, vx, vz [m, m/s] of a ball that is thrown with u (2,), angle and speed."""
    mujoco: Any = import_module("mujoco")
    p = dict(zip(experiment.task.parameters.names, experiment.task.parameters.values, strict=True))
    ratio = -math.log(p["restitution"]) / math.hypot(math.pi, math.log(p["restitution"]))
    damper = 2 * ratio * math.sqrt(BOUNCE_STIFFNESS / p["m"])
    model = mujoco.MjModel.from_xml_string(
        BALL.format(gravity=-p["g"], x=p["x0"], z=p["z0"] + 1e-6, m=p["m"], k=BOUNCE_STIFFNESS / p["m"], d=damper)
    )
    data = mujoco.MjData(model)
    data.qvel[[0, 2]] = u[1] * math.cos(u[0]), u[1] * math.sin(u[0])
    mujoco.mj_step(model, data, round(experiment.task.horizon * p["h"] / model.opt.timestep))
    return np.array([*data.qpos[[0, 2]], *data.qvel[[0, 2]]])


def throw_return(experiment: Experiment, policy: TrainedPolicy) -> tuple[float, float]:
    """Return the return of a throw in MuJoCo, and its steps."""
    task = experiment.task
    u = experiment.inputs(policy, task.reset(1, np.random.default_rng(SEED)))[0]
    state = np.concatenate([thrown(experiment, u), np.zeros(task.system.nx - 4)])
    return float(task.finals(state, task.parameters.values)), float(task.horizon)


def run_return(experiment: Experiment, policy: TrainedPolicy) -> tuple[float, float]:
    """Return the mean return of episodes in MuJoCo, and their mean number of steps."""
    task, p = experiment.task, experiment.task.parameters.values
    starts = task.reset(EPISODES, np.random.default_rng(SEED))
    problem = Problem(task.name, task.system, task.horizon, ca.SX(0), ca.SX(0), starts[0], task.parameters)
    world, returns, steps = MujocoWorld(problem, problem.parameters.defaults), 0.0, 0
    for start in starts:
        x = start
        for _ in range(task.horizon):
            u = experiment.inputs(policy, x[None])[0]
            x, before = world.step(x, u), x
            if not np.isfinite(x).all():
                break
            returns, steps = returns + float(task.rewards(before, u, x, p)), steps + 1
            if float(task.ends(x, p)):
                break
    return returns / EPISODES, steps / EPISODES


def row(path: str) -> list[str]:
    """Return the table's row of a run."""
    run = load(Path(path))
    experiment, policy = rebuilt(run)
    exact = evaluate(experiment, policy, EXACT, EPISODES, SEED)
    here, steps = float(exact.returns.mean()), float(exact.lengths.mean())
    is_throw = experiment.task.name == "ball-throw"
    there, steps_there = (throw_return if is_throw else run_return)(experiment, policy)
    kept = abs(there - here) <= KEPT_SHARE * abs(here - float(run.data["evaluation_return"][0]))
    text = f"**{there:.4g}**" if kept else f"{there:.4g}"
    iterations = str(run.record["iterations"])
    cells = [
        experiment.task.name,
        f"{experiment.params['h']:g}",
        str(run.record["algorithm"]),
        iterations,
        f"{here:.4g}",
        text,
    ]
    cells += [f"{steps:.3g}", f"{steps_there:.3g}"]
    print(*cells, flush=True)
    return cells


def main() -> None:
    """Evaluate run after run, and store each row."""
    for path in sys.argv[1:]:
        fresh = row(path)
        old = read(TABLE)["rows"] if (DATA / f"{TABLE}.json").exists() else []
        write_table(
            TABLE,
            title="Trained policies in MuJoCo",
            command="python -m tests.benchmarks.robots.policies_in_mujoco RUN...",
            columns=COLUMNS,
            rows=sorted([cells for cells in old if cells[:2] != fresh[:2]] + [fresh]),
            note=f"Means over {EPISODES} first states that training did not see; bold within 20 % of what training"
            " gained under the exact law. The ball bounces in MuJoCo on a spring and damper that give its restitution.",
        )


if __name__ == "__main__":
    main()
