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

Errors may be shared by the observations of one track, of one view or segment of views, or of one
region of the image. Such are drift of a patch, a jolt, a lens that the model does not describe.
They do not average out. Sums of influences over such clusters measure what they do to the
calibration (the cluster-robust covariance; Liang and Zeger 1986; several ways of clustering:
Cameron, Gelbach and Miller 2011), and so do estimates that leave out one segment of views each.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from selfcal_ros.calibration.bundle.information import Information
from selfcal_ros.calibration.bundle.robust_fit import RobustFit
from selfcal_ros.findings.finding import Finding
from selfcal_ros.geometry.scaled_inverse import unit_diagonal

#: Image regions that errors may share, along the longer and the shorter side.
REGIONS = (8, 6)
#: A way of clustering counts when the variance that it finds exceeds that of independent errors
#: by so many standard deviations of its own.
SIGNIFICANT = 3.0


@dataclass(frozen=True)
class ClusterCovariance:
    """
    Variance that shared errors add.

    Attributes
    ----------
    ratios : dict of str to float
        By 'track' or 'region': the sigma with errors shared within it over that with independent
        ones, mean over the estimated parameters; 1 where nothing significant was found.
    covariance : ndarray, shape (k, k)
        Of the internal parameters, dependence included.

    """

    ratios: dict[str, float]
    covariance: np.ndarray

    @property
    def variance_inflation(self) -> float:
        """Variance with shared errors over that with independent ones: the inflation factor."""
        return 1 + float(sum(ratio**2 - 1 for ratio in self.ratios.values()))

    @property
    def sigma_inflation(self) -> float:
        """The same of sigmas."""
        return float(np.sqrt(self.variance_inflation))

    def findings(self, *names: str, track: str = 'errors_within_track') -> tuple[Finding, ...]:
        """Tell what was found; names choose among the ratios, `track` is the kind of theirs."""
        kinds = {'track': track, 'region': 'errors_within_region'}
        return tuple(Finding(kinds[name], ratio=float(self.ratios[name]))
                     for name in names or kinds if self.ratios.get(name, 1) > 1)


def segment_findings(ratio: float) -> tuple[Finding, ...]:
    """Tell what `jackknife_excess` found, if anything."""
    return () if ratio <= 1 else (Finding('errors_within_segment', ratio=float(ratio)),)


def cluster_robust_covariance(information: Information, track: np.ndarray, xy: np.ndarray,
                              size: tuple[int, int], camera: np.ndarray | int = 0,
                              ) -> ClusterCovariance:
    """
    Widen a covariance by the dependence that the residuals show.

    Parameters
    ----------
    information : Information
        Only the lens is judged, since the axis may rest on the prior of the tilts.
    track : ndarray of int, shape (N,)
    xy : ndarray, shape (N, 2)
        Pixels.
    size : (int, int)
        Width and height of the image.
    camera : ndarray of int, shape (N,)
        Whose image it is, where there are several cameras.

    Returns
    -------
    ClusterCovariance

    """
    base = information.lens_covariance
    whiten, unwhiten, free = _whitening(base)
    effects = information.lens_influence[:, free] @ whiten.T
    of_tracks = effects / np.sqrt(information.track_fraction)
    effects /= np.sqrt(information.freedom_fraction)
    widened = base.copy()
    ratios = {}
    # unequal noise counts with the tracks, and must not count again with the regions
    for name, label, part, against in (
            ('track', track, of_tracks, np.eye(len(whiten))),
            ('region', _regions_by_camera(xy, size, camera), effects, effects.T @ effects)):
        ratios[name], more = _cluster_excess(part, label, against)
        widened[np.ix_(free, free)] += unwhiten @ more @ unwhiten.T
    return ClusterCovariance(ratios, widened)


def robust_covariance_of(fit: RobustFit, sizes: Sequence[int] | np.ndarray) -> ClusterCovariance:
    """
    Widen the covariance of an optimum by the dependence that its residuals show.

    Parameters
    ----------
    fit : RobustFit
        Of one camera or of a rig.
    sizes : (int, int), or array of int, shape (C, 2)
        Width and height of the image, of a rig those of every camera.

    Returns
    -------
    ClusterCovariance

    """
    observations = fit.observations
    xy, size, camera = images_alike(observations.xy, np.asarray(sizes), observations.camera)
    return cluster_robust_covariance(fit.information, observations.point, xy, size, camera)


def images_alike(xy: np.ndarray, sizes: np.ndarray, camera: np.ndarray | None,
                 ) -> tuple[np.ndarray, tuple[int, int], np.ndarray | int]:
    """
    Scale the images of all cameras to the size of the first, so that regions are alike.

    Parameters
    ----------
    xy : ndarray, shape (N, 2)
        Pixels.
    sizes : ndarray of int, shape (2,), or (C, 2) of several cameras
    camera : ndarray of int, shape (N,), or None
        Whose image each is in, where there are several.

    Returns
    -------
    xy : ndarray, shape (N, 2)
    size : (int, int)
    camera : ndarray of int, shape (N,), or 0

    """
    width, height = np.reshape(sizes, (-1, 2))[0]
    size = int(width), int(height)
    if camera is None:
        return xy, size, 0
    return xy * (np.array(size) / sizes)[camera], size, camera


def region_excess(covariance: np.ndarray, influence: np.ndarray, xy: np.ndarray,
                  size: tuple[int, int], camera: np.ndarray | int = 0,
                  ) -> tuple[float, np.ndarray]:
    """
    Variance that errors shared within regions of the image add to a covariance.

    Parameters
    ----------
    covariance : ndarray, shape (k, k)
    influence : ndarray, shape (N, k)
        Effect of every observation's residual on the estimate.
    xy : ndarray, shape (N, 2)
        Pixels.
    size : (int, int)
        Width and height of the image.
    camera : ndarray of int, shape (N,)
        Whose image it is, where there are several cameras.

    Returns
    -------
    ratio : float
        Of sigmas, mean over the parameters; 1 where nothing significant was found.
    ndarray, shape (k, k)
        Covariance to add.

    """
    whiten, unwhiten, free = _whitening(covariance)
    effects = influence[:, free] @ whiten.T
    ratio, more = _cluster_excess(effects, _regions_by_camera(xy, size, camera),
                                  effects.T @ effects)
    added = np.zeros_like(covariance)
    added[np.ix_(free, free)] = unwhiten @ more @ unwhiten.T
    return ratio, added


def jackknife_excess(shifts: np.ndarray, covariances: np.ndarray, covariance: np.ndarray,
                     variance_inflation: float = 1.0) -> tuple[float, np.ndarray]:
    """
    Variance that errors shared by segments of views add.

    An estimate that leaves out a part of the data is shifted. With independent errors the shift
    has the covariance of that estimate less that of the one from all (Hausman 1978). Shifts larger
    than that tell of errors that a segment shares; linear cluster sums of few groups would miss
    them.

    Parameters
    ----------
    shifts : ndarray, shape (G, k)
        Estimates that each leave out one segment, less the one from all.
    covariances : ndarray, shape (G, k, k)
        Of those estimates, for independent errors.
    covariance : ndarray, shape (k, k)
        Of the estimate from all, for independent errors.
    variance_inflation : float
        Variance over that with independent errors which is accounted for already.

    Returns
    -------
    ratio : float
        Of sigmas, mean over the parameters; 1 where nothing significant was found.
    ndarray, shape (k, k)
        Covariance to add.

    """
    groups = len(shifts)
    nothing = 1.0, np.zeros_like(covariance)
    if groups < 4:
        return nothing
    # a segment without weight in some direction must not divide by nothing there
    expected = variance_inflation * (np.sum(covariances - covariance, axis=0) + 0.05 * covariance)
    if not (np.diag(expected) > 0).any():
        return nothing
    whiten, unwhiten, free = _whitening(expected)
    scatter = shifts[:, free] @ whiten.T
    gram = scatter.T @ scatter
    unknowns = len(whiten)
    each = variance_inflation * (covariances - covariance)
    each = whiten @ each[:, free[:, None], free] @ whiten.T
    # variance of a sum of squares of Gaussians; the ends of a drive may weigh most
    spread = np.sqrt(2 * np.sum(each**2)) / unknowns
    if np.trace(gram) / unknowns < 1 + SIGNIFICANT * spread:
        return nothing
    values, vectors = np.linalg.eigh(gram)
    # the axes of what was observed, each as long as a sigma of `covariance` in its direction
    axes = unwhiten @ vectors
    inverse = np.linalg.pinv(covariance[np.ix_(free, free)])
    axes /= np.sqrt(np.einsum('ik,ij,jk->k', axes, inverse, axes))
    more = variance_inflation * (axes * np.maximum(values - 1, 0)) @ axes.T
    added = np.zeros_like(covariance)
    added[np.ix_(free, free)] = more
    return float(np.sqrt(1 + np.trace(inverse @ more) / unknowns)), added


def jackknife_covariance(shifts: np.ndarray) -> np.ndarray:
    """
    Return the covariance that a delete-a-group jackknife tells.

    Parameters
    ----------
    shifts : ndarray, shape (G, k)
        Estimates that each leave out one group of observations, less the one from all. Errors
        may be shared within a group.

    Returns
    -------
    ndarray, shape (k, k)
        As wide as Student's distribution of so many groups; zero of fewer than four.

    """
    groups, unknowns = shifts.shape
    if groups < 4:
        return np.zeros((unknowns, unknowns))
    apart = shifts - shifts.mean(axis=0)
    covariance: np.ndarray = (groups - 1)**2 / (groups * (groups - 3)) * apart.T @ apart
    return covariance


def widest(covariance: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Return the wider of two covariances (k, k) in every direction that the first has."""
    whiten, unwhiten, free = _whitening(covariance)
    more = _positive_part(whiten @ other[np.ix_(free, free)] @ whiten.T - np.eye(len(whiten)))
    wider = covariance.copy()
    wider[np.ix_(free, free)] += unwhiten @ more @ unwhiten.T
    return wider


def shared_sigma(influence: np.ndarray, sigma: float, label: np.ndarray) -> float:
    """
    Widen the sigma of one unknown by errors that groups of observations share.

    Parameters
    ----------
    influence : ndarray, shape (N,)
        Effect of every observation's residual on it.
    sigma : float
        For independent errors.
    label : ndarray of int, shape (N,)
        The group of every observation.

    Returns
    -------
    float
        As it is where nothing significant was found.

    """
    if not sigma > 0:
        return sigma
    ratio, _ = _cluster_excess(influence[:, None] / sigma, label, np.eye(1))
    return ratio * sigma


def _whitening(covariance: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return W, its pseudo-inverse, and the indices that it takes: W C Wᵀ = I."""
    sigma = np.sqrt(np.maximum(np.diag(covariance), 0))
    free = np.flatnonzero(sigma > 0)
    values, vectors = np.linalg.eigh(unit_diagonal(covariance[np.ix_(free, free)])[0])
    usable = values > 1e-10 * values[-1]
    whiten = (vectors[:, usable] / np.sqrt(values[usable])).T / sigma[free]
    return whiten, np.linalg.pinv(whiten), free


def _regions(xy: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    """Return the number of the image region (N,) that every place is in."""
    along, across = REGIONS if size[0] >= size[1] else REGIONS[::-1]
    column = np.clip(xy[:, 0] / size[0] * along, 0, along - 1).astype(int)
    row = np.clip(xy[:, 1] / size[1] * across, 0, across - 1).astype(int)
    region: np.ndarray = row * along + column
    return region


def _regions_by_camera(xy: np.ndarray, size: tuple[int, int], camera: np.ndarray | int,
                       ) -> np.ndarray:
    """Number the regions (N,) of all cameras, one camera after the other."""
    regions: np.ndarray = _regions(xy, size) + REGIONS[0] * REGIONS[1] * camera
    return regions


def _cluster_excess(effects: np.ndarray, label: np.ndarray, against: np.ndarray,
                    ) -> tuple[float, np.ndarray]:
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
    more = _positive_part(gram - against)
    return float(np.sqrt(1 + np.trace(more) / unknowns)), more


def _positive_part(matrix: np.ndarray) -> np.ndarray:
    """Return a symmetric matrix without its negative eigenvalues."""
    values, vectors = np.linalg.eigh(matrix)
    part: np.ndarray = (vectors * np.maximum(values, 0)) @ vectors.T
    return part
