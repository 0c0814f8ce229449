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
Follow a known object through a recording, and print where it is.

    python examples/track_object.py bags/tracked_object bags/tracked_object.model.yaml \
        bags/tracked_object.camera.yaml --start 0.0007 -0.0037 0.46 2.041 0.815 -0.381
"""

import argparse
import sys

import cv2
import numpy as np
from selfcal_ros.pipeline.sources import open_source
from selfcal_ros.report.camera_files.known_camera import read_known_camera
from selfcal_ros.rorapid.model import read_model
from selfcal_ros.rorapid.tracker import RorapidTracker, TrackerState


def main(argv: list[str] | None = None) -> int:
    """Follow the object; returns 1 where it was lost at the end."""
    parser = argparse.ArgumentParser(description='Follow a known object through a recording.')
    parser.add_argument('recording')
    parser.add_argument('model', help='wireframe, .cao or .yaml')
    parser.add_argument('camera', help='camera file of ROS, OpenCV or another program')
    parser.add_argument('--start', type=float, nargs=6, required=True,
                        metavar=('TX', 'TY', 'TZ', 'RX', 'RY', 'RZ'),
                        help='object in the optical frame: metres, angle-axis in radians')
    args = parser.parse_args(argv)

    camera = read_known_camera(args.camera)
    tracker = RorapidTracker(read_model(args.model), camera)
    rotation = cv2.Rodrigues(np.array(args.start[3:]))[0]
    tracker.start(rotation, args.start[:3])
    with open_source(args.recording) as source:
        for frame in source:
            seen = tracker.track(frame.image, frame.stamp_ns)
            if not seen:
                # a lost object has no pose, only a reason
                print(f'{frame.index:4} {seen.state.value}: {seen.reason}')
                continue
            sigma_mm = 1000 * np.sqrt(np.trace(seen.covariance[:3, :3]))
            x, y, z = seen.translation
            print(f'{frame.index:4} {seen.state.value}: {x:+.4f} {y:+.4f} {z:+.4f} m '
                  f'± {sigma_mm:.2f} mm')
    return 1 if tracker.state is TrackerState.LOST else 0


if __name__ == '__main__':
    sys.exit(main())
