"""Interacting multiple models written down again: matrices, inverses, no structure used."""

import numpy as np
from scipy.special import gammaln
from scipy.stats import chi2

SHARED = 6
FLOOR = 1e-8  # variance that the tracker adds to a measurement


def numpy_model(kind, *, q=0.5, jerk=0.2, turn=0.1):
    """The number of states, x -> f(x, dt) and the covariance of the noise over dt of a motion model."""
    eye = np.eye(3)
    if kind == "velocity":
        return 6, lambda x, dt: np.kron([[1, dt], [0, 1]], eye) @ x, lambda dt: q * white(2, dt, 3)
    if kind == "acceleration":

        def F(dt):
            return np.kron([[1, dt, dt**2 / 2], [0, 1, dt], [0, 0, 1]], eye)

        return 9, lambda x, dt: F(dt) @ x, lambda dt: jerk * white(3, dt, 3)
    noise = np.zeros((7, 7))
    noise[6, 6] = turn

    def Q(dt):
        result = noise * dt
        result[:6, :6] = q * white(2, dt, 3)
        return result

    return 7, turned, Q


def white(order, dt, axes):
    """Covariance of unit white noise through `order` integrators: int e(s) e(s)' ds by Gauss's rule."""
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
    return np.concatenate([p + moved, rotated(dt), x[6:]])


def jacobian(f, x, dt):
    """By complex steps, all at once: exact to rounding."""
    return f(x[:, None] + 1e-30j * np.eye(len(x)), dt).imag / 1e-30


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
        self.winner = np.argmax(self.mu)
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
        transition = self.transition_now()
        c = self.mu @ transition
        if self.mixes:
            mixed = []
            for j in range(len(c)):
                weight = transition[:, j] * self.mu / c[j] if c[j] > 0 else np.eye(len(c))[j]
                xs, Ps = zip(*(self.seen_by(i, j) for i in range(len(c))), strict=True)
                mixed.append(moments(weight, xs, Ps))
            self.x, self.P = map(list, zip(*mixed, strict=True))
        self.mu = c
        self.x, self.P = self.ahead(dt)

    def transition_now(self):
        """The transition matrix of the next scan."""
        return self.transition

    def seen_by(self, i, j):
        """State of model i in the space of model j."""
        n = self.models[j][0]
        if i == j:
            return self.x[i], self.P[i]
        x, P = np.zeros(n), self.lent.get(self.kinds[j], 0.0) * np.eye(n)
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
        squared, volume = np.zeros(len(self.models)), np.zeros(len(self.models))
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
            squared[j], volume[j] = left @ np.linalg.solve(S, left), np.linalg.slogdet(S)[1]
            if self.updates(j, squared[j], len(y)):
                self.x[j] = self.x[j] + gain @ left
                self.P[j] = self.P[j] - gain @ S @ gain.T
        log = self.log_likelihood(squared, volume, len(y))
        mu = self.mu * np.exp(log - log.max())
        self.mu = mu / mu.sum()
        self.winner = np.argmax(self.mu)

    def updates(self, j, squared, size):
        """Whether a model takes a measurement at this squared distance."""
        return True

    def log_likelihood(self, squared, volume, size):
        """Of each model, from squared distances and logarithms of determinants of innovations."""
        return -0.5 * (squared + volume + size * np.log(2 * np.pi))

    def read(self, dt=0.0):
        """(p, v), its covariance and the acceleration of the mixture after dt."""
        xs, Ps = self.ahead(dt)
        x, P = moments(self.mu, [x[:SHARED] for x in xs], [P[:SHARED, :SHARED] for P in Ps])
        a = sum(m * accelerated(kind, state) for m, kind, state in zip(self.mu, self.kinds, xs, strict=True))
        return x, P, a


class SafeReference(Reference):
    """With all the additions of SAFE-IMM."""

    surprise = evidence = clear = 0.0
    jamming = False

    def __init__(self, *args, **kwargs):
        super().__init__(*args, **kwargs)
        self.seen = set()  # what happened

    def transition_now(self):
        """Leaning to where the evidence points."""
        n, base = len(self.mu), self.transition
        entropy = -np.sum(self.mu * np.log(self.mu))
        alpha = min(0.7, 0.1 * self.evidence + 0.5 * entropy / np.log(n))
        leaning, winner = base.copy(), self.winner
        moved = [(0, 1, 0.15 * alpha), (1, 0, 0.05 * (0.7 - alpha))]
        moved += [(winner, k, 0.1 * alpha / (n - 1)) for k in range(n) if k != winner]
        for source, to, share in moved:
            leaning[source] += share * (np.eye(n)[to] - np.eye(n)[source])
        blend = (1 - alpha) * base + alpha * leaning
        return blend / blend.sum(axis=1, keepdims=True)

    def updates(self, j, squared, size):
        """Within the gate, or the winner."""
        taken = j == self.winner or squared <= chi2.ppf(0.999, size) * (2 if self.jamming else 1)
        self.seen.update([] if taken else ["gated"])
        return taken

    def log_likelihood(self, squared, volume, size):
        """Of Student's t after an alarm."""
        self.surprise = np.clip(self.surprise + self.mu @ squared / size - 1.1, 0, 16)
        log = super().log_likelihood(squared, volume, size)
        if self.surprise > 8:
            self.seen.add("heavy")
            nu = 1 if self.jamming else 5
            scale = gammaln((nu + size) / 2) - gammaln(nu / 2) - size / 2 * np.log(nu * np.pi)
            log = scale - 0.5 * (volume + (nu + size) * np.log1p(squared / nu))
        self.evidence = np.clip(self.evidence + log[1:].max() - log[0], 0, 20)
        return log

    def correct(self, *args, **kwargs):
        """And then whether the winner alone may be read."""
        super().correct(*args, **kwargs)
        self.clear = self.clear + 1 if self.bound() <= 1.95 and self.is_sure() else 0

    def is_sure(self):
        """Of the winner."""
        return self.mu.max() >= 0.6 or self.evidence >= 3

    def bound(self):
        """How far the winner's position can be from the mixture's [m]."""
        w = self.winner
        others = [j for j in range(len(self.mu)) if j != w]
        t = self.mu[others].sum()
        share = self.mu[others] / t
        spread = 0.5 * (
            self.P[w][:3, :3] + sum(s * self.P[j][:3, :3] for s, j in zip(share, others, strict=True))
        )
        off = [self.x[j][:3] - self.x[w][:3] for j in others]
        squared = sum(s * d @ np.linalg.solve(spread, d) for s, d in zip(share, off, strict=True))
        return t * np.sqrt(np.trace(spread) * squared)

    def read(self, dt=0.0):
        """The winner, or the mixture."""
        self.seen.add("soft" if self.clear < 2 else "hard")
        if self.clear < 2:
            return super().read(dt)
        mu, self.mu = self.mu, np.eye(len(self.mu))[self.winner]
        result = super().read(dt)
        self.mu = mu
        return result


def accelerated(kind, x):
    """The acceleration that a state stands for."""
    if kind == "velocity":
        return np.zeros(3)
    return x[6:9] if kind == "acceleration" else np.cross([0, 0, x[6]], x[3:6])


def moments(weight, xs, Ps):
    """Mean and covariance of a mixture of normal distributions."""
    mean = sum(w * x for w, x in zip(weight, xs, strict=True))
    return mean, sum(w * (P + np.outer(x - mean, x - mean)) for w, x, P in zip(weight, xs, Ps, strict=True))
