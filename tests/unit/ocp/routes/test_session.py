"""Sessions with changed fields: values of common parameters are carried over."""

from dataclasses import replace

from dynamics.contact import Barrier, Exact
from ocp.problem.policy import OpenLoop
from ocp.routes.session import Session
from ocp.transcription import Direct
from problems import get


def test_a_changed_session_carries_the_values_that_it_has() -> None:
    smooth = Session(get("push-1d", N=3), Barrier(mu=0.05), Direct(), OpenLoop())
    smooth.values |= {"M": 3.0, "contact.mu": 0.02}
    exact = smooth.with_changes({"h": 0.05, "contact.mu": 0.01}, law=Exact(), search=False)
    assert (exact.values["M"], exact.values["h"]) == (3.0, 0.05) and "contact.mu" not in exact.values
    assert exact.search is False and smooth.search is None
    longer = smooth.with_changes(problem=replace(smooth.problem, N=5))
    assert longer.values == smooth.values and longer.problem.N == 5


def test_a_swept_session_keeps_its_values_and_is_made_once() -> None:
    session = Session(get("push-1d", N=3), Exact(), Direct(), OpenLoop())
    session.values["M"] = 3.0
    swept = session.as_swept()
    assert swept.problem.swept and swept.values == session.values and not session.problem.swept
    assert swept.as_swept() is swept
