"""Weights of an elastic net are chosen by the error on held-out data; the fit is the lower problem's KKT conditions."""

import casadi as ca
import numpy as np

import ocp
from ocp import complements

rng = np.random.default_rng(11)
truth = np.array([2.0, -1.0, 0.0, 0.0, 0.5])
A, B = rng.normal(size=(12, 5)), rng.normal(size=(30, 5))
train, held_out = A @ truth + rng.normal(size=12), B @ truth + rng.normal(size=30)

opti = ca.Opti()
plus, minus = opti.variable(5), opti.variable(5)  # parts of the coefficients
l1, l2 = opti.variable(), opti.variable()
w = plus - minus
slope = A.T @ (A @ w - train) + l2 * w
opti.subject_to(opti.bounded(0.01, l1, 20))
opti.subject_to(opti.bounded(0.01, l2, 20))
# Before: plus >= 0, slope + l1 >= 0, plus * (slope + l1) <= 1e-6, and the same for minus.
opti.subject_to(complements(plus, slope + l1))
opti.subject_to(complements(minus, l1 - slope))
opti.minimize(ca.sumsqr(B @ w - held_out) / 30)
opti.set_initial(l1, 1)
opti.set_initial(l2, 1)

sol = ocp.opti(opti).solve()
print(sol.verdict)
print("weights", sol.value(l1), sol.value(l2), "coefficients", sol.value(w).round(4))
