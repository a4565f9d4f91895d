"""Compiled samples agree with the phases in NumPy: gains, plans, merits, tolerances, and exchanges of contacts."""

from __future__ import annotations

from dataclasses import replace

import casadi as ca
import numpy as np
import pytest

from dynamics.batch.arguments import BatchWarning
from dynamics.batch.engines import c_sample
from dynamics.batch.engines.compiler import CompilerError
from ocp.mpc.controller import Controller
from ocp.mpc.newton_phase import NewtonPhase
from ocp.mpc.phase import Sample
from problems import get


def two_phases(controller: Controller) -> tuple[NewtonPhase, NewtonPhase]:
    """Return a controller's phase twice: compiled, and in NumPy."""
    phases = [controller._build_phase() for _ in range(2)]
    compiled, interpreted = (phase for phase in phases if isinstance(phase, NewtonPhase))
    assert compiled.compiled is not None
    interpreted.compiled = None
    return compiled, interpreted


def sample_of(controller: Controller, steps: int, seed: int) -> Sample:
    """Return a sample at a state beside the first plan, with a horizon of some steps."""
    rng, limits = np.random.default_rng(seed), controller._horizon[2]
    x = controller.start + 0.02 * controller.problem.scales.x * rng.standard_normal(len(controller.start))
    p = controller._horizon[1][: steps + 1].copy()
    p[:, controller._measured_columns] = np.concatenate([x, limits[1]])
    return Sample(x, limits[1], p, (limits[2], limits[3]))


def agree(first: np.ndarray, second: np.ndarray, tolerance: float = 1e-6) -> bool:
    """Whether arrays agree up to a tolerance relative to the largest entry."""
    return bool(np.max(np.abs(first - second), initial=0.0) <= tolerance * (1 + np.max(np.abs(second), initial=0.0)))


@pytest.mark.cheap_cases("push-disc-qpcc")
@pytest.mark.parametrize(
    ("name", "phase"),
    [
        *(("soft-walls", "qpcc"), ("soft-walls", "relaxed"), ("push-disc", "qpcc"), ("finger-disc", "qpcc")),
        *(("planar-push", "qpcc"), ("spinner", "relaxed"), ("half-cheetah", "qpcc")),
    ],
)
def test_compiled_samples_equal_those_in_numpy(name: str, phase: str) -> None:
    """Each sample starts from the plan of the one before it, and has the exchange that this one chose."""
    compare_phases(Controller(get(name), phase=phase))


def test_costs_of_impulses_and_saddles_are_the_same() -> None:
    """Multipliers are eliminated from the cost, whose negative curvature is set to zero by another method."""
    problem = get("cart-walls", N=5)
    system, sizes = problem.system, problem.scales
    saddle = 20 * sizes.cost * (system.x[0] / sizes.x[0]) * (system.u[0] / sizes.u[0])
    impulses = sizes.cost * ca.sumsqr(system.lam / sizes.impulse)
    controller = Controller(replace(problem, stage_cost=problem.stage_cost + saddle + impulses))
    phase = two_phases(controller)[1]
    phase.prepare(controller.current_plan, sample_of(controller, 5, 0))
    assert phase.prepared is not None and controller.model.costs_impulses
    evaluated = controller.model.evaluate(phase.plan, controller._horizon[2][1], controller._horizon[1])
    assert np.linalg.eigvalsh(evaluated.hessian).min() < 0
    compare_phases(controller)


def compare_phases(controller: Controller) -> None:
    """Check that three samples of a controller's phase agree with those in NumPy."""
    both, plans = two_phases(controller), [controller.current_plan] * 2
    for seed in range(3):
        sample, answers = sample_of(controller, controller.model.N, seed), []
        for phase_of_two, plan in zip(both, plans, strict=True):
            phase_of_two.prepare(plan, sample)
            assert phase_of_two.is_prepared
            answers.append((phase_of_two.gains, phase_of_two.feedback(sample)))
        (gains, answer), (gains_in_numpy, expected) = answers
        assert agree(gains, gains_in_numpy)
        assert (answer.note, answer.violated) == (expected.note, expected.violated)
        assert answer.merit == pytest.approx(expected.merit, rel=1e-8)
        assert answer.plan is not None and expected.plan is not None
        pairs = [(getattr(answer.plan, field), getattr(expected.plan, field)) for field in ("x", "u")]
        assert all(agree(*pair) for pair in pairs)
        compiled, interpreted = both
        assert compiled.qp_iterations == interpreted.qp_iterations and compiled.has_exchange == interpreted.has_exchange
        assert compiled.compiled is not None
        assert agree(compiled.compiled.arrays["tolerance"], np.array(interpreted.tolerance), 1e-6)
        plans = [answer.plan, expected.plan]


def test_constraints_that_cannot_be_met_have_the_same_answer() -> None:
    """The first program is followed by others with separate slacks and larger penalties."""
    controller = Controller(get("cart-transport", N=5))
    sample = sample_of(controller, 5, 0)
    sample.x[:] += 5 * controller.problem.scales.x
    answers = []
    for phase in two_phases(controller):
        phase.prepare(controller.current_plan, sample)
        answers.append((phase.feedback(sample), phase.programs))
    (answer, programs), (expected, expected_programs) = answers
    assert programs == expected_programs > 1
    assert (answer.note, answer.status) == (expected.note, expected.status)
    assert answer.merit == pytest.approx(expected.merit, rel=1e-6)


def test_shifted_plans_and_predicted_states_are_the_same() -> None:
    controller = Controller(get("push-disc"))
    command = controller.step(controller.start)
    assert command.plan is not None
    p, limits = controller._horizon[1:]
    plans, states = [], []
    for _ in range(2):
        [plan] = controller._shifted_plans(p, limits)
        plans.append(plan)
        controller.trust = 0.5
        states.append(controller._expected_state(plan, command.u, p))
        if (compiled := controller._phase.compiled) is not None:
            controller._phase.gain = compiled.arrays["gain"].reshape(2, 4).copy()
            controller._phase.compiled = None
    assert agree(states[0], states[1], 1e-9)
    for field in ("x", "u", "lam", "gap"):
        assert agree(getattr(plans[0], field), getattr(plans[1], field), 1e-9)


def test_a_sample_that_does_not_compile_is_reported_and_runs_in_numpy(monkeypatch: pytest.MonkeyPatch) -> None:
    controller = Controller(get("push-disc"))
    expected = controller.step(controller.start)

    def fail(*_: object, **__: object) -> None:
        raise CompilerError("the compiler failed")

    monkeypatch.setattr(c_sample, "load_library", fail)
    with pytest.warns(BatchWarning, match="the compiler failed; samples run on the numpy backend"):
        controller.reset()
    command = controller.step(controller.start)
    assert controller._phase.compiled is None and agree(command.u, expected.u)
