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
"""A calibration whose every part is known: sequence SI, seen by a lens with distortion."""

from datetime import datetime, timezone

import numpy as np
import pytest
from selfcal_ros.calibration.reconstruction import Reconstruction
from selfcal_ros.calibration.result import Calibration, FixedPoints
from selfcal_ros.findings.finding import Finding
from selfcal_ros.geometry.camera import PARAMETER_NAMES
from selfcal_ros.geometry.camera_facts import CameraFacts
from selfcal_ros.report import figures
from selfcal_ros.report.page import page_html
from selfcal_ros.report.provenance import Provenance
from selfcal_ros.synthetic.scenes import sequence_si

NOISE_PX = 0.1


@pytest.fixture(scope='session')
def sequence():
    """Six views of SI, and more points than its grid has."""
    rng = np.random.default_rng(1)
    return sequence_si(rng, NOISE_PX, views=6, distortion=[-0.1, 0.02, 0, 0],
                       points=rng.uniform(-1, 1, (300, 3)))


@pytest.fixture(scope='session')
def calibration(sequence):
    """Return the truth of the sequence as a calibration, with sigmas."""
    known = {'fx': 2.0, 'fy': 2.0, 'cx': 1.0, 'cy': 3.0, 'k1': 1e-3, 'k2': 2e-3}
    sigma = np.array([known.get(name, 0.0) for name in PARAMETER_NAMES])
    held = {name: 'skew = 0' if name == 'skew' else 'distortion = radial2'
            for name in PARAMETER_NAMES if name not in known}
    covariance = np.diag(sigma**2)
    covariance[0, 1] = covariance[1, 0] = sigma[0] * sigma[1]
    points = np.column_stack([sequence.points, np.ones(len(sequence.points))])
    return Calibration(
        camera=sequence.camera, covariance=covariance,
        status={name: 'held' if name in held else 'estimated' for name in PARAMETER_NAMES},
        held_by=held, motion='planar',
        facts=CameraFacts(aspect_ratio=1.0, skew=0.0, distortion='radial2'),
        frames=tuple(range(6)), reprojection_rms_px=0.14, noise_sigma_px=NOISE_PX,
        observation_count=len(sequence.tracks), outlier_count=3,
        reconstruction=Reconstruction(np.arange(6), sequence.cam_from_world,
                                      np.arange(len(points)), points),
        fixed_points=FixedPoints(sequence.horizon, sequence.vanishing_point,
                                 sequence.circular_point),
        findings=(Finding('note', text='A note with <b>markup</b>.'),), software='selfcal_ros 0.0')


@pytest.fixture(scope='session')
def html(calibration, sequence):
    """Return a page that has everything but images."""
    made = Provenance(datetime(2026, 1, 2, 3, 4, 5, tzinfo=timezone.utc),
                      ('selfcal', 'calibrate', 'my drive.mcap'), ('my drive.mcap',),
                      {'selfcal_ros': '0.0', 'NumPy': '9.9'})
    notes = (*(Finding('errors_within_track', ratio=1.0 + 0.1 * k) for k in range(8)),
             'How tracks came about.', Finding('image_size_not_stated'))
    return page_html(calibration, 'text', tracks=sequence.tracks, made=made, notes=notes)


@pytest.fixture
def without_figures(monkeypatch):
    """Spare the time of figures where they do not matter."""
    monkeypatch.setattr(figures, 'draw_figures', lambda *_: [])
