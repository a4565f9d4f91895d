"""The volatility that explains the price of an American put option, whose holder stops at the best time."""

import casadi as ca
import numpy as np

import ocp
from ocp import complements

strike, rate, T, steps, nodes = 100.0, 0.05, 0.5, 10, 24
prices = np.linspace(50, 165, nodes)
dS, dt = prices[1] - prices[0], T / steps
payoff = np.maximum(strike - prices, 0)

opti = ca.Opti()
V = opti.variable(nodes - 2, steps)  # value inside the grid at each step before the end
variance = opti.variable()
S = prices[1:-1]
for n in range(steps):
    now = ca.vertcat(payoff[0], V[:, n], 0)
    later = V[:, n - 1] if n else payoff[1:-1]
    gain = 0.5 * variance * S**2 * (now[2:] - 2 * now[1:-1] + now[:-2]) / dS**2
    gain += rate * S * (now[2:] - now[:-2]) / (2 * dS) - rate * now[1:-1]
    # Waiting loses nothing, or stopping is no worse. Before: (V - payoff) * loss <= 1e-6
    opti.subject_to(complements(V[:, n] - payoff[1:-1], V[:, n] - later - dt * gain))
at_the_money = V[9, steps - 1]  # at a price of 100
opti.subject_to(opti.bounded(0.01, variance, 1))
opti.minimize((at_the_money - 7.5) ** 2)
opti.set_initial(V, np.tile(payoff[1:-1, None] + 3, (1, steps)))
opti.set_initial(variance, 0.05)

sol = ocp.opti(opti).solve()
print(sol.verdict)
stops = sol.value(V[:, steps - 1]) <= payoff[1:-1] + 1e-6
print("volatility", np.sqrt(sol.value(variance)), "stop at prices below", S[stops].max())
