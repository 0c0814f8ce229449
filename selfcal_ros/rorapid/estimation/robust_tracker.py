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
"""Our tracker: texture first, then edges with several candidates, in one robust estimate."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np

from selfcal_ros.geometry.small_system import inverted
from selfcal_ros.rorapid.edges.control_points import ControlModel
from selfcal_ros.rorapid.estimation.arrival import Arrival
from selfcal_ros.rorapid.estimation.edge_fit import PosePrior
from selfcal_ros.rorapid.estimation.edge_search import EdgeSearch
from selfcal_ros.rorapid.estimation.free_turn import with_turn_counted
from selfcal_ros.rorapid.estimation.joint_search import (
    alone, Measuring, SearchedEdges, SearchTask)
from selfcal_ros.rorapid.estimation.pose_measurement import PoseMeasurement, SearchDetails
from selfcal_ros.rorapid.estimation.pose_search import PoseSearch
from selfcal_ros.rorapid.estimation.row_doubt import row_doubt
from selfcal_ros.rorapid.estimation.start_check import StartCheck
from selfcal_ros.rorapid.estimation.track_quality import (
    determines_pose, EDGES_SUFFICIENT, focal_sigma, RECOGNISED_CORNERS, RECOGNISED_FOLLOWED,
    track_quality)
from selfcal_ros.rorapid.options import TrackerOptions
from selfcal_ros.rorapid.projection.camera_models import ObjectPose, Projection
from selfcal_ros.rorapid.region.region_of_interest import (
    Region, region_of_interest, Undistorter)
from selfcal_ros.rorapid.texture.appearance import appearance_of
from selfcal_ros.rorapid.texture.corner_fit import (
    AGREE_PX, AgreeingCorners, CornerFit, MIN_TEXTURE)
from selfcal_ros.rorapid.texture.view_memory import ViewMemory

#: With fewer of the corners agreeing much is hidden.
_MUCH_HIDDEN = 0.5
#: Corners are hidden, not blurred, where fewer than this share can be followed, and most of those
#: agree.
_HIDDEN = 0.5
#: An edgel agrees within this, pixels.
_FOUND_PX = 1.75
#: Levels of the pyramid on which corners are followed, and whether in the image at half scale
#: (which a blurred image asks for): at first, and if that fails.
_ATTEMPTS = ((1, False), (3, False), (2, True))
#: After a sudden motion the object is searched for so far around, pixels.
_RELOCALISE_PX = 120.0
#: While lost, edges alone are searched in every so many images.
_EDGE_SEARCH_EVERY = 3


class RobustTracker:
    """
    One measurement per image by our method (`modern` in the settings).

    Parameters
    ----------
    control : ControlModel
    basis : ndarray, shape (size, m)
    options : TrackerOptions
    rng : numpy.random.Generator

    """

    def __init__(self, control: ControlModel, basis: np.ndarray, options: TrackerOptions,
                 rng: np.random.Generator) -> None:
        """Start without memory."""
        self.control, self.basis, self.options = control, basis, options
        self.projection = control.projection
        # texture lives in parts of the image without distortion; edges in the image as it is
        self._lens = Undistorter(self.projection.camera)
        self._pinhole = Projection(self._lens.pinhole, self.projection.model,
                                   self.projection.row_motion)
        self.texture = appearance_of(control.visible_model, control.centre, self._pinhole,
                                     options.texture_points)
        self._distorted = not self.projection.camera.is_pinhole
        self._use_texture = options.texture and options.camera_model != 'affine'
        self._begin()
        self._outline = np.asarray(control.visible_model.model.extent, float) - control.centre
        self._corners = CornerFit(self._pinhole, basis, rng)
        self._edges = EdgeSearch(control, basis, options, self._corners)
        self._views = ViewMemory(self._pinhole, self._outline, rng)
        self.check = StartCheck(control, options.least_contrast)
        self.search = PoseSearch(control, basis, options, self._edges, self.check)
        self._arrival = Arrival(self.search, self._lens.pinhole.K)

    @property
    def verifier(self) -> RobustTracker | None:
        """What tests starts, and what was found again: itself, if the options ask for it."""
        return self if self.options.verifies else None

    @property
    def seeker(self) -> RobustTracker | None:
        """What seeks an object that is lost: itself, if the options ask for it."""
        return self if self.options.seeks else None

    def _begin(self) -> None:
        """Begin with a place to search around, and nothing known of the images."""
        self._lost_images = 0
        #: Whether there ever was a place to search around.
        self.placed = True
        #: Whether much of the object is hidden by other things: then more corners are followed.
        self._much_hidden = False

    def seek(self) -> None:
        """Begin without any place to search around."""
        self.placed = False

    def reset(self) -> None:
        """Forget what the object looks like."""
        self._begin()
        self._edges.forget()
        self.texture.forget()
        self._views.forget()
        self._arrival.forget()
        self.check.forget()

    def switch(self, basis: np.ndarray, camera_model: str) -> None:
        """Go on with another basis of corrections, or another camera model."""
        self.basis = basis
        self._corners.switch(basis)
        self._edges.switch(basis)
        self.search.switch(basis)
        self.projection.become(camera_model)
        self._pinhole.become(camera_model)

    def adopt(self, options: TrackerOptions, control: ControlModel) -> None:
        """Go on by other settings, and with control points that may lie elsewhere."""
        self._edges.adopt(options, control,
                          control.visible_model.nearest_in(self.control.visible_model))
        self.options, self.control = options, control
        self.check = StartCheck(control, options.least_contrast)
        self.search.adopt(options, control, self.check)
        self._use_texture = options.texture and options.camera_model != 'affine'

    def proposals(self, image: np.ndarray, state: ObjectPose, everywhere: bool,
                  covariance: np.ndarray, is_other: Callable[[ObjectPose], bool],
                  ) -> Iterator[ObjectPose]:
        """
        Propose other states, one at a time, the cheapest first.

        Parameters
        ----------
        image : ndarray, shape (H, W), uint8
        state : ObjectPose
            Expected.
        everywhere : bool
            Search the whole image, not only around the expected state.
        covariance : ndarray, shape (m, m)
            Covariance of where it may be.
        is_other : callable
            Whether another, equal thing is at a state.

        Yields
        ------
        ObjectPose

        """
        if self.options.camera_model == 'affine':
            return
        if everywhere:
            place = np.array([[0, 0], image.shape[::-1]], float)
            region = region_of_interest(image, place, 0.0, self._lens)
        else:
            outline = self._pinhole.project(state, self._outline).pixels
            region = region_of_interest(image, outline, _RELOCALISE_PX, self._lens)
        if region is not None:
            yield from self._views.shifted(region, state)
        if everywhere:
            size = np.array(image.shape[::-1])
            whole = self._lens.part(image, 0 * size, size)
            yield from self._views.recognised(whole)
            if not (self.control.is_outlined and self.texture.patterned):
                # what is patterned shows edges where a wrong outline would have them
                for seen in self._arrival.poses(image, whole, covariance, self.placed):
                    poses = [pose for pose in seen if not is_other(pose)]
                    yield from poses if len(poses) < 2 else self._told_apart(
                        image, poses, covariance, state)
            # without texture there are the edges alone; a slow search, and not in every image
            self._lost_images += 1
            if self.placed and self._lost_images % _EDGE_SEARCH_EVERY == 0:
                yield self.search.nearby(image, state, covariance)

    def measure(self, image: np.ndarray, predicted: ObjectPose,
                covariance: np.ndarray) -> PoseMeasurement:
        """Find the object near a predicted state: `measuring`, by itself."""
        return alone(self.measuring(image, predicted, covariance))

    def measuring(self, image: np.ndarray, predicted: ObjectPose,
                  covariance: np.ndarray) -> Measuring:
        """
        Find the object near a predicted state, beside others.

        Parameters
        ----------
        image : ndarray, shape (H, W), uint8
        predicted : ObjectPose
        covariance : ndarray, shape (m, m)
            Covariance of the prediction.

        Yields
        ------
        SearchTask
            To be sent its `SearchedEdges`; see `together`.

        Returns
        -------
        PoseMeasurement

        """
        prior = PosePrior.of(predicted, covariance)
        outline = self._pinhole.project(predicted, self._outline).pixels
        region = region_of_interest(image, outline, 40.0, self._lens)
        corners = _no_corners(predicted)
        if region is not None and self._use_texture and self.texture.known:
            corners = self._by_texture(region, prior)
        count, matches = int(corners.agree.sum()), corners.matches
        led = count >= MIN_TEXTURE
        measured = yield from self._search(image, prior, corners, led, region)
        if led and matches is not None and count < max(
                RECOGNISED_CORNERS, RECOGNISED_FOLLOWED * matches.followed.sum()):
            # few corners may agree on a wrong pose by chance; the edges decide
            near = self._corners.near(predicted, matches)
            by_edges = yield from self._search(
                image, prior, AgreeingCorners(predicted, matches, near), False, region)
            if _quality(by_edges) > _quality(measured):
                measured = by_edges
        return measured

    def _told_apart(self, image: np.ndarray, poses: list[ObjectPose], covariance: np.ndarray,
                    expected: ObjectPose) -> list[ObjectPose]:
        """Return that of several poses which the texture alone recognises, if there is any."""
        if not (self._use_texture and self.texture.patterned):
            return self._arrival.nearest(poses, expected)
        known = [pose for pose in poses if self.measure(image, pose, covariance).by_texture]
        return known if len(known) == 1 else []

    def measured_anew(self, image: np.ndarray, state: ObjectPose,
                      covariance: np.ndarray) -> PoseMeasurement:
        """Measure without regard to what edges looked like: before another background."""
        remembered = self._edges.contrast.copy()
        self._edges.contrast[:] = 0
        measured = self.measure(image, state, covariance)
        if not measured.recognised:
            self._edges.contrast[:] = remembered
        return measured

    def measured_by_edges(self, image: np.ndarray, predicted: ObjectPose, covariance: np.ndarray,
                          near: bool = False) -> PoseMeasurement:
        """Measure by edges alone: those near the prediction, or as far as its covariance says."""
        return alone(self._search(image, PosePrior.of(predicted, covariance),
                                  _no_corners(predicted), near, None))

    def _search(self, image: np.ndarray, prior: PosePrior, corners: AgreeingCorners, led: bool,
                region: Region | None) -> Measuring:
        """
        Ask for edges about a state, and conclude.

        Parameters
        ----------
        image : ndarray, shape (H, W), uint8
        prior : PosePrior
        corners : AgreeingCorners
            And the state to begin from.
        led : bool
            That state is from the corners, and nearly right; else edges may be further away.
        region : Region or None
            Part of the image around the object; None outside of the image.

        """
        searched = yield SearchTask(image, self._edges, prior, corners, led)
        return self._conclude(region, searched)

    def _by_texture(self, region: Region, prior: PosePrior) -> AgreeingCorners:
        """
        Follow the texture's corners and find the pose on which most of them agree.

        First from close by, where what is before the object disturbs least; then from further.
        """
        best = _no_corners(prior.state)
        for levels, reduced in _ATTEMPTS:
            if reduced and _hidden(best):
                break
            matches = self.texture.follow(region.halved() if reduced else region, prior.state,
                                          levels, self._much_hidden)
            if matches is None:
                break
            near = AGREE_PX * (1.5 if reduced else 1.0)
            state, agree = self._corners.agreement(matches, prior.state, prior.information, near)
            gain = 1.5 if reduced else 1.0
            if best.matches is None or agree @ matches.score > gain * (
                    best.agree @ best.matches.score):
                best = AgreeingCorners(state, matches, agree)
            if agree.mean() > 0.4:
                break
        self._much_hidden = best.matches is not None and best.agree.mean() < _MUCH_HIDDEN
        return best

    def initialise(self, image: np.ndarray, guess: ObjectPose,
                   covariance: np.ndarray) -> PoseMeasurement:
        """
        Find the object from a guess: from many starts around it, the one with the best edges.

        Parameters
        ----------
        image : ndarray, shape (H, W), uint8
        guess : ObjectPose
        covariance : ndarray, shape (m, m)
            Covariance of the guess.

        Returns
        -------
        PoseMeasurement

        """
        self._edges.glance(image, self.control.view(guess))
        return self.measure(image, self.search.nearby(image, guess, covariance), covariance)

    def glance(self, image: np.ndarray, measured: PoseMeasurement) -> None:
        """Learn anew what object and background look like, from a state that is not confirmed."""
        self._edges.glance(image, self.control.view(measured.state))
        details = measured.details
        if self._use_texture and details is not None and details.region is not None:
            self.texture.glance(details.region, measured.state, self._shown(measured))

    def disown(self) -> None:
        """Forget what the texture looked like at states that were not confirmed."""
        self.texture.disown()

    def _conclude(self, region: Region | None, searched: SearchedEdges) -> PoseMeasurement:
        """Count what confirms the state."""
        fit, corners = searched.fit, searched.corners
        matches, agree = corners.matches, corners.agree
        edge_px = np.full(len(fit.view.ids), np.nan)
        edge_px[fit.at] = fit.residual
        found = np.abs(edge_px) < _FOUND_PX
        edges = self._edges.found_share(fit, found[fit.at])
        share, recognised = track_quality(self.options, edges, matches, agree)
        determined = determines_pose(self.projection, self.basis, fit.measured,
                                     self.control.free(fit.state))
        focal = focal_sigma(self.projection, self.basis, fit.measured, determined)
        texture_px = np.zeros((0, 2)) if matches is None else matches.pixels[agree]
        if self._distorted and len(texture_px):
            texture_px = self.projection.camera.pixels(self._lens.pinhole.normalised(texture_px))
        posterior = self._edges.posterior(fit, searched.scatter)
        motion = self.projection.row_motion
        return PoseMeasurement(
            state=fit.state, covariance=inverted(posterior), with_prior=True,
            view=searched.view, edge_px=edge_px, found=found,
            texture_px=texture_px, share=share, determined=determined, recognised=recognised,
            by_texture=bool(recognised and agree.sum() >= RECOGNISED_CORNERS),
            focal_sigma=focal, details=SearchDetails(
                region, fit, matches, agree, searched.scatter, edges,
                self._edges.misfit(fit, found[fit.at])),
            rows=None if motion is None else row_doubt(fit, motion, self.basis))

    def remember(self, measured: PoseMeasurement, confirmed: bool) -> None:
        """Take over contrasts and pictures of a state that was accepted."""
        details = measured.details
        if details is None:
            return
        region, matches = details.region, details.matches
        self._arrival.forget()
        self.placed = True
        self._edges.learn(details.fit, measured.found[details.fit.at], details.edge_share,
                          details.scatter)
        if region is None:
            return
        if self._use_texture:
            if measured.recognised and matches is not None:
                self.texture.judge(matches, details.agree)
            if measured.recognised or min(details.edge_share, measured.share) > EDGES_SUFFICIENT:
                self.texture.learn(region, measured.state, confirmed, self._shown(measured))
        if confirmed:
            self._views.remember(region, measured.state)

    def _shown(self, measured: PoseMeasurement) -> np.ndarray:
        """Covariance (6, 6) of the pose that texture is learned in: a free turn counts from it."""
        shown: np.ndarray = with_turn_counted(self.basis @ measured.covariance @ self.basis.T,
                                              self.control.free(measured.state))
        return shown[:6, :6]


def _no_corners(state: ObjectPose) -> AgreeingCorners:
    """Begin from a state, without corners."""
    return AgreeingCorners(state, None, np.zeros(0, bool))


def _hidden(corners: AgreeingCorners) -> bool:
    """Whether corners that were not found are hidden; those of a blurred image contradict."""
    if corners.matches is None:
        return False
    followed = corners.matches.followed
    return bool(followed.mean() < _HIDDEN and corners.agree.sum() > 0.5 * followed.sum())


def _quality(measured: PoseMeasurement) -> tuple[float, float]:
    """Edges first: of two measurements in one image the one with more of them is right."""
    edges = 0.0 if measured.details is None else measured.details.edge_share
    return edges, measured.share
