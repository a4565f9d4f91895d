"""A block on a rough table is pushed to a place and stopped by friction alone."""

import casadi as ca

import ocp
from ocp import complements

N, h, m, limit = 25, 0.1, 1.0, 2.0  # limit is friction coefficient times weight [N]

opti = ca.Opti()
q, v = opti.variable(N + 1), opti.variable(N + 1)
u, friction = opti.variable(N), opti.variable(N)
opti.subject_to([q[0] == 0, v[0] == 0, q[N] == 1, v[N] == 0])
for k in range(N):
    opti.subject_to(m * (v[k + 1] - v[k]) == h * (u[k] + friction[k]))
    opti.subject_to(q[k + 1] == q[k] + h * v[k + 1])
    # Before: slip speeds of both directions with products such as slip * (limit - friction) <= 1e-6
    opti.subject_to(complements(v[k + 1], friction[k], lower=-limit, upper=limit))
opti.subject_to(opti.bounded(0, u, 6))
opti.minimize(h * ca.sum1(u))
opti.set_initial(q, 0.5)
opti.set_initial(u, 1)

sol = ocp.opti(opti).solve()
print(sol.verdict)
print("push [N]:", sol.value(u).round(3))
