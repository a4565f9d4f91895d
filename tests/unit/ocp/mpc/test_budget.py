"""Counts of a sample are bounded by the budget, and accuracy that nothing can notice changes no closed loop."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from ocp.errors import InputError
from ocp.mpc import Controller, compiled_sample, simulate
from ocp.mpc.horizon_qp import Tolerance
from ocp.mpc.plants import Disturbance
from problems import get
from tests.benchmarks.mpc.tasks import TASKS

BUDGET = 6
"""Iterations that few programs need, so that many are stopped."""
COST_SHARE = 2e-3
"""Share by which a closed loop may cost more with tolerances that follow the linearisation error."""


@pytest.mark.costly
@pytest.mark.cheap_cases("push-disc")
@pytest.mark.parametrize("name", list(TASKS))
def test_the_budget_bounds_every_sample_of_every_task(name: str) -> None:
    """This includes the first sample, which otherwise solves up to 30 programs."""
    task = TASKS[name]
    controller = Controller(task.made(), trust=task.trust, budget=BUDGET)
    loop = simulate(controller, 12, goals=task.goals, disturbance=Disturbance(noise_state=task.noise))
    iterations, programs = (loop.data[key].values for key in ("qp_iterations", "programs"))
    assert iterations.max() <= BUDGET
    assert iterations.min() >= 1 and programs.min() >= 1
    assert loop.survived.all()


def test_an_unfinished_program_does_not_raise_the_merit() -> None:
    """The shifted plan is among the candidates, whatever the last iterate of the solver is."""
    controller = Controller(get("push-disc"), budget=1)
    plan = controller.step(controller.start).plan
    assert plan is not None
    controller._p[:, controller._measured_columns] = np.concatenate([plan.x[1], plan.u[0]])
    [shifted] = controller._shifted_plans(controller._p, controller._horizon[2])
    arrays = (shifted.x[None], shifted.u[None], shifted.lam[None])
    before = controller.model.merits(*arrays, plan.u[0], controller._p)[0][0]
    command = controller.step(plan.x[1])
    assert command.qp_iterations == 1 and "stopped" in command.note
    assert command.merit <= before * (1 + 1e-9)


@pytest.mark.parametrize("budget", [0, -3, 2.5, "many"])
def test_a_budget_is_a_positive_whole_number(budget: object) -> None:
    with pytest.raises(InputError, match="budget must be a whole number"):
        Controller(get("push-disc"), budget=budget)  # pyright: ignore[reportArgumentType]


@pytest.mark.costly
@pytest.mark.parametrize("name", ["push-disc", "finger-disc", "planar-push", "soft-walls N = 5"])
def test_accuracy_that_the_next_linearisation_cannot_notice_costs_nothing(
    name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Programs solved to 1e-9 lead to a loop that is cheaper by a share of 2e-3 at most, and take more iterations."""
    task = TASKS[name]
    controller = Controller(task.made(), trust=task.trust)
    inexact = simulate(controller, 40, goals=task.goals)
    monkeypatch.setattr(compiled_sample, "TIGHT", Tolerance(1e-9, 1e-9))
    monkeypatch.setattr(compiled_sample, "MAX_LINEARISATION_ERROR", 1e-9)
    exact = simulate(Controller(task.made(), trust=task.trust), 40, goals=task.goals)
    assert inexact.costs[0] <= (1 + COST_SHARE) * exact.costs[0]
    assert inexact.data["qp_iterations"].values[:, 1:].sum() < exact.data["qp_iterations"].values[:, 1:].sum()


@pytest.mark.costly
def test_inputs_are_the_same_without_a_compiler(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Rounding differs, and each sample starts from the plan before it."""
    inputs = []
    for hidden in (False, True):
        if hidden:
            monkeypatch.setenv("PATH", str(tmp_path))
        controller = Controller(get("soft-walls", N=5))
        assert (controller._phase.compiled is None) == hidden
        inputs.append(simulate(controller, 15).data["u"].values)
    assert inputs[1] == pytest.approx(inputs[0], rel=1e-6, abs=1e-6)
