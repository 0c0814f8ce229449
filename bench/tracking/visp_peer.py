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
ViSP's model-based tracker as a process, built from visp_peer.cpp where ViSP is installed.

Debian: apt-get install libvisp-dev. An installation elsewhere is found by CPATH, LIBRARY_PATH and
LD_LIBRARY_PATH, as compilers and linkers have it.
"""

from __future__ import annotations

import os
from pathlib import Path
import re
import shutil
import subprocess
import tempfile

from bench.inputs import data_folder
import cv2
import numpy as np
from selfcal_ros.geometry.camera import Camera
from selfcal_ros.geometry.rotation import rotation_matrix, rotation_vector
from selfcal_ros.rorapid.model import write_model
from selfcal_ros.values.wireframe import WireframeModel

LIBRARIES = ('visp_mbt', 'visp_io', 'visp_core', 'visp_me', 'visp_vision', 'visp_klt', 'visp_gui',
             'visp_visual_features')
#: What ViSP's headers include.
INCLUDES = ('/usr/include/opencv4', '/usr/include/eigen3', '/usr/include/libxml2')


def build() -> Path | None:
    """Compile the peer; returns the program, or None where there is no compiler or no ViSP."""
    compiler = shutil.which('g++')
    if compiler is None or data_folder('visp_mbt_cube') is None:
        return None
    folder = Path(tempfile.mkdtemp(prefix='selfcal-visp-'))
    program = folder / 'visp_peer'
    command = [compiler, '-O2', '-fopenmp', str(Path(__file__).with_suffix('.cpp')), '-o',
               str(program), *(f'-I{path}' for path in INCLUDES),
               '-Wl,--allow-shlib-undefined', *(f'-l{name}' for name in LIBRARIES)]
    done = subprocess.run(command, capture_output=True, timeout=120)
    if done.returncode or subprocess.run([str(program)], capture_output=True).returncode != 2:
        shutil.rmtree(folder, ignore_errors=True)
        return None
    return program


def track(program: Path, images, kind: str, model: WireframeModel | None = None,
          camera: Camera | None = None, start=None) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """
    Track an object with ViSP by the settings of its cube sequence; that cube without a model.

    Parameters
    ----------
    program : Path
        From `build`.
    images : list of ndarray
    kind : {'edges', 'both'}
        Both: edges and KLT.
    model : WireframeModel, optional
    camera : Camera, optional
    start : (rotation, translation), optional

    Returns
    -------
    rotations : ndarray, shape (N, 3, 3)
    translations : ndarray, shape (N, 3)
    seconds : ndarray, shape (N,)
        Of track() alone.

    """
    data = data_folder('visp_mbt_cube')
    pose = (data / 'cube.0.pos').read_text(encoding='utf-8').split()
    shape, settings = data / 'cube.cao', data / 'cube.xml'
    with tempfile.TemporaryDirectory() as folder:
        if model is not None:
            shape = write_model(model, Path(folder) / 'model.cao')
            text = settings.read_text(encoding='utf-8')
            for tag, value in zip(('u0', 'v0', 'px', 'py'), camera.K[(0, 1, 0, 1), (2, 2, 0, 1)]):
                text = re.sub(f'<{tag}>.*</{tag}>', f'<{tag}>{value}</{tag}>', text)
            settings = Path(folder) / 'settings.xml'
            settings.write_text(text, encoding='utf-8')
            pose = [str(number) for number in (*start[1], *rotation_vector(start[0]))]
        names = []
        for number, image in enumerate(images):
            names.append(str(Path(folder) / f'{number:05d}.pgm'))
            cv2.imwrite(names[-1], image)
        done = subprocess.run(
            [str(program), str(shape), str(settings), kind, *pose],
            input='\n'.join(names) + '\n', capture_output=True, text=True, timeout=300,
            env={**os.environ, 'OMP_NUM_THREADS': '1', 'OPENBLAS_NUM_THREADS': '1'}, check=True)
    rows = np.array([[float(word) for word in line.split()]
                     for line in done.stdout.splitlines() if line[:2] in ('0 ', '1 ')])
    return rotation_matrix(rows[:, 4:7]), rows[:, 1:4], rows[:, 7] / 1000
