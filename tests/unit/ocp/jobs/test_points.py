"""A point of a sweep equals a separate solve to the last bit, whatever its worker has solved before."""

from __future__ import annotations

import dataclasses
import json
from typing import Any

import numpy as np
import pytest

from dynamics.contact import Barrier
from ocp.errors import InputError
from ocp.jobs.session_cache import SessionCache
from ocp.jobs.sweep import sweep
from ocp.solution import Solution
from ocp.solve.solve_request import SolveRequest
from ocp.solve.starts import solve_session
from ocp.store.json_values import to_json
from ocp.transcription import Direct, MultipleShooting
from problems import get
from tests.unit.ocp.jobs.same import TIMES, same

SHORT = {"N": 6}


def told(found: Solution) -> str:
    """Return everything that is reported on a solution, except times."""
    judged = {name: dataclasses.asdict(getattr(found, name)) for name in ("audit", "referee")}
    certificate = dataclasses.asdict(found.certificate)
    del certificate["seconds"]
    rest = (found.cost, found.iterations, found.status.label, found.verdict, found.idle_cost)
    return json.dumps(to_json([judged, certificate, rest]))


@pytest.mark.costly
@pytest.mark.parametrize(
    ("problem", "contact", "method", "name", "values"),
    [
        ("push-1d", "barrier", "direct", "problem.M", (1.0, 2.0, 1.02)),
        ("push-1d", "exact", "direct", "problem.goal_x", (1.0, 0.5)),
        ("push-1d", "exact", "multiple-shooting", "problem.M", (1.0, 1.5)),
        ("push-disc", "barrier", "direct", "contact.mu", (1e-1, 1e-3)),
        ("box-slide", "barrier", "direct", "problem.friction", (0.3, 0.5)),
        ("push-1d", "randomized", "direct", "contact.sigma", (0.1, 0.05)),
    ],
)
def test_a_session_that_takes_functions_over_answers_as_a_new_one(
    problem: str, contact: str, method: str, name: str, values: tuple[float, ...]
) -> None:
    base, kept = SolveRequest(problem, SHORT, contact, method=method), SessionCache()
    for value in values:
        case = base.at({name: value})
        alone, shared = (solve_session(one) for one in (case.session(), kept.session(case)))
        assert told(alone) == told(shared)
        drop = ["stage_seconds"]
        assert alone.data.drop_vars(drop).identical(shared.data.drop_vars(drop))


@pytest.mark.costly
def test_numbers_alone_build_no_program_again(monkeypatch: pytest.MonkeyPatch) -> None:
    built: list[str] = []
    for method in (Direct, MultipleShooting):
        real = method.transcribe

        def counted(self: Any, *given: Any, real: Any = real, **more: Any) -> Any:
            built.append(self.name)
            return real(self, *given, **more)

        monkeypatch.setattr(method, "transcribe", counted)
    kept, case = SessionCache(), SolveRequest("push-1d", SHORT, "barrier")
    solve_session(kept.session(case))
    first = len(built)
    assert first > 0
    for M, mu in ((2.0, 1e-3), (0.5, 1e-2), (2.0, 1e-4)):
        solve_session(kept.session(case.at({"problem.M": M, "contact.mu": mu})))
    assert len(built) == first
    # Another N changes the graph and needs another program.
    solve_session(kept.session(case.at({"problem.N": 5})))
    assert len(built) == 2 * first


@pytest.mark.costly
def test_every_point_is_the_solve_of_its_own() -> None:
    found = sweep("push-1d", {"M": [0.5, 2.0], "contact.mu": "1e-3:1e-1:2:log"}, "barrier", params=SHORT)
    assert found["cost"].dims == ("M", "contact.mu") and found["M"].attrs["units"] == "kg"
    assert found["contact.mu"].values.tolist() == [1e-3, 1e-1]
    for M in (0.5, 2.0):
        for mu in (1e-3, 1e-1):
            alone = solve_session(SolveRequest("push-1d", {**SHORT, "M": M}, "barrier", {"mu": mu}).session())
            point = found.sel({"M": M, "contact.mu": mu})
            assert float(point["cost"]) == alone.cost
            assert float(point["exact_cost"]) == alone.audit.exact_cost
            assert float(point["referee_cost"]) == alone.referee.cost
            assert int(point["survives"]) == int(bool(alone.referee.survives))
            assert str(point["status"].values) == "solved" and int(point["success"]) == 1
            assert str(point["stationarity"].values) == alone.certificate.stationarity
            assert str(point["verdict"].values) == alone.verdict
            assert int(point["iterations"]) == alone.iterations and float(point["seconds"]) > 0
            for name in ("x", "u", "lam", "gap", "x_referee", "time"):
                assert np.array_equal(point[name].values, alone.data[name].values)
    assert float(found["cost"].sel({"M": 2.0, "contact.mu": 1e-3})) > float(
        found["cost"].sel({"M": 0.5, "contact.mu": 1e-3})
    )


@pytest.mark.costly
def test_points_of_other_lengths_stand_in_one_array_and_end_in_nothing() -> None:
    found = sweep("push-1d", {"N": [6, 4]})
    assert found.sizes["node"] == 7 and found["N"].values.tolist() == [6, 4]
    short = found.sel(N=4)
    assert np.isfinite(short["x"].values[:, :5]).all() and np.isnan(short["x"].values[:, 5:]).all()
    alone = solve_session(SolveRequest("push-1d", {"N": 4}).session())
    assert float(short["cost"]) == alone.cost
    assert np.array_equal(short["x"].values[:, :5], alone.data["x"].values)


@pytest.mark.costly
def test_what_cannot_be_asked_or_fails_is_a_point_with_its_sentence() -> None:
    over = {"qa0": [-0.5, -0.2], "width": [0.2, 0.4]}
    found = sweep("push-1d", over, params=SHORT)
    bad = found.sel(qa0=-0.2, width=0.4)
    assert str(bad["status"].values) == "refused" and int(bad["success"]) == 0
    assert "the pusher starts inside the object" in str(bad["verdict"].values)
    assert np.isnan(bad["cost"]) and np.isnan(bad["x"].values).all() and int(bad["survives"]) == -1
    assert int(found["success"].sum()) == 3
    ended = sweep("push-1d", {"setting.max_iter": [1, 3000]}, params=SHORT)
    assert ended["success"].values.tolist() == [0, 1]
    assert str(ended["status"].values[0]) != "solved" and str(ended["grade"].values[0]) == "failed"
    assert np.isfinite(ended["x"].values).all()


@pytest.mark.costly
def test_seeds_and_starts_are_those_of_each_solve() -> None:
    found = sweep("push-1d", {"M": [1.0, 2.0]}, "exact", params=SHORT, n_starts=2, seed=3)
    for M in (1.0, 2.0):
        session = SolveRequest("push-1d", {**SHORT, "M": M}, "exact").session()
        alone = solve_session(session, 2, 3)
        assert float(found["cost"].sel(M=M)) == alone.cost
        assert int(found["iterations"].sel(M=M)) == alone.iterations


@pytest.mark.costly
def test_a_law_that_is_made_is_the_law_by_name_and_keywords_find_their_owner() -> None:
    made = sweep("push-1d", {"M": [1.0, 2.0]}, Barrier(mu=1e-2), params=SHORT)
    named = sweep("push-1d", {"M": [1.0, 2.0]}, "barrier", mu=1e-2, params=SHORT)
    assert same(made, named)
    assert same(named, sweep(get("push-1d").name, {"M": "1:2:2"}, "barrier", mu=1e-2, N=6))
    assert set(made.data_vars) >= TIMES


def test_what_a_sweep_cannot_take_is_told() -> None:
    with pytest.raises(InputError, match="push-1d is built already, and a sweep builds it at every"):
        sweep(get("push-1d"), {"M": [1.0, 2.0]})
    with pytest.raises(InputError, match="no argument 'm'"):
        sweep("push-1d", {"M": [1.0, 2.0]}, m=2.0)
    with pytest.raises(InputError, match="M is swept by --over"):
        sweep("push-1d", {"M": [1.0, 2.0]}, M=2.0)
