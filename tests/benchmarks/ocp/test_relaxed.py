"""Set-up and solve of one relaxed NLP, ``lam gap = mu``, against a plain Opti script."""

from __future__ import annotations

import pytest

from dynamics.contact import Barrier
from ocp.routes.homotopy import RouteResult
from tests.benchmarks.ocp.cases import FIVE, LCS, same_guess, session
from tests.benchmarks.ocp.models import MODELS
from tests.benchmarks.ocp.opti_peer import PeerAnswer, relaxed
from tests.benchmarks.ocp.race import alternate, ms, tell

MU = 1e-3
CASES = [
    *((name, None, 1.0, 5) for name in FIVE),
    *((name, N, 2.0, 3) for name in ("push-disc", LCS) for N in (100, 400)),
]


def ours(name: str, N: int | None) -> tuple[RouteResult, float]:
    """Do everything from the problem's parameters to the solution; return it and the set-up time [s]."""
    made = session(name, Barrier(mu=MU), N, homotopy=False)
    return made.solve(), made.build_s


@pytest.mark.bench
def test_relaxed_nlp_against_a_plain_script() -> None:
    """Both have the same NLP, mu, guess and IPOPT options; N is the problem's own if none is given.

    Ratios are the script's time over the workbench's; ``bounds`` is that of the script with
    ``detect_simple_bounds``, which makes its iterations the same.
    """
    rows, slow, worse = [], [], []
    for name, N, floor, rounds in CASES:
        model = MODELS[name]() if N is None else MODELS[name](N)
        guess = same_guess(session(name, Barrier(mu=MU), N))
        runs = {
            "ours": lambda n=name, k=N: ours(n, k),
            "script": lambda m=model, g=guess: relaxed(m, g, MU),
        }
        if model.N <= 100:
            runs["bounds"] = lambda m=model, g=guess: relaxed(m, g, MU, simple_bounds=True)
        seconds, found = alternate(runs, rounds)
        (outcome, _), script = found["ours"], found["script"]
        assert isinstance(script, PeerAnswer)
        assert outcome.result.ok and script.ok
        ratio = seconds["script"] / seconds["ours"]
        bounds = f"{seconds['bounds'] / seconds['ours']:.1f}" if "bounds" in seconds else ""
        rows.append(
            [
                name,
                model.N,
                f"{outcome.result.f:.6g} / {script.cost:.6g}",
                f"{outcome.trace.iterations} / {script.iterations}",
                f"{ms(seconds['ours'])} / {ms(seconds['script'])}",
                f"{ratio:.1f}",
                f"{floor:g}",
                bounds,
            ]
        )
        slow += [(name, model.N, ratio)] if ratio < floor else []
        worse += [name] if outcome.result.f > script.cost * 1.005 else []
    columns = ["ours / script", "N", "cost", "iterations", "ms", "ratio", "floor", "bounds"]
    tell(f"Relaxed NLP, mu = {MU:g}: set-up plus solve", columns, rows)
    assert not worse
    assert not slow
