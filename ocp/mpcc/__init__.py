"""Mathematical programs with complementarity constraints in CasADi: stated, solved and certified.

The follower of a bilevel problem chooses y to minimise ``(y - x)²`` subject to ``y <= p``; with the
multiplier s of this bound, the optimality condition is ``y - x + s = 0``, ``0 <= s ⟂ p - y >= 0``. The leader
chooses x::

    import casadi as ca
    from ocp.mpcc import MPCC, solve

    x, y, s, p = (ca.SX.sym(name) for name in "xysp")
    problem = MPCC(
        x=ca.vertcat(x, y, s),
        p=p,
        f=(x - 2) ** 2 + (y - 3) ** 2,
        g=y - x + s,
        G=s,
        H=p - y,
        names=["follower's bound"],
    )
    solution = solve(problem, x0=[0.0, 0.0, 0.0], p=[1.0])
    print(solution.verdict)
    print(solution.x, solution.f, solution.certificate.stationarity)
"""

from ocp.mpcc.programs import MPCC
from ocp.mpcc.solving import DEFAULTS, MPCCSolution, solve

__all__ = ["DEFAULTS", "MPCC", "MPCCSolution", "solve"]
