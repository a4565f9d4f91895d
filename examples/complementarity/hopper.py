"""A leg pushes a mass off the ground, so that it lands on a step with the least effort."""

import casadi as ca

import ocp
from ocp import complements

N, h, m, g, rest = 30, 0.05, 1.0, 9.81, 0.5

opti = ca.Opti()
y, v = opti.variable(N + 1), opti.variable(N + 1)  # height and speed of the mass
leg, f = opti.variable(N + 1), opti.variable(N)  # length of the leg, force of the ground
opti.subject_to([y[0] == rest, v[0] == 0, y[N] == rest, v[N] == 0, f[N - 1] == m * g])
for k in range(N):
    opti.subject_to(v[k + 1] == v[k] + h * (f[k] / m - g))
    opti.subject_to(y[k + 1] == y[k] + h * v[k + 1])
    opti.subject_to(opti.bounded(0.2, leg[k + 1], rest))
    # Before: f[k] >= 0, y[k + 1] - leg[k + 1] >= 0, f[k] * (y[k + 1] - leg[k + 1]) <= 1e-4
    opti.subject_to(complements(f[k], y[k + 1] - leg[k + 1]))
opti.subject_to(f <= 40)
opti.subject_to(y[N // 2] >= 0.9)
opti.minimize(h * ca.sumsqr(f))
opti.set_initial(y, rest)
opti.set_initial(leg, rest)
opti.set_initial(f, m * g)

sol = ocp.opti(opti).solve()
print(sol.verdict)
print("time off the ground [s]:", h * float((sol.value(f) < 1e-6).sum()))
