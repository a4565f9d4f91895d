"""A leader sells in a market where followers, each with a cost and a capacity, answer with Cournot's equilibrium."""

import casadi as ca
import numpy as np

import ocp
from ocp import complements

a = 12.0  # price at no sale; the price is a minus all that is sold
cost = np.array([2.0, 3.0, 9.0])
capacity = np.array([1.0, 5.0, 5.0])

opti = ca.Opti()
x = opti.variable()
y = opti.variable(3)
price = a - x - ca.sum1(y)
opti.subject_to(opti.bounded(0, x, 10))
# Before: each follower's KKT conditions with products such as y * slack <= 1e-6.
opti.subject_to(complements(cost + y - price, y, upper=capacity))
opti.minimize(-x * (price - 1))
opti.set_initial(x, 3)

sol = ocp.opti(opti).solve()
print(sol.verdict)
print("leader and followers sell", sol.value(x), sol.value(y))
