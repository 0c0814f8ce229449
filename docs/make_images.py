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
"""Draw the README's picture from the recorded drive: `python docs/make_images.py`."""

from pathlib import Path

from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
import numpy as np

from selfcal_ros import calibrate, CameraFacts
from selfcal_ros.pipeline.feature_session import read_tracks
from selfcal_ros.pipeline.sources import open_source

ROOT = Path(__file__).resolve().parent.parent


def main() -> None:
    """Draw an image with its tracks beside the path that was found."""
    bag = ROOT / 'bags' / 'agv_drive'
    reading = read_tracks(bag)
    result = calibrate(reading.tracks, facts=CameraFacts(aspect_ratio=1.0, skew=0.0))
    shown = result.frames[len(result.frames) // 2]
    with open_source(bag) as source:
        image = next(frame.image for frame in source if frame.index == shown)
    figure = Figure(figsize=(11, 4.2), layout='constrained')
    FigureCanvasAgg(figure)
    left, right = figure.subplots(1, 2)
    left.imshow(image, cmap='gray', vmin=0, vmax=255)
    frames = [f for f in result.frames if shown - 8 <= f <= shown]
    near = reading.tracks.in_frames(frames)
    for track in np.unique(near.track[near.frame == shown]):
        line = near.xy[near.track == track]
        left.plot(*line.T, color='#1b9e77', linewidth=0.5, alpha=0.8)
    here = near.xy[near.frame == shown]
    left.plot(*here.T, '.', color='#d95f02', markersize=2)
    left.set(title='tracks of one image', xticks=[], yticks=[], xlim=(0, image.shape[1]),
             ylim=(image.shape[0], 0))
    poses = result.reconstruction.cam_from_world
    centres = -np.einsum('vji,vj->vi', poses[:, :, :3], poses[:, :, 3])
    points = result.reconstruction.points
    points = points[np.abs(points[:, 3]) > 1e-3 * np.abs(points).max(axis=1)]
    points = points[:, :3] / points[:, 3:]
    reach = 3 * np.ptp(centres[:, :2], axis=0).max()
    points = points[np.linalg.norm(points[:, :2] - centres[:, :2].mean(axis=0), axis=1) < reach]
    right.plot(*points[:, :2].T, '.', color='0.6', markersize=1.5, label='scene')
    right.plot(*centres[:, :2].T, 'o-', color='#1b9e77', markersize=3, label='camera')
    right.set(title='path and scene, seen from above', xticks=[], yticks=[], aspect='equal')
    right.legend(loc='upper left', fontsize='small')
    figure.savefig(ROOT / 'docs' / 'images' / 'agv_drive.png', dpi=80,
                   metadata={'Software': None})


if __name__ == '__main__':
    main()
