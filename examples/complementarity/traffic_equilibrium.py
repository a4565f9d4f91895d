"""A toll on the shortcut of Braess's network makes drivers choose the routes of the least total time."""

import casadi as ca

import ocp
from ocp import complements

demand = 6.0  # thousand cars an hour

opti = ca.Opti()
routes = opti.variable(3)  # upper, lower, shortcut
time, toll = opti.variable(), opti.variable()
upper, lower, shortcut = routes[0], routes[1], routes[2]
first, last = upper + shortcut, lower + shortcut  # cars on the two narrow roads
cost = ca.vertcat(10 * first + upper + 50, 10 * last + lower + 50, 10 * first + 10 * last + shortcut + 10 + toll)
opti.subject_to(ca.sum1(routes) == demand)
opti.subject_to(opti.bounded(0, toll, 50))
# Wardrop: used routes cost the same, others no less. Before: routes * (cost - time) <= 1e-6
opti.subject_to(complements(routes, cost - time))
total = routes.T @ cost - toll * shortcut
opti.minimize(total + 0.001 * toll)
opti.set_initial(routes, 2)
opti.set_initial(time, 90)

sol = ocp.opti(opti).solve()
print(sol.verdict)
print("toll", sol.value(toll), "routes", sol.value(routes), "mean time", sol.value(total) / demand)
