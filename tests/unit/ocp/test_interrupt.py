"""Ctrl-C between starts keeps the best answer so far; before the first one it is what it is."""

import pytest

from dynamics.contact import Exact
from ocp import solve
from ocp.errors import interruptible
from ocp.solution import Interrupted, StageRecord
from problems import get


def stopping_after(polishes: int):
    seen = []

    def progress(stage: StageRecord) -> None:
        seen.append(stage.knob)
        if seen.count("active set") > polishes:
            raise KeyboardInterrupt

    return progress


def test_the_best_finished_start_is_kept() -> None:
    of_one: list[StageRecord] = []
    solve(get("push-1d"), Exact(), progress=of_one.append)
    polishes = [stage.knob for stage in of_one].count("active set")
    with pytest.raises(Interrupted) as stop:
        solve(get("push-1d"), Exact(), starts=5, progress=stopping_after(polishes))
    kept = stop.value.solution
    assert kept.success
    assert 1 <= len(kept.others) < 5
    assert kept.cost == pytest.approx(1.38481827, rel=1e-6)


def test_nothing_is_kept_before_the_first_answer() -> None:
    with pytest.raises(KeyboardInterrupt) as stop:
        solve(get("push-1d"), Exact(), starts=5, progress=stopping_after(0))
    assert not isinstance(stop.value, Interrupted)


def test_a_replay_under_a_law_takes_that_laws_knob() -> None:
    """A soft replay of a hard plan must be the soft law's, not the plan's own mu again."""
    from dynamics.contact import Barrier

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
