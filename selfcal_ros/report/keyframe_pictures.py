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
Images that were calibrated from, with the tracks drawn over them.

The images are read a second time, because a calibration keeps none. A few of them go into the page
as small JPEGs. All of those that were used give the points of the scene their colours.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from selfcal_ros.calibration.result import Calibration, NotCalibrated
from selfcal_ros.errors import InputError
from selfcal_ros.pipeline.frame_source import Frame, FrameSource
from selfcal_ros.report.observations import observations, ObservationTable
from selfcal_ros.report.open_frames import OpenFrames
from selfcal_ros.report.ply import point_colours
from selfcal_ros.report.rectified import Rectified, rectified_preview
from selfcal_ros.report.small_jpeg import small_jpeg
from selfcal_ros.report.worst import arrow_scale, fit_of_images
from selfcal_ros.values.tracks import Tracks

#: Pictures in a page: spread over the recording, and of the images that fit worst.
PICTURES, WORST_PICTURES = 4, 2
#: Length of their longer side, and what each may weigh.
LONGER_SIDE_PX, MOST_BYTES = 1080, 350_000
#: Tracks in one picture; more hide the image.
MAX_TRACKS = 700
#: A trail goes back over so many of the views that were used.
TRAIL_VIEWS = 3


@dataclass(frozen=True)
class Picture:
    """
    One image with its tracks, which are paths of SVG in the pixels of the full image.

    Attributes
    ----------
    frame : int
    width, height : int
        Of the full image, pixels.
    jpeg : bytes
        The image, reduced.
    trails, rejected_trails : str
        Where the points of this image have come from: of those used, and of those that no motion
        of the camera explains.
    points, rejected : str
        Where they are, as strokes of no length.
    horizon : str
        The horizon of the motion as the lens shows it; empty where it is not in the image.
    used_count, rejected_count : int
    arrows : str
        Residuals from the measured to the predicted position, enlarged.
    enlarged : float
        By so much; the same for all pictures of a page.
    is_worst : bool
        Whether the image is among those that fit worst.
    rectified : Rectified, optional
        Of one picture of a page.

    """

    frame: int
    width: int
    height: int
    jpeg: bytes
    trails: str
    rejected_trails: str
    points: str
    rejected: str
    horizon: str
    used_count: int
    rejected_count: int
    arrows: str = ''
    enlarged: float = 1.0
    is_worst: bool = False
    rectified: Rectified | None = None


def pictures_and_colours(result: Calibration | NotCalibrated, tracks: Tracks,
                         open_frames: OpenFrames,
                         ) -> tuple[list[Picture], dict[int, tuple[int, int, int]]]:
    """
    Read the images again for their looks.

    Parameters
    ----------
    result : Calibration or NotCalibrated
        Without a calibration no point is rejected.
    tracks : Tracks
        Those that were calibrated from.
    open_frames : callable
        Opens the images (a context manager), as `selfcal_ros.pipeline.sources.open_source` does,
        in colour.

    Returns
    -------
    pictures : list of Picture
        Empty where there are no images, or they cannot be read any more.
    colours : dict
        Red, green and blue of the reconstructed tracks.

    """
    frames = np.asarray(result.reconstructed.frames) if result else tracks.frames
    if not len(frames):
        return [], {}
    # the first views have little to look back on
    first, last = min(2, len(frames) - 1), len(frames) - 1
    places = np.unique(np.linspace(first, last, PICTURES).round().astype(int))
    seen = observations(result, tracks) if result else _all_used(tracks)
    order = (fit_of_images(result, seen).worst(PICTURES + WORST_PICTURES)
             if result and len(frames) > PICTURES else places[:0])
    # those of the worst that are shown anyhow leave room for the next
    further = order[~np.isin(order, places)][:WORST_PICTURES]
    worst = order[:WORST_PICTURES]
    wanted = set(frames[np.union1d(places, further)].tolist())
    images: dict[int, np.ndarray] = {}
    try:
        with open_frames() as source:
            if getattr(source, 'kind', '') == 'tracks':
                return [], {}
            kept = _until(source, set(frames.tolist()), wanted, images)
            ids = np.asarray(result.reconstructed.tracks if result else (), int)
            paint = point_colours(tracks, ids, kept)
    except (InputError, OSError):
        # the calibration is done: a report without pictures is better than none
        return [], {}
    pictures = _draw(result, seen, frames, images, set(frames[worst].tolist()))
    return pictures, dict(zip(ids.tolist(), map(tuple, paint.tolist())))


def _until(source: FrameSource, used: set[int], wanted: set[int], images: dict[int, np.ndarray],
           ) -> Iterator[Frame]:
    """Yield the frames that were used, and put aside those wanted."""
    for frame in source.only(used):
        if frame.index in wanted:
            images[frame.index] = frame.image if frame.bgr is None else frame.bgr
        yield frame


def _all_used(tracks: Tracks) -> ObservationTable:
    """Return the observations as they are: nothing is known that could contradict them."""
    return ObservationTable(np.searchsorted(tracks.frames, tracks.frame), tracks.track, tracks.xy,
                            np.zeros_like(tracks.xy), np.ones(len(tracks), bool))


def _draw(result: Calibration | NotCalibrated, seen: ObservationTable, frames: np.ndarray,
          images: dict[int, np.ndarray], worst: set[int]) -> list[Picture]:
    pictures: list[Picture] = []
    enlarged = (arrow_scale(seen.residual[seen.used], max(result.camera.width, 1)) if result
                else 1.0)
    preview = None
    for index, image in sorted(images.items()):
        view = int(np.flatnonzero(frames == index)[0])
        ids, bad, now, steps, old = _recent(seen, view)
        # what was rejected first: it is rarer, and it is what one looks for
        order = np.argsort(~bad, kind='stable')[:MAX_TRACKS]
        shown = np.zeros(len(ids), bool)
        shown[order] = True
        if result and result.motion == 'known-object':
            # views of an object held anyhow: nothing moved along these lines
            steps, old = steps[:0], old[:0]
        height, width = image.shape[:2]
        if result and preview is None:
            preview = one = rectified_preview(result.camera_of(index), image)
        else:
            one = None
        pictures.append(Picture(
            int(index), width, height, small_jpeg(image, LONGER_SIDE_PX, MOST_BYTES),
            _lines(steps[shown[old] & ~bad[old]]),
            _lines(steps[shown[old] & bad[old]]), _dots(now[shown & ~bad]),
            _dots(now[shown & bad]), _horizon(result, width, height) if result else '',
            int((~bad).sum()), int(bad.sum()), _arrows(seen, view, enlarged) if result else '',
            enlarged, int(index) in worst, one))
    return pictures


def _arrows(seen: ObservationTable, view: int, enlarged: float) -> str:
    """Return the residuals of the observations used in a view, as lines."""
    mine = np.flatnonzero(seen.used & (seen.view == view))[:MAX_TRACKS]
    return _lines(np.stack([seen.xy[mine], seen.xy[mine] + enlarged * seen.residual[mine]],
                           axis=1))


def _recent(seen: ObservationTable, view: int) -> tuple[np.ndarray, ...]:
    """
    Follow the points of a view back.

    Returns
    -------
    ids, bad, now
        Track, whether rejected, and position of each point of the view.
    steps, old
        Pieces of trails (S, 2, 2), and the point (index into ids) of each.

    """
    here = np.flatnonzero(seen.view == view)
    here = here[np.argsort(seen.track[here])]
    ids = seen.track[here]
    steps, owners = [np.empty((0, 2, 2))], [np.empty(0, int)]
    after = seen.xy[here], np.arange(len(ids))
    for earlier in range(view - 1, max(view - TRAIL_VIEWS, 0) - 1, -1):
        rows = np.flatnonzero(seen.view == earlier)
        _, a, b = np.intersect1d(seen.track[rows], ids[after[1]], return_indices=True)
        steps.append(np.stack([seen.xy[rows[a]], after[0][b]], axis=1))
        owners.append(after[1][b])
        after = seen.xy[rows[a]], after[1][b]
    return ids, ~seen.used[here], seen.xy[here], np.concatenate(steps), np.concatenate(owners)


def _lines(steps: np.ndarray) -> str:
    return ''.join('M{:.1f} {:.1f}L{:.1f} {:.1f}'.format(*step)
                   for step in steps.reshape(-1, 4).tolist())


def _dots(xy: np.ndarray) -> str:
    return ''.join('M{:.1f} {:.1f}h0'.format(*point) for point in xy.tolist())


def _horizon(result: Calibration, width: int, height: int) -> str:
    """Return the horizon bent by the lens, where it crosses the image."""
    if result.fixed_points is None:
        return ''
    line = np.real(result.fixed_points.horizon)
    camera = result.camera
    # samples of the line well beyond the image, in undistorted pixels
    s = np.linspace(-1, 2, 121)
    if not np.isfinite(line).all() or max(abs(line[0]), abs(line[1])) < 1e-12 * abs(line[2]):
        return ''
    if abs(line[1]) >= abs(line[0]):
        u = s * width
        points = np.stack([u, -(line[0] * u + line[2]) / line[1]], axis=1)
    else:
        v = s * height
        points = np.stack([-(line[1] * v + line[2]) / line[0], v], axis=1)
    xy = np.linalg.solve(camera.K, np.column_stack([points, np.ones(len(points))]).T).T[:, :2]
    with np.errstate(all='ignore'):
        bent = camera.pixels(xy)
        # beyond the fold of the distortion nothing is seen
        back = camera.normalised(bent)
    good = np.isfinite(bent).all(axis=1) & (np.abs(back - xy).max(axis=1) < 1e-3) \
        & (bent > -1).all(axis=1) & (bent < [width, height]).all(axis=1)
    if good.sum() < 2:
        return ''
    return 'M' + 'L'.join('{:.1f} {:.1f}'.format(*point) for point in bent[good].tolist())
