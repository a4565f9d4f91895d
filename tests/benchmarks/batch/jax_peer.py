"""The same rollouts in JAX, by jit of `lax.map` over vmapped blocks of samples."""

from __future__ import annotations

from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

jax.config.update("jax_enable_x64", True)
BLOCKS = (16, 64, 256, 1024)


def blocked(cost: Callable, theta: np.ndarray, block: int) -> Callable[[], object]:
    """Return a call for cost and gradient of every sample theta (n, N, nu), block by block."""
    whole = jax.vmap(jax.value_and_grad(cost))
    fn = jax.jit(lambda t: lax.map(whole, t.reshape(-1, block, *t.shape[1:])))
    samples = jnp.asarray(theta)
    return lambda: jax.block_until_ready(fn(samples))


def wall(p: np.ndarray) -> Callable:
    """Return the cost function of wall-1d under the barrier law; p as in wall_peer.c."""
    m, h, x0, v0, goal, wx, wv, wu, we, mu = (float(value) for value in p)
    F = h / m

    def step(carry, u):
        x, v, total = carry
        total += wx * (x - goal) ** 2 + wv * v**2 + wu * u[0] ** 2
        w = v + u[0] / m
        z = x + h * w
        r = jnp.sqrt(z * z + 4 * F * mu)
        v = w + jnp.where(z > 0, 2 * mu / (jnp.where(z > 0, z, 1.0) + r), (r - z) / (2 * F)) / m
        return (x + h * v, v, total), None

    def cost(theta):
        (x, _, total), _ = lax.scan(step, (x0, v0, 0.0), theta)
        return total + we * (x - goal) ** 2

    return cost


def four_contacts(matrices: dict[str, np.ndarray], mu: float, x0: np.ndarray) -> Callable:
    """Return the four-contact system's cost, by interior point forward and implicit function backward."""
    A, B, C, D, E, F, d = (jnp.asarray(matrices[k]) for k in "ABCDEFd")
    n = len(d)

    def solve(M, b):
        rows, right = [[M[i, j] for j in range(n)] for i in range(n)], [b[i] for i in range(n)]
        for k in range(n):
            for i in range(k + 1, n):
                f = rows[i][k] / rows[k][k]
                rows[i] = [a - f * c for a, c in zip(rows[i], rows[k], strict=True)]
                right[i] = right[i] - f * right[k]
        for k in reversed(range(n)):
            known = sum(rows[k][j] * right[j] for j in range(k + 1, n))
            right[k] = (right[k] - known) / rows[k][k]
        return jnp.stack(right)

    @jax.custom_vjp
    def contact(z):
        def newton(state):
            lam, s, count = state
            target = jnp.maximum(mu, 0.1 * jnp.mean(lam * s))
            defect = z + F @ lam - s
            step = solve(jnp.diag(s) + lam[:, None] * F, target - lam * s - lam * defect)
            step_s = F @ step + defect
            worst = jnp.max(jnp.concatenate((-step / lam, -step_s / s)))
            length = 1 / jnp.maximum(1.0, worst / 0.99)
            return lam + length * step, s + length * step_s, count + 1

        def going(state):
            lam, s, count = state
            off = jnp.max(jnp.abs(lam * s - mu)) + jnp.max(jnp.abs(z + F @ lam - s))
            return (off > 1e-12) & (count < 40)

        return lax.while_loop(going, newton, (jnp.ones(n), jnp.ones(n), 0))[0]

    def forward(z):
        lam = contact(z)
        return lam, (lam, z)

    def backward(kept, bar):
        lam, z = kept
        s = z + F @ lam
        return (-lam * solve((jnp.diag(s) + lam[:, None] * F).T, bar),)

    contact.defvjp(forward, backward)

    def step(carry, u):
        x, total = carry
        total += 0.1 * jnp.sum(u * u) + 0.01 * jnp.sum(x * x)
        lam = contact(D @ x + E @ u + d)
        return (A @ x + B @ u + C @ lam, total), None

    def cost(theta):
        (x, total), _ = lax.scan(step, (jnp.asarray(x0), 0.0), theta)
        return total + 5 * jnp.sum((x - 1) ** 2)

    return cost
