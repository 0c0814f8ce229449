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
Calibrate a camera from a recording, and measure an angle with it.

    python examples/calibrate_recording.py bags/agv_drive camera.yaml
"""

import argparse
import sys

import numpy as np
from selfcal_ros import calibrate, CameraFacts, ray_angles
from selfcal_ros.pipeline.feature_session import read_tracks
from selfcal_ros.report.camera_yaml import write_camera_yaml


def main(argv: list[str] | None = None) -> int:
    """Calibrate; returns 0, or 1 where the images do not suffice."""
    parser = argparse.ArgumentParser(description='Calibrate a camera from a recording.')
    parser.add_argument('recording', help='a bag, a folder of images or a video')
    parser.add_argument('output', help='camera file to write')
    args = parser.parse_args(argv)

    # images to tracks: where each point of the scene was seen, image by image
    tracks = read_tracks(args.recording).tracks
    # tracks to camera; nothing is taken for granted that is not stated as a fact
    result = calibrate(tracks, facts=CameraFacts(aspect_ratio=1.0, skew=0.0))
    if not result:
        # a refusal is a value: it says which motion or fact is missing
        print(result)
        return 1
    for name, value in zip(result.sigma, result.camera.parameters):
        print(f'{name:5} {value:10.4f} ± {result.sigma[name]:.4f}  {result.status[name]}')

    # what the uncertainty of the camera means for an angle
    width, height = tracks.image_size
    left, right = [0.25 * width, 0.5 * height], [0.75 * width, 0.5 * height]
    angle, sigma = ray_angles(result, left, right)
    print(f'half the width of the image is {np.degrees(angle[0]):.3f} '
          f'± {np.degrees(sigma[0]):.3f} degrees')
    write_camera_yaml(args.output, result.camera, 'camera')
    return 0


if __name__ == '__main__':
    sys.exit(main())
