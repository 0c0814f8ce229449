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
"""Where the recorded sets lie, and how a bench reads images."""

from __future__ import annotations

import json
import os
from pathlib import Path
import signal
import subprocess

import cv2
import numpy as np
import selfcal_ros

#: The top of the repository.
ROOT = Path(__file__).resolve().parents[1]


def process_environment(**more: str) -> dict:
    """Environment of a process that is to import the same packages as this one."""
    here = str(Path(selfcal_ros.__file__).resolve().parents[1])
    paths = [here, *filter(None, [os.environ.get('PYTHONPATH')])]
    return {**os.environ, 'PYTHONPATH': os.pathsep.join(paths), **more}


def end(processes) -> None:
    """Interrupt processes, and kill those that do not end within five seconds."""
    for process in processes:
        process.send_signal(signal.SIGINT)
    for process in processes:
        try:
            process.wait(5)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()


def data_folder(name: str) -> Path | None:
    """Return shared/data/<name> beside the repository, or None where it is not there."""
    for parent in ROOT.parents:
        folder = parent / 'shared' / 'data' / name
        if folder.is_dir():
            return folder
    return None


def truth_of(folder: Path) -> dict:
    """Return gt.json of a recorded set, K and distortion as arrays."""
    truth = json.loads((folder / 'gt.json').read_text(encoding='utf-8'))
    for name in ('K', 'dist', 'P', 'poses'):
        if name in truth:
            truth[name] = np.array(truth[name], float)
    return truth


def image_files(folder: Path, numbers=None) -> list[Path]:
    """Return the images of a recorded set in order; `numbers` count from 1."""
    files = sorted(path for path in (folder / 'images').iterdir()
                   if path.suffix in ('.png', '.jpg'))
    return files if numbers is None else [files[number - 1] for number in numbers]


def grey_frames(files):
    """Yield (index, grey image, stamp in ns) as `extract_tracks` takes them."""
    for index, path in enumerate(files):
        yield index, cv2.imread(str(path), cv2.IMREAD_GRAYSCALE), index * 33_333_333
