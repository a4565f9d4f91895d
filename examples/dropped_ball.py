"""A ball dropped on a floor by explicit steps with a spring as contact: is its gradient right?"""

import numpy as np

# The question: derivative of the last place x by the vertical speed v at the start.
theta = [-1.03]
parameters = "v [m/s] vertical speed"
outputs = "x [m] place of rest"
sharper = {"h": 0.5, "stiffness": 4.0}  # one refinement multiplies the settings by these factors

GRAVITY, FRICTION, HEIGHT, SPEED, DURATION = 9.81, 0.2, 0.5, 1.0, 0.6


def rollout(theta, h=1e-3, stiffness=1e4):
    """Simulate n balls at once: theta (n, 1) are their parameters, the result (n, 1) is where they rest."""
    vz, z = theta[:, 0].copy(), np.full(len(theta), HEIGHT)
    vx, x = np.full(len(theta), SPEED), np.zeros(len(theta))
    for _ in range(round(DURATION / h)):
        force = np.where(z < 0, np.maximum(-stiffness * z - 2 * np.sqrt(stiffness) * vz, 0), 0)
        vx = vx - h * FRICTION * force * np.clip(vx / 0.01, -1, 1)
        vz = vz + h * (force - GRAVITY)
        x, z = x + h * vx, z + h * vz
    return x[:, None]


# Optional, the derivative of rollout (n, outputs, parameters), by AD, for example: def gradient(theta): ...
def truth(theta):
    """The physics: a plastic impact takes FRICTION times the speed w off vx, and friction stops the rest."""
    v = theta[:, 0]
    w = np.sqrt(v**2 + 2 * GRAVITY * HEIGHT)
    rest = np.maximum(SPEED - FRICTION * w, 0)
    return (SPEED * (v + w) / GRAVITY + rest**2 / (2 * FRICTION * GRAVITY))[:, None]
