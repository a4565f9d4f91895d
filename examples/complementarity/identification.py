"""The weights of a controller are identified from what it did: its inputs minimise a cost within bounds."""

import casadi as ca
import numpy as np

import ocp
from ocp import complements

# The controller chooses |u| <= 1 to minimise weight[0] (x + u[0] + u[1])² + weight[1] u[0]² + u[1]².
states = np.array([0.5, -1.0, 2.0, 4.0])
observed = np.array([[-0.1, 0.2, -0.4, -0.85], [-0.2, 0.4, -0.8, -1.0]])

opti = ca.Opti()
weight = opti.variable(2)
u = opti.variable(2, 4)
slope = ca.vertcat(
    *[2 * (weight[0] * (states.reshape(1, 4) + u[0, :] + u[1, :]) + w * u[i, :]) for i, w in ((0, weight[1]), (1, 1.0))]
)
opti.subject_to(opti.bounded(0.01, weight, 100))
# Before: multipliers of both bounds for every input, each with a product <= 1e-6.
opti.subject_to(complements(slope, u, lower=-1, upper=1))
opti.minimize(ca.sumsqr(u - observed))
opti.set_initial(weight, 1)
opti.set_initial(u, observed)

sol = ocp.opti(opti).solve()
print(sol.verdict)
print("weights", sol.value(weight), "inputs", sol.value(u).round(4))
