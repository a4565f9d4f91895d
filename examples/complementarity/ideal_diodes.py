"""Ideal diodes rectify a voltage; which capacitor keeps the ripple small at the least cost?"""

import casadi as ca
import numpy as np

import ocp
from ocp import complements

N, period, R = 40, 0.02, 100.0
h = period / N
source = 10 * np.sin(2 * np.pi * np.arange(1, N + 1) / N)

opti = ca.Opti()
V = opti.variable(N)  # voltage of the capacitor at the end of each step
up, down = opti.variable(N), opti.variable(N)  # currents of the two pairs of diodes [A]
C = opti.variable()  # capacitance [mF]
for k in range(N):
    before = V[k - 1] if k else V[N - 1]  # periodic
    opti.subject_to(1e-3 * C * (V[k] - before) == h * (up[k] + down[k] - V[k] / R))
    # Before: up[k] >= 0, V[k] - source[k] >= 0, up[k] * (V[k] - source[k]) <= 1e-6
    opti.subject_to(complements(up[k], V[k] - source[k]))
    opti.subject_to(complements(down[k], V[k] + source[k]))
opti.subject_to(V >= 8)
opti.subject_to(opti.bounded(0.01, C, 10))
opti.minimize(C)
opti.set_initial(V, 9)
opti.set_initial(C, 1)

sol = ocp.opti(opti).solve()
print(sol.verdict)
print("capacitance [mF]:", sol.value(C), "voltages from", sol.value(V).min(), "to", sol.value(V).max())
