# Copyright 2026 selfcal_ros contributors
#
# Licensed under the Apache License, Version 2.0 (the "License");
# you may not use this file except in compliance with the License.
# You may obtain a copy of the License at
#
#     http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software
# distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
# See the License for the specific language governing permissions and
# limitations under the License.
"""
How far from independent are the errors? What the covariance of ideal noise cannot see.

Errors that the observations of one track, of one view or stretch of views, or of one region of
the image share (drift of a patch, a jolt, a lens that the model does not describe) do not average
out. Sums of influences
over such clusters measure what they do to the calibration (the cluster-robust covariance; Liang
and Zeger 1986; several ways of clustering: Cameron, Gelbach and Miller 2011).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

#: Image regions that errors may share, along the longer and the shorter side.
REGIONS = (8, 6)
#: Stretches of successive views that errors may share, such as a moving object in sight.
STRETCHES = 7
#: A way of clustering counts when the variance that it finds exceeds that of independent errors
#: by so many standard deviations of its own.
SIGNIFICANT = 4.0


@dataclass(frozen=True)
class Dependence:
    """
    Variance that clustered errors add, as ratios of sigma.

    Attributes
    ----------
    track, view, region : float
        Sigma of the calibration with errors shared in such clusters over sigma with independent
        errors, mean over the estimated parameters; 1 where nothing significant was found.
    covariance : ndarray, shape (k, k)
        Of the shared unknowns, dependence included.

    """

    track: float
    view: float
    region: float
    covariance: np.ndarray

    @property
    def inflation(self) -> float:
        """Ratio of sigma with all dependence to sigma with none."""
        return float(np.sqrt(1 + sum(ratio**2 - 1 for ratio in
                                     (self.track, self.view, self.region))))

    def notes(self) -> tuple:
        """Say what was found, a sentence each."""
        causes = ((self.track, 'a track', 'drift of its patch'),
                  (self.view, 'an image or a stretch of them', 'jolts, a rolling shutter, moving objects'),
                  (self.region, 'a region of the image', 'a lens that the distortion model does '
                   'not describe'))
        return tuple(f'Errors are shared within {cluster} ({cause}); sigmas are {ratio:.1f} times '
                     'those of independent errors for it.'
                     for ratio, cluster, cause in causes if ratio > 1)


def assess_dependence(evidence, track: np.ndarray, view: np.ndarray, xy: np.ndarray,
                      size: tuple[int, int]) -> Dependence:
    """
    Widen a covariance by the dependence that the residuals show.

    Parameters
    ----------
    evidence : selfcal_ros.calibration.bundle.Evidence
    track, view : ndarray of int, shape (N,)
    xy : ndarray, shape (N, 2)
        Pixels.
    size : (int, int)
        Width and height of the image.

    Returns
    -------
    Dependence

    """
    base = evidence.covariance[:evidence.influence.shape[1], :evidence.influence.shape[1]]
    sigma = np.sqrt(np.diag(base))
    free = np.flatnonzero(sigma > 0)
    # whitened: the identity for independent errors
    values, vectors = np.linalg.eigh(base[np.ix_(free, free)] / np.outer(sigma[free],
                                                                         sigma[free]))
    usable = values > 1e-10 * values[-1]
    whiten = (vectors[:, usable] / np.sqrt(values[usable])).T / sigma[free]
    effects = evidence.influence[:, free] @ whiten.T
    of_tracks = effects / np.sqrt(evidence.track_share)
    effects /= np.sqrt(evidence.freedom_share)
    unwhiten = np.linalg.pinv(whiten)

    along, across = REGIONS if size[0] >= size[1] else REGIONS[::-1]
    column = np.clip(xy[:, 0] / size[0] * along, 0, along - 1).astype(int)
    row = np.clip(xy[:, 1] / size[1] * across, 0, across - 1).astype(int)
    # what unequal noise does without any cluster
    alone = effects.T @ effects
    ratios, excess = [], np.zeros_like(alone)
    stretch = view * STRETCHES // (int(view.max()) + 1)
    identity = np.eye(len(alone))
    for labels, part, against in (
            ([track], of_tracks, identity), ([view, stretch], effects, alone),
            ([row * along + column], effects, alone)):
        ratio, more = max((_cluster_excess(part, label, against) for label in labels),
                          key=lambda found: found[0])
        ratios.append(ratio)
        excess += more
    widened = base.copy()
    widened[np.ix_(free, free)] += unwhiten @ excess @ unwhiten.T
    return Dependence(*ratios, widened)


def _cluster_excess(effects, label, against) -> tuple[float, np.ndarray]:
    """
    Return the ratio of sigmas and the covariance that clusters add to another, if significant.

    In whitened unknowns, where independent errors of equal noise give the identity.
    """
    _, index = np.unique(label, return_inverse=True)
    clusters = int(index.max()) + 1
    unknowns = effects.shape[1]
    nothing = 1.0, np.zeros((unknowns, unknowns))
    if clusters < 4:
        return nothing
    sums = np.zeros((clusters, unknowns))
    np.add.at(sums, index, effects)
    gram = clusters / (clusters - 1) * sums.T @ sums
    # a few clusters may carry most of the weight: what independent errors would give each
    expected = np.bincount(index, np.sum(effects**2, axis=1))
    spread = np.sqrt(2 / unknowns * np.sum(expected**2)) / np.sum(expected)
    ratio = np.trace(gram) / np.trace(against)
    if ratio < 1 + SIGNIFICANT * spread:
        return nothing
    values, vectors = np.linalg.eigh(gram - against)
    more = (vectors * np.maximum(values, 0)) @ vectors.T
    return float(np.sqrt(1 + np.trace(more) / unknowns)), more
