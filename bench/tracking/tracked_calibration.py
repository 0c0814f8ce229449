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
"""Calibration from the edges of a tracked object, against truth (thesis 8.2)."""

from __future__ import annotations

from pathlib import Path
import tempfile

from bench.tables import Report
import numpy as np
from selfcal_ros.geometry.camera_facts import CameraFacts
from selfcal_ros.geometry.rotation import rotation_vector
from selfcal_ros.pipeline.tracked_calibration import calibrate_tracked_object
from selfcal_ros.synthetic.objects import tracked_object
from selfcal_ros.synthetic.recordings import write_image_folder

#: Object, speed of its motion, distortion of the lens, time in which an image is read in seconds.
CASES = (('cube', 2.0, (), 0.0), ('step_block', 2.0, (), 0.0), ('spool', 2.0, (), 0.0),
         ('cube', 2.0, (-0.12, 0.05, 0, 0, 0), 0.0),
         ('cube', 2.0, (), 0.02), ('step_block', 2.0, (), 0.02))
IMAGES = 120
FOCAL_FRACTION, SIGMAS = 0.01, 3.0


def run(report: Report, options) -> None:
    """Print the camera that is found without any knowledge of it."""
    images = options.runs or IMAGES
    report.section('Calibration from a tracked object', f'{images} images 640x480, nothing known '
                   'of the lens but square pixels; fx 520, principal point (328, 235).')
    rows, worst, focal = [], 0.0, 0.0
    for shape, speed, distortion, readout_s in CASES:
        recording = tracked_object(images, shape, distortion=distortion, speed=speed,
                                   readout_s=readout_s)
        pose = (*recording.translations[0], *rotation_vector(recording.rotations[0]))
        with tempfile.TemporaryDirectory() as folder:
            result, _ = calibrate_tracked_object(
                write_image_folder(recording, Path(folder) / 'images'), recording.model,
                CameraFacts(aspect_ratio=1.0, skew=0.0,
                            distortion='auto' if distortion else 'none'),
                init=' '.join(map(str, pose)))
        name = shape + (', distorted' if distortion else '') + (
            f', read in {1e3 * readout_s:.0f} ms' if readout_s else '')
        if not result:
            rows.append((name, str(result)[:60], '', '', '', '', ''))
            worst = np.inf
            continue
        error = result.camera.parameters - recording.camera.parameters
        sigma = np.array(list(result.sigma.values()))
        judged = [0, 2, 3]
        ratio = np.abs(error[judged]) / sigma[judged]
        worst, focal = max(worst, ratio.max()), max(focal, abs(error[0] / 520))
        rows.append((name, *(f'{error[k]:+.2f} ± {sigma[k]:.2f}' for k in judged),
                     f'{ratio.max():.1f}', f'{result.noise_sigma_px:.3f}',
                     _readout(recording, result)))
    report.table(('object', 'fx px', 'cx px', 'cy px', 'most sigmas', 'edge noise px',
                  'read in, ms'), rows)
    report.say('')
    report.verdict('focal length, worst', 100 * focal, 100 * FOCAL_FRACTION, '%')
    report.verdict('truth from the result, worst, in stated sigmas', worst, SIGMAS)


def _readout(recording, result) -> str:
    """Say how fast images are read; the folder has no stamps, so the truth gives the interval."""
    if result.shutter is None:
        return 'at once'
    interval_ms = 1e-6 * float(np.median(np.diff(recording.stamps_ns)))
    return (f'{interval_ms * result.shutter.intervals:.2f} ± '
            f'{interval_ms * result.shutter.intervals_sigma:.2f}')
