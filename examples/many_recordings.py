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
Calibrate from many recordings in parallel, and ask whether they agree.

    python examples/many_recordings.py bags/agv_drive bags/arm_move

`selfcal calibrate drives/` does the same, and writes the files and a report.
"""

import argparse
import sys

from selfcal_ros import CameraFacts
from selfcal_ros.pipeline.calibrate_input import CalibrationSettings
from selfcal_ros.pipeline.many_inputs import calibrate_many


def main(argv: list[str] | None = None) -> int:
    """Calibrate; returns 1 where a camera has no joint calibration."""
    parser = argparse.ArgumentParser(description='Calibrate from many recordings.')
    parser.add_argument('recordings', nargs='+')
    args = parser.parse_args(argv)

    settings = CalibrationSettings(facts=CameraFacts(aspect_ratio=1.0, skew=0.0))
    summary = calibrate_many(args.recordings, settings)
    for failure in summary.failures:
        # a broken recording costs the others nothing
        print(f'{failure.path}: {failure.error}')
    for camera in summary.cameras:
        for outcome in camera.outcomes:
            good = outcome.result
            print(f'{outcome.path}: ' + (f'fx {good.camera.K[0, 0]:.2f} ± {good.sigma["fx"]:.2f}'
                                         if good else str(good or outcome.error)))
        if camera.joint is None:
            print('no recording calibrates')
            continue
        joint = camera.joint
        print(f'together: fx {joint.calibration.camera.K[0, 0]:.2f} '
              f'± {joint.calibration.sigma["fx"]:.2f}, '
              f'{joint.used.sum()} of {len(joint.used)} recordings, p = {joint.p_value:.2g}')
    joined = [camera for camera in summary.cameras if camera.joint is not None]
    return 0 if joined and len(joined) == len(summary.cameras) else 1


# the processes that calibrate import this file again: nothing may run while it is imported
if __name__ == '__main__':
    sys.exit(main())
