"""The tracker against Stone Soup.

Stone Soup keeps the derivatives of an axis together (x, vx, y, vy, z, vz) and time in microseconds.
"""

import datetime

import numpy as np
import pytest
from stonesoup.dataassociator.neighbour import GNNWith2DAssignment
from stonesoup.hypothesiser.distance import DistanceHypothesiser
from stonesoup.measures import Mahalanobis
from stonesoup.models.measurement.linear import LinearGaussian
from stonesoup.models.transition.linear import (
    CombinedLinearGaussianTransitionModel,
    ConstantAcceleration,
    ConstantVelocity,
)
from stonesoup.predictor.kalman import KalmanPredictor
from stonesoup.types.detection import Detection
from stonesoup.types.state import GaussianState
from stonesoup.types.track import Track
from stonesoup.updater.kalman import KalmanUpdater

from support.flights.tracked import SIGMA, scan, tracker

START = datetime.datetime(2000, 1, 1)
DT = 0.05
FLOOR = 1e-8  # variance that the tracker adds to a measurement


def at(k):
    return START + datetime.timedelta(seconds=k * DT)


@pytest.mark.parametrize("order", [2, 3])
def test_two_targets_are_associated_and_filtered_as_by_stone_soup(order):
    """Nearest neighbours and one linear model; beliefs agree to rounding, names to the letter."""
    axis = ConstantVelocity(0.5) if order == 2 else ConstantAcceleration(0.2)
    sensor = LinearGaussian(3 * order, [0, order, 2 * order], (SIGMA**2 + FLOOR) * np.eye(3))
    predictor = KalmanPredictor(CombinedLinearGaussianTransitionModel([axis] * 3))
    updater = KalmanUpdater(sensor, use_joseph_cov=True)
    associator = GNNWith2DAssignment(
        DistanceHypothesiser(predictor, updater, Mahalanobis(), missed_distance=np.sqrt(30))
    )
    ours = tracker(transition=(1, 0, 0, 1), prior=(1, 0) if order == 2 else (0, 1))
    order_of = [axis_ * order + derivative for derivative in (0, 1) for axis_ in range(3)]

    rng = np.random.default_rng(1)
    v = np.array([[-5.0, 2.0, 0.0], [-5.0, -2.0, 0.2]])
    truth = np.array([[20.0, -4.0, 5.0], [20.0, 4.0, 4.0]])
    theirs = []
    for k in range(80):
        seen = rng.uniform(size=2) < (0.9 if k else 1.1)
        z = (truth + v * k * DT + SIGMA * rng.normal(size=(2, 3)))[seen]
        scan(ours, k * DT, z)
        if k == 0:
            P = np.diag([SIGMA**2 + FLOOR + 4, 25, 25][:order])
            for p in z:
                x = np.kron(p[:, None], np.eye(order)[:, :1])
                theirs.append(Track([GaussianState(x, np.kron(np.eye(3), P), timestamp=at(0))]))
        else:
            detections = {Detection(p[:, None], timestamp=at(k), measurement_model=sensor) for p in z}
            for track, hypothesis in associator.associate(set(theirs), detections, at(k)).items():
                track.append(updater.update(hypothesis) if hypothesis else hypothesis.prediction)
        got = ours.tracks(k * DT)
        assert got["id"].tolist() == [1, 2]
        for i, track in enumerate(theirs):
            x, P = np.ravel(track.state_vector)[order_of], track.covar[np.ix_(order_of, order_of)]
            assert np.hstack([got["p"][i], got["v"][i]]) == pytest.approx(x.astype(float), abs=1e-9)
            assert got["covariance"][i] == pytest.approx(P.astype(float), abs=1e-9)
