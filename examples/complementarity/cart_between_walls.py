"""A cart is pushed from one wall to the other and back, with impacts that absorb its speed."""

import casadi as ca

import ocp
from ocp import complements

N, h, m, wall = 20, 0.1, 1.0, 0.5

opti = ca.Opti()
q, v = opti.variable(N + 1), opti.variable(N + 1)
u = opti.variable(N)
left, right = opti.variable(N), opti.variable(N)
opti.subject_to([q[0] == 0, v[0] == 1.5, q[N] == -0.5, v[N] == 0])
for k in range(N):
    opti.subject_to(m * (v[k + 1] - v[k]) == h * u[k] + left[k] - right[k])
    opti.subject_to(q[k + 1] == q[k] + h * v[k + 1])
    # Before: left[k] >= 0, q[k + 1] + wall >= 0, left[k] * (q[k + 1] + wall) <= 1e-6
    opti.subject_to(complements(left[k], q[k + 1] + wall))
    opti.subject_to(complements(right[k], wall - q[k + 1]))
opti.minimize(h * ca.sumsqr(u))
opti.set_initial(q, 0.1)

sol = ocp.opti(opti).solve()
print(sol.verdict)
print("impulses at the right wall [N s]:", sol.value(right).round(3))
