"""Interacting multiple models written down again: matrices, inverses, no structure used."""

import numpy as np

SHARED = 6
FLOOR = 1e-8  # variance that the tracker adds to a measurement


def numpy_model(kind, *, q=0.5, jerk=0.2, turn=0.1):
    """The number of states, x -> f(x, dt) and the covariance of the noise over dt of a motion model."""
    eye = np.eye(3)
    if kind == "velocity":
        return 6, lambda x, dt: np.kron([[1, dt], [0, 1]], eye) @ x, lambda dt: q * white(2, dt, 3)
    if kind == "acceleration":
        F = lambda dt: np.kron([[1, dt, dt**2 / 2], [0, 1, dt], [0, 0, 1]], eye)  # noqa: E731
        return 9, lambda x, dt: F(dt) @ x, lambda dt: jerk * white(3, dt, 3)
    noise = np.zeros((7, 7))
    noise[6, 6] = turn

    def Q(dt):
        result = noise * dt
        result[:6, :6] = q * white(2, dt, 3)
        return result

    return 7, turned, Q


def white(order, dt, axes):
    """Of the chain of `order` integrators of unit white noise, per axis: int e(s) e(s)' ds by Gauss's rule."""
    node, weight = np.polynomial.legendre.leggauss(4)
    total = np.zeros((order, order))
    for s, w in zip((node + 1) / 2 * dt, weight / 2 * dt, strict=True):
        e = np.array([s**k / [1, 1, 2][k] for k in range(order)][::-1])
        total += w * np.outer(e, e)
    return np.kron(total, np.eye(axes))


def turned(x, dt):
    """Position and velocity after a turn about z, by the integral of the turning velocity."""
    p, v, omega = x[:3], x[3:6], x[6]
    node, weight = np.polynomial.legendre.leggauss(8)

    def rotated(s):
        c, n = np.cos(omega * s), np.sin(omega * s)
        return np.array([c * v[0] - n * v[1], n * v[0] + c * v[1], v[2]])

    moved = sum(w / 2 * dt * rotated((s + 1) / 2 * dt) for s, w in zip(node, weight, strict=True))
    return np.concatenate([p + moved, rotated(dt), [omega]])


def jacobian(f, x, dt):
    """By complex steps: exact to rounding."""
    columns = [f(x + 1e-30j * e, dt).imag / 1e-30 for e in np.eye(len(x))]
    return np.array(columns).T


class Reference:
    """An IMM of one target; `models` are names, the rest as in `TrackerOptions`."""

    def __init__(
        self, models, transition, prior, *, lent, mixes=True, start=(4, 25, 25), cross=100.0, turn=0.1
    ):
        self.models = [numpy_model(m) for m in models]
        self.kinds = models
        self.transition, self.mu = np.array(transition), np.array(prior, float)
        self.lent, self.mixes, self.start_options = lent, mixes, (start, cross, turn)

    def start(self, z, R, los=None, rate=None, sigma=0.1):
        """The first detection."""
        (pos, vel, acc), cross, turn = self.start_options
        P = np.zeros((6, 6))
        P[:3, :3] = R + (FLOOR + pos) * np.eye(3)
        P[3:, 3:] = vel * np.eye(3)
        v = np.zeros(3)
        if los is not None:
            along = np.outer(los, los)
            P[3:, 3:] = (sigma**2 + FLOOR) * along + cross * (np.eye(3) - along)
            v = rate * los
        x = np.concatenate([z, v])
        self.x, self.P = [], []
        for kind, (n, _, _) in zip(self.kinds, self.models, strict=True):
            extra = {"velocity": 0.0, "acceleration": acc, "turn": turn}[kind]
            self.x.append(np.concatenate([x, np.zeros(n - 6)]))
            self.P.append(
                np.block([[P, np.zeros((6, n - 6))], [np.zeros((n - 6, 6)), extra * np.eye(n - 6)]])
            )

    def predict(self, dt):
        """Mixing, then every model by dt."""
        c = self.mu @ self.transition
        if self.mixes:
            mixed = []
            for j, (n, _, _) in enumerate(self.models):
                weight = self.transition[:, j] * self.mu / c[j] if c[j] > 0 else np.eye(len(c))[j]
                xs, Ps = zip(*(self.seen_by(i, j) for i in range(len(c))), strict=True)
                mixed.append(moments(weight, xs, Ps))
            self.x, self.P = map(list, zip(*mixed, strict=True))
        self.mu = c
        self.x, self.P = self.ahead(dt)

    def seen_by(self, i, j):
        """State of model i in the space of model j."""
        n = self.models[j][0]
        if i == j:
            return self.x[i], self.P[i]
        x, P = np.zeros(n), self.lent[self.kinds[j]] * np.eye(n)
        x[:SHARED], P[:SHARED, :SHARED] = self.x[i][:SHARED], self.P[i][:SHARED, :SHARED]
        return x, P

    def ahead(self, dt):
        """States of all models after dt."""
        xs, Ps = [], []
        for (_, f, Q), x, P in zip(self.models, self.x, self.P, strict=True):
            F = jacobian(f, x, dt)
            xs.append(f(x, dt)), Ps.append(F @ P @ F.T + Q(dt))
        return xs, Ps

    def correct(self, z, R, los=None, rate=None, sigma=0.1):
        """Every model by one detection, then the probabilities."""
        log = np.zeros(len(self.models))
        for j, (n, _, _) in enumerate(self.models):
            H, y, noise = np.eye(3, n), z, R + FLOOR * np.eye(3)
            if los is not None:
                row = np.concatenate([np.zeros(3), los, np.zeros(n - 6)])
                H, y = np.vstack([H, row]), np.append(z, rate)
                noise = np.block(
                    [[noise, np.zeros((3, 1))], [np.zeros((1, 3)), np.eye(1) * (sigma**2 + FLOOR)]]
                )
            S = H @ self.P[j] @ H.T + noise
            gain, left = self.P[j] @ H.T @ np.linalg.inv(S), y - H @ self.x[j]
            log[j] = -0.5 * (left @ np.linalg.solve(S, left) + np.linalg.slogdet(2 * np.pi * S)[1])
            self.x[j] = self.x[j] + gain @ left
            self.P[j] = self.P[j] - gain @ S @ gain.T
        mu = self.mu * np.exp(log - log.max())
        self.mu = mu / mu.sum()

    def read(self, dt=0.0):
        """(p, v), its covariance and the acceleration of the mixture after dt."""
        xs, Ps = self.ahead(dt)
        x, P = moments(self.mu, [x[:SHARED] for x in xs], [P[:SHARED, :SHARED] for P in Ps])
        a = sum(m * accelerated(kind, state) for m, kind, state in zip(self.mu, self.kinds, xs, strict=True))
        return x, P, a


def accelerated(kind, x):
    """The acceleration that a state stands for."""
    if kind == "velocity":
        return np.zeros(3)
    return x[6:9] if kind == "acceleration" else np.cross([0, 0, x[6]], x[3:6])


def moments(weight, xs, Ps):
    """Mean and covariance of a mixture of normal distributions."""
    mean = sum(w * x for w, x in zip(weight, xs, strict=True))
    return mean, sum(w * (P + np.outer(x - mean, x - mean)) for w, x, P in zip(weight, xs, Ps, strict=True))
