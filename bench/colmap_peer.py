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
"""COLMAP on the same images in the same run, where pycolmap is installed."""

from __future__ import annotations

from importlib.util import find_spec
from pathlib import Path
import shutil
import time

import numpy as np

#: Name in the tables, camera model, whether the principal point is refined.
CONFIGURATIONS = (
    ('default: SIMPLE_RADIAL, pp fixed', 'SIMPLE_RADIAL', False),
    ('SIMPLE_RADIAL, pp free', 'SIMPLE_RADIAL', True),
    ('OPENCV, pp free', 'OPENCV', True),
)


def is_installed() -> bool:
    """Tell whether pycolmap can be imported."""
    return find_spec('pycolmap') is not None


def calibrate_with_colmap(files: list[Path], folder: Path, configurations=CONFIGURATIONS):
    """
    Reconstruct images of one camera incrementally.

    Parameters
    ----------
    files : list of Path
    folder : Path
        Empty; for copies of the images and for the databases.
    configurations : sequence of (str, str, bool)

    Yields
    ------
    name : str
    camera : dict or None
        fx, fy, cx, cy (pixel (0, 0) at the centre of the top left pixel) and k1; None where
        there is no reconstruction.
    registered : int
        Number of images in it.
    seconds : float
        Features, matching and mapping; the first two are done anew for each configuration.

    """
    import pycolmap
    pycolmap.logging.minloglevel = 2
    images = folder / 'images'
    images.mkdir(parents=True)
    for path in files:
        shutil.copy(path, images / path.name)
    for number, (name, model, refine) in enumerate(configurations):
        began = time.perf_counter()
        work = folder / f'run{number}'
        work.mkdir()
        database = work / 'database.db'
        reader = pycolmap.ImageReaderOptions()
        reader.camera_model = model
        pycolmap.extract_features(database, images, camera_mode=pycolmap.CameraMode.SINGLE,
                                  reader_options=reader)
        pycolmap.match_exhaustive(database)
        options = pycolmap.IncrementalPipelineOptions()
        options.ba_refine_principal_point = refine
        found = pycolmap.incremental_mapping(database, images, work, options)
        seconds = time.perf_counter() - began
        if not found:
            yield name, None, 0, seconds
            continue
        best = max(found.values(), key=lambda model: model.num_reg_images())
        camera = next(iter(best.cameras.values()))
        parameters = dict(zip(camera.params_info.replace(' ', '').split(','), camera.params))
        focal = parameters.get('f', np.nan)
        yield name, {'fx': parameters.get('fx', focal), 'fy': parameters.get('fy', focal),
                     'cx': parameters['cx'] - 0.5, 'cy': parameters['cy'] - 0.5,
                     'k1': parameters.get('k1', parameters.get('k', 0.0)),
                     }, best.num_reg_images(), seconds
