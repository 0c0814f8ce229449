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
from selfcal_ros.geometry.camera import Camera

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


#: Largest time that the mapping of one configuration may take.
MAPPING_S = 900


def calibrate_lenses_with_colmap(files: list[Path], folder: Path, configurations,
                                 threads: int = 2):
    """
    Reconstruct images of one camera under several lens models.

    Features and matches are computed once; each configuration verifies the matches anew with its
    own lens and refines every parameter of it, the principal point included.

    Parameters
    ----------
    files : list of Path
    folder : Path
        Empty or of an earlier run, whose features and matches are used again.
    configurations : sequence of (str, str, Camera or None)
        Name, camera model, and the camera that COLMAP starts from; None: its own guess, a focal
        length of 1.2 times the width.
    threads : int

    Yields
    ------
    name : str
    camera : Camera or None
        None where there is no reconstruction.
    registered : int
        Number of images in it.
    seconds : float
        Processor time of features, matching, verification and mapping.

    """
    import pycolmap
    pycolmap.logging.minloglevel = 2
    database, images = folder / 'database.db', folder / 'images'
    needed = folder / 'seconds'
    if not needed.exists():
        shutil.rmtree(folder, ignore_errors=True)
        images.mkdir(parents=True)
        for path in files:
            shutil.copy(path, images / path.name)
        began = time.process_time()
        pycolmap.extract_features(
            database, images, camera_mode=pycolmap.CameraMode.SINGLE,
            extraction_options=pycolmap.FeatureExtractionOptions(num_threads=threads))
        pycolmap.match_exhaustive(
            database, matching_options=pycolmap.FeatureMatchingOptions(num_threads=threads))
        needed.write_text(str(time.process_time() - began), encoding='utf-8')
    for number, (name, model, start) in enumerate(configurations):
        began = time.process_time()
        work = folder / f'run{number}'
        shutil.rmtree(work, ignore_errors=True)
        work.mkdir()
        own = shutil.copy(database, work / 'database.db')
        _give_lens(own, model, start)
        pycolmap.geometric_verification(
            own, verifier_options=pycolmap.GeometricVerifierOptions(num_threads=threads))
        options = pycolmap.IncrementalPipelineOptions()
        options.ba_refine_principal_point = True
        options.num_threads = threads
        options.max_runtime_seconds = MAPPING_S
        found = pycolmap.incremental_mapping(own, images, work, options)
        seconds = time.process_time() - began + float(needed.read_text(encoding='utf-8'))
        if not found:
            yield name, None, 0, seconds
            continue
        best = max(found.values(), key=lambda one: one.num_reg_images())
        yield (name, _camera_of(next(iter(best.cameras.values()))), best.num_reg_images(),
               seconds)


#: Words of a vocabulary that is made of the images themselves, and vectors that it is made of.
WORDS, WORD_VECTORS = 4096, 100_000


def calibrate_sequence_with_colmap(files: list[Path], folder: Path, threads: int = 2,
                                   ) -> tuple[Camera | None, int, float]:
    """
    Reconstruct images in their order, with loops found by a vocabulary.

    Parameters
    ----------
    files : list of Path
    folder : Path
        Empty; for copies of the images and for the database.
    threads : int

    Returns
    -------
    camera : Camera or None
        SIMPLE_RADIAL, principal point fixed; None where there is no reconstruction.
    registered : int
        Number of images in it.
    seconds : float
        Processor time of features, matching and mapping. The vocabulary is not counted: users
        have one.

    """
    import pycolmap
    pycolmap.logging.minloglevel = 2
    database, images, words = folder / 'database.db', folder / 'images', folder / 'words.bin'
    images.mkdir(parents=True)
    for path in files:
        shutil.copy(path, images / path.name)
    began = time.process_time()
    reader = pycolmap.ImageReaderOptions()
    reader.camera_model = 'SIMPLE_RADIAL'
    pycolmap.extract_features(
        database, images, camera_mode=pycolmap.CameraMode.SINGLE, reader_options=reader,
        extraction_options=pycolmap.FeatureExtractionOptions(num_threads=threads))
    seconds = time.process_time() - began
    _write_vocabulary(database, words, threads)
    began = time.process_time()
    pairing = pycolmap.SequentialPairingOptions()
    pairing.loop_detection, pairing.vocab_tree_path = True, str(words)
    pairing.num_threads = threads
    pycolmap.match_sequential(
        database, pairing_options=pairing,
        matching_options=pycolmap.FeatureMatchingOptions(num_threads=threads))
    options = pycolmap.IncrementalPipelineOptions()
    options.num_threads = threads
    found = pycolmap.incremental_mapping(database, images, folder, options)
    seconds += time.process_time() - began
    if not found:
        return None, 0, seconds
    best = max(found.values(), key=lambda one: one.num_reg_images())
    return _camera_of(next(iter(best.cameras.values()))), best.num_reg_images(), seconds


def _write_vocabulary(database: Path, words: Path, threads: int) -> None:
    """Make a vocabulary of every tenth image or so."""
    import pycolmap
    rng = np.random.default_rng(0)
    with pycolmap.Database.open(database) as opened:
        names = [image.image_id for image in opened.read_all_images()]
        vectors = np.concatenate([opened.read_descriptors(name).data
                                  for name in names[::max(1, len(names) // 100)]])
    looks = pycolmap.FeatureDescriptors()
    looks.type = pycolmap.FeatureExtractorType.SIFT
    looks.data = vectors[rng.permutation(len(vectors))[:WORD_VECTORS]]
    options = pycolmap.VisualIndex.BuildOptions()
    options.num_visual_words, options.num_iterations, options.num_rounds = WORDS, 20, 1
    options.num_threads = threads
    index = pycolmap.VisualIndex.create(128, 64)
    index.build(options, looks.to_float())
    index.write(str(words))


def _give_lens(database: Path, model: str, start: Camera | None) -> None:
    """Change the model of the camera in a database, and forget what was verified with it."""
    import pycolmap
    with pycolmap.Database.open(database) as opened:
        old = opened.read_all_cameras()[0]
        new = pycolmap.Camera.create_from_model_name(
            old.camera_id, model, 1.2 * max(old.width, old.height), old.width, old.height)
        if start is not None:
            K = start.K
            new.params = [K[0, 0], K[1, 1], K[0, 2] + 0.5, K[1, 2] + 0.5, *start.distortion]
            new.has_prior_focal_length = True
        opened.update_camera(new)
        opened.clear_two_view_geometries()


def _camera_of(found) -> Camera:
    """Return COLMAP's camera as one of ours: pixel (0, 0) is the centre of the first pixel."""
    named = dict(zip(found.params_info.replace(' ', '').split(','), found.params))
    focal = named.get('f', np.nan)
    K = [[named.get('fx', focal), 0, named['cx'] - 0.5],
         [0, named.get('fy', focal), named['cy'] - 0.5], [0, 0, 1]]
    names = ('k1', 'k2', 'k3', 'k4') if 'FISHEYE' in found.model_name else ('k1', 'k2', 'p1', 'p2')
    values = [named.get(name, named.get('k', 0.0) if name == 'k1' else 0.0) for name in names]
    return Camera(K, values, found.width, found.height,
                  'equidistant' if 'FISHEYE' in found.model_name else 'plumb_bob')
