"""Ctrl-C keeps the best solution of several starts or, during the first start, its best point."""

import os
import signal
import threading
from collections.abc import Iterator

import pytest

from dynamics.contact import Barrier, Exact
from ocp import Status, solve
from ocp.errors import interruptible
from ocp.programs.solver import Solver, record_interrupts
from ocp.routes.homotopy import StageRecord
from ocp.solution import Interrupted
from ocp.solve.solve import new_session
from problems import get


def stopping_after(polishes: int):
    seen = []

    def progress(stage: StageRecord) -> None:
        seen.append(stage.label)
        if seen.count("active set") > polishes:
            raise KeyboardInterrupt

    return progress


@pytest.mark.costly
def test_the_best_finished_start_is_kept() -> None:
    of_one: list[StageRecord] = []
    solve(get("push-1d"), Exact(), progress=of_one.append, effort="quick")
    polishes = [stage.label for stage in of_one].count("active set")
    with pytest.raises(Interrupted) as stop:
        solve(get("push-1d"), Exact(), n_starts=5, progress=stopping_after(polishes))
    kept = stop.value.solution
    assert kept.success
    assert 1 <= len(kept.route.attempts) < 5
    assert kept.cost == pytest.approx(1.38481827, rel=1e-6)


def test_before_the_first_answer_the_best_point_is_kept() -> None:
    """The solve is stopped after the first polish, which is feasible; earlier stages violate lam gap = 0."""
    stages: list[StageRecord] = []
    stop_after = stopping_after(0)

    def progress(stage: StageRecord) -> None:
        stages.append(stage)
        stop_after(stage)

    with pytest.raises(Interrupted) as stop:
        solve(get("push-1d"), Exact(), n_starts=5, progress=progress)
    kept = stop.value.solution
    assert kept.status is Status.INTERRUPTED
    assert not kept.success and kept.grade == "failed" and kept.route.attempts == []
    assert kept.verdict.startswith("Interrupted: cost ")
    assert stages[-1].label == "active set" and stages[-1].accepted
    assert kept.cost == pytest.approx(stages[-1].cost, rel=1e-9), "relaxed stages break lam gap = 0"
    assert kept.audit.complementarity <= 1e-8
    assert [stage.label for stage in kept.stages] == [stage.label for stage in stages]
    assert kept.iterations == sum(stage.iterations for stage in stages)


def test_without_a_feasible_point_the_nearest_to_it_is_kept() -> None:
    """As mu falls, the last stage violates lam gap = mu the least."""
    stages: list[StageRecord] = []

    def progress(stage: StageRecord) -> None:
        stages.append(stage)
        if len(stages) == 3:
            raise KeyboardInterrupt

    with pytest.raises(Interrupted) as stop:
        solve(get("push-1d"), Barrier(mu=1e-6), progress=progress)
    kept = stop.value.solution
    assert [stage.label for stage in stages] == ["mu"] * 3
    assert kept.data["lam"].values * kept.data["gap"].values == pytest.approx(stages[-1].value, rel=1e-6)
    assert kept.cost == pytest.approx(stages[-1].cost, rel=1e-9)


@pytest.fixture
def handled() -> Iterator[None]:
    """Install Python's handler of Ctrl-C, also if the parent process ignores the signal."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


def sigint_in(seconds: float) -> threading.Timer:
    timer = threading.Timer(seconds, os.kill, (os.getpid(), signal.SIGINT))
    timer.start()
    return timer


@pytest.mark.costly
@pytest.mark.usefixtures("handled")
def test_a_signal_in_the_solver_leaves_its_iterate(capfd) -> None:
    """IPOPT's interface catches the signal; the iterate at that time is kept."""
    session = new_session(get("planar-hand", N=60), Barrier(mu=1e-3))
    nlp = session.nlp_of("product")
    start, p = session.first_point(nlp), nlp.parameter_vector(session.values)
    solver, heard = Solver(), []
    solver.on_result = lambda _, result: heard.append(result)
    timer = sigint_in(0.5)
    with pytest.raises(KeyboardInterrupt):
        solver.run(nlp, start, p, nlp.bounds(session.values))
    timer.join()
    (result,) = heard
    assert result.status is Status.INTERRUPTED
    assert result.iterations > 0 and 0.4 < result.seconds < 10
    f, g = nlp.values(result.point.x, p)
    assert (result.f, list(result.g)) == (f, list(g))
    few = Solver("ipopt", {"max_iter": result.iterations})
    there = few.run(nlp, start, p, nlp.bounds(session.values))
    assert result.f == pytest.approx(there.f, rel=1e-9), "the iterate that it was at"
    assert capfd.readouterr().err == ""


@pytest.mark.usefixtures("handled")
def test_handlers_are_as_before() -> None:
    before = signal.getsignal(signal.SIGINT)
    with record_interrupts() as seen:
        assert seen == []
        with pytest.raises(KeyboardInterrupt):
            signal.raise_signal(signal.SIGINT)
        assert seen == [signal.SIGINT]
    assert signal.getsignal(signal.SIGINT) is before
    found: list[object] = []

    def elsewhere() -> None:
        with record_interrupts() as none:
            found.append(none)

    thread = threading.Thread(target=elsewhere)
    thread.start()
    thread.join()
    assert found == [[]], "other threads get no signals"


def test_a_replay_under_a_law_takes_that_laws_parameter() -> None:
    """A replay under a soft law uses that law's mu, not the mu of the plan."""
    found = solve(get("push-1d"), Barrier(mu=1e-6))
    soft, own = found.replay(Barrier(mu=1e-1)), found.replay(Barrier(mu=1e-6))
    assert own.cost == pytest.approx(found.cost, rel=1e-6)
    assert abs(soft.data["lam"] * soft.data["gap"] - 1e-1).max() < 1e-9
    assert soft.cost != pytest.approx(own.cost, rel=1e-2)


def test_an_interrupt_inside_a_matrix_conversion_comes_through() -> None:
    def converted() -> None:
        try:
            raise KeyboardInterrupt
        except KeyboardInterrupt as inside:
            raise SystemError("returned a result with an exception set") from inside

    with pytest.raises(KeyboardInterrupt), interruptible():
        converted()
    with pytest.raises(SystemError, match="other"), interruptible():
        raise SystemError("other")
