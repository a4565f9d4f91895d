"""A compressor feeds two consumers through pipes and a check valve; how little pressure is enough?"""

import casadi as ca

import ocp
from ocp import complements

# Squared pressures fall by k q |q| along a pipe (Weymouth); nodes: source, valve's inlet, valve's outlet.
k1, k2, k3 = 1.0, 0.5, 2.0
demand = (1.0, 2.0)

opti = ca.Opti()
p = opti.variable(3)  # squared pressures [bar²]
forward, backward = opti.variable(3), opti.variable(3)  # flows of the pipes in both directions
valve, drop = opti.variable(), opti.variable()
storage = opti.variable()  # flow out of a storage behind the valve, at a squared pressure of 30 bar²
flow = forward - backward
law = ca.vertcat(k1, k2, k3) * (forward**2 - backward**2)
opti.subject_to(flow[0] == demand[0] + valve)
opti.subject_to(valve + storage == flow[1])
opti.subject_to([flow[1] == demand[1], flow[2] == storage])
opti.subject_to([p[0] - p[1] == law[0], p[1] + drop == p[2]])
opti.subject_to([p[2] - law[1] >= 20, 30 - p[2] == law[2]])
# Before: valve >= 0, drop >= 0, valve * drop <= 1e-6, and forward * backward <= 1e-6.
opti.subject_to(complements(valve, drop))
opti.subject_to(complements(forward, backward))
opti.subject_to([p >= 1, storage >= 0])
opti.minimize(p[0] + 20 * storage)
opti.set_initial(p, 25)

sol = ocp.opti(opti).solve()
print(sol.verdict)
print("squared pressures", sol.value(p), "valve", sol.value(valve), "storage", sol.value(storage))
