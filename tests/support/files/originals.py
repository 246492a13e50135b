"""Random Gaussians in double precision, and how far decoded ones are from them, against the bound."""

from dataclasses import dataclass

import numpy as np


@dataclass
class Originals:
    mean: np.ndarray
    log_scale: np.ndarray
    quat: np.ndarray
    alpha: np.ndarray
    sh0: np.ndarray

    def __len__(self):
        return len(self.mean)


def single(values):
    """Single precision, in which writers get what they encode."""
    return np.asarray(values, np.float32).astype(np.float64)


def originals(count, seed=0, span=10.0, spread=2.0):
    rng = np.random.default_rng(seed)
    quat = rng.normal(size=(count, 4))
    return Originals(
        mean=single(rng.uniform(-span, span, (count, 3))),
        log_scale=single(rng.normal(-4.0, spread, (count, 3))),
        quat=quat / np.linalg.norm(quat, axis=1, keepdims=True),
        alpha=rng.uniform(0, 1, count),
        sh0=rng.normal(0, 1, (count, 3)),
    )


def angles(a, b):
    """Between the rotations of quaternions, without loss of digits near zero."""
    a, b = (q / np.linalg.norm(q, axis=1, keepdims=True) for q in (a.astype(np.float64), b))
    chord = np.minimum(np.linalg.norm(a - b, axis=1), np.linalg.norm(a + b, axis=1))
    return 4 * np.arcsin(np.minimum(chord / 2, 1))


def fractions(original, splats):
    """Largest share of the bound that is used, of position, scale and rotation; each must be at most 1."""
    bound = splats.loss.bound.astype(np.float64)
    away = np.linalg.norm(splats.mean.astype(np.float64) - original.mean, axis=1)
    longer = (np.exp(original.log_scale) / splats.scale.astype(np.float64) - 1).max(axis=1)
    # quaternions are handed over in single precision: import_splat and what follows see those
    turn = angles(splats.quat_wxyz, original.quat) - 4e-7
    assert np.abs(splats.opacity - original.alpha).max() <= splats.loss.opacity + 1e-7
    return [(measured / bound[:, i]).max() for i, measured in enumerate((away, longer, turn))]
