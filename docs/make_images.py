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
Draw pictures of the recorded drive: `python docs/make_images.py`.

That of the report is drawn where the browser Chromium is installed.
"""

from pathlib import Path
import shutil
import subprocess
import sys
import tempfile

import cv2
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
import numpy as np
from PIL import Image

from selfcal_ros import calibrate, CameraFacts
from selfcal_ros.pipeline.feature_session import read_tracks
from selfcal_ros.pipeline.sources import open_source

ROOT = Path(__file__).resolve().parent.parent
BROWSER = 'chromium'
#: Size of what is shown of the page, and of its scene; what is left of it in the picture.
WIDTH_PX, HEAD_PX, SCENE_PX, SHRUNK = 1100, 1145, 775, 0.8


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
    if shutil.which(BROWSER):
        picture_of_the_page(bag)


def picture_of_the_page(bag: Path) -> None:
    """Show the head of the report, and its scene below."""
    with tempfile.TemporaryDirectory() as folder:
        page = Path(folder) / 'report.html'
        subprocess.run([sys.executable, '-c', 'from selfcal_ros.cli.main import main; main()',
                        'calibrate', str(bag), '--aspect-ratio', '1', '--skew', '0', '--quiet',
                        '--report', str(page), '--output', f'{folder}/camera.yaml'], check=True)
        text = page.read_text(encoding='utf-8')
        alone = page.with_name('scene.html')
        alone.write_text(text.replace(
            '</head>', '<style>header,nav,main>*:not(#scene),footer{display:none}</style></head>',
            1),
            encoding='utf-8')
        parts = [_shown(page, HEAD_PX), _shown(alone, SCENE_PX)]
    small = cv2.resize(np.concatenate(parts), None, fx=SHRUNK, fy=SHRUNK,
                       interpolation=cv2.INTER_AREA)
    # few colours make a small file
    Image.fromarray(small[..., ::-1]).quantize(255).save(
        ROOT / 'docs' / 'images' / 'report.png', optimize=True)


def _shown(page: Path, height: int) -> np.ndarray:
    """Return how a browser shows the top of a page."""
    picture = page.with_suffix('.png')
    subprocess.run([BROWSER, '--headless=new', '--no-sandbox', '--disable-gpu',
                    '--hide-scrollbars', f'--window-size={WIDTH_PX},{height}',
                    '--virtual-time-budget=3000', f'--screenshot={picture}', page.as_uri()],
                   check=True, stderr=subprocess.DEVNULL)
    return cv2.imread(str(picture))


if __name__ == '__main__':
    main()
