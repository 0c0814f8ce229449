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
"""Camera files of other programs: what those programs read and write, half pixels and all."""

import json
import re

import cv2
import numpy as np
import pytest
from selfcal_ros.errors import ArgumentError, InputError
from selfcal_ros.geometry.camera import Camera, PARAMETER_NAMES
from selfcal_ros.geometry.lenses.catalogue import LENS_MODELS
from selfcal_ros.report.camera_files.formats import (FORMATS, read_camera, read_cameras,
                                                     write_camera)

K = np.array([[520.123456789012, 0, 319.5], [0, 519.0, 1 / 3 + 240], [0, 0, 1]])
LENSES = {
    'none': ('plumb_bob', []),
    'radial': ('plumb_bob', [-0.12, 0.05]),
    'radtan': ('plumb_bob', [-0.12, 0.05, 1e-05, -2e-17]),
    'plumb_bob': ('plumb_bob', [-0.12, 0.05, 1e-3, -2e-3, 0.01]),
    'rational': ('rational_polynomial', [0.3, 0.05, 1e-3, -2e-3, 0.01, 0.4, 0.08, 0.002]),
    'equidistant': ('equidistant', [-0.02, 0.01, -0.004, 0.0007]),
    'fov': ('fov', [0.93]),
    'ucm': ('ucm', [1.3, 0, 0, 0, 0]),
    'mei': ('ucm', [1.3, -0.2, 0.05, 1e-3, -2e-3]),
    'eucm': ('eucm', [0.58, 1.1]),
    'double_sphere': ('double_sphere', [-0.21, 0.59]),
}
#: Which lenses each format can hold.
HELD = {'ros': {'none', 'radial', 'radtan', 'plumb_bob', 'rational', 'equidistant'},
        'opencv': {'none', 'radial', 'radtan', 'plumb_bob', 'rational', 'equidistant'},
        'kalibr': {'none', 'radial', 'radtan', 'equidistant', 'fov', 'ucm', 'mei', 'eucm',
                   'double_sphere'},
        'colmap': set(LENSES) - {'ucm', 'mei', 'double_sphere'},
        'mrcal': {'none', 'radial', 'radtan', 'plumb_bob', 'rational'}}
SUFFIX = {'ros': ['.yaml'], 'opencv': ['.yml', '.xml'], 'kalibr': ['.yaml'],
          'colmap': ['.txt', '.bin'], 'mrcal': ['.cameramodel']}
PLACES = [(kind, suffix) for kind, suffixes in SUFFIX.items() for suffix in suffixes]


def lens(name):
    """Return a camera with one of the lenses."""
    model, coefficients = LENSES[name]
    return Camera(K, coefficients, 640, 480, model)


def rays():
    """Return rays over a field of view of 80 degrees."""
    x, y = np.meshgrid(np.linspace(-0.8, 0.8, 9), np.linspace(-0.6, 0.6, 7))
    return np.stack([x, y, np.ones_like(x)], axis=-1).reshape(-1, 3)


@pytest.mark.parametrize('name', LENSES)
@pytest.mark.parametrize('kind, suffix', PLACES)
def test_a_round_trip_is_exact_or_refused_with_what_would_do(tmp_path, kind, suffix, name):
    camera, path = lens(name), tmp_path / ('camera' + suffix)
    if name not in HELD[kind]:
        with pytest.raises(ArgumentError, match='has no model for .* have') as refusal:
            write_camera(path, kind, camera)
        for other, form in FORMATS.items():
            assert (form.title in str(refusal.value).split(';')[1]) == (name in HELD[other])
        assert not path.exists()
        return
    write_camera(path, kind, camera, 'front', '/front/image_raw')
    found, cameras = read_cameras(path)
    assert found == kind and len(cameras) == 1
    back = cameras[0].camera
    assert (back.width, back.height) == (640, 480)
    exact = 0 if kind != 'colmap' else 1e-13 * 320
    assert np.abs(back.K - K).max() <= exact
    assert np.array_equal(back.distortion_as(camera.model), camera.distortion)
    if kind == 'ros':
        assert cameras[0].name == 'front'
    if kind == 'kalibr':
        assert cameras[0].topic == '/front/image_raw'


@pytest.mark.parametrize('first', HELD)
@pytest.mark.parametrize('second', HELD)
def test_every_way_between_formats_keeps_the_projection(tmp_path, first, second):
    for name in HELD[first] & HELD[second]:
        path = tmp_path / f'{name}_a{SUFFIX[first][0]}'
        write_camera(path, first, lens(name))
        other = tmp_path / f'{name}_b{SUFFIX[second][-1]}'
        write_camera(other, second, read_camera(path).camera)
        back = read_camera(other).camera
        assert np.abs(back.project(rays()) - lens(name).project(rays())).max() < 1e-9


@pytest.mark.parametrize('suffix', ['.yml', '.xml'])
@pytest.mark.parametrize('name', sorted(HELD['opencv']))
def test_opencv_reads_what_we_write_and_projects_alike(tmp_path, suffix, name):
    path, camera = tmp_path / ('camera' + suffix), lens(name)
    write_camera(path, 'opencv', camera)
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_READ)
    assert storage.isOpened()
    matrix, d = (storage.getNode(key).mat() for key in ('camera_matrix',
                                                        'distortion_coefficients'))
    size = [int(storage.getNode(key).real()) for key in ('image_width', 'image_height')]
    fisheye = bool(storage.getNode('fisheye_model').real())
    storage.release()
    assert np.array_equal(matrix, K) and size == [640, 480]
    points, still = rays()[:, None], np.zeros(3)
    seen = (cv2.fisheye.projectPoints(points, still, still, matrix, d) if fisheye
            else cv2.projectPoints(points, still, still, matrix, d))[0]
    assert np.abs(seen[:, 0] - camera.project(rays())).max() < 1e-9


@pytest.mark.parametrize('suffix', ['.yml', '.yaml', '.xml', '.json'])
@pytest.mark.parametrize('keys', [
    ('camera_matrix', 'distortion_coefficients', 'image_width', 'image_height'),
    ('Camera_Matrix', 'Distortion_Coefficients', 'image_Width', 'image_Height'),
    ('cameraMatrix', 'distCoeffs', 'width', 'height'), ('K', 'D', 'imageWidth', 'imageHeight'),
])
def test_we_read_what_opencv_writes(tmp_path, suffix, keys):
    path = tmp_path / ('opencv' + suffix)
    d = np.array([[-0.12, 1e-5, 1 / 3, 0, 2e-17]])
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    storage.write('calibration_time', 'Sat 21 Nov 2026 06:00:00')
    for key, value in zip(keys, (K, d.T, 640, 480)):
        storage.write(key, value)
    storage.release()
    kind, (found,) = read_cameras(path)
    assert kind == 'opencv'
    assert np.array_equal(found.camera.K, K) and np.array_equal(found.camera.distortion, d[0])
    assert (found.camera.width, found.camera.height) == (640, 480)


def test_opencv_files_of_a_stereo_pair_a_fisheye_and_without_size(tmp_path):
    path = tmp_path / 'stereo.yml'
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    for number, focal in ((1, 1.0), (2, 1.1)):
        storage.write(f'M{number}', np.diag([focal, focal, 1]) @ K)
        storage.write(f'D{number}', np.array([[0.1, 0, 0, 0]]))
    storage.release()
    with pytest.raises(InputError, match='2 cameras, choose one with --camera: 1, 2'):
        read_camera(path)
    second = read_camera(path, '2', image_size=(640, 480)).camera
    assert second.K[0, 0] == 1.1 * K[0, 0] and (second.width, second.height) == (640, 480)
    assert read_camera(path, '1', fisheye=True).camera.model == 'equidistant'
    with pytest.raises(InputError, match='no camera 3'):
        read_camera(path, '3')
    with pytest.raises(ArgumentError, match='--image-size'):
        write_camera(tmp_path / 'a.txt', 'colmap', read_camera(path, '1').camera)


@pytest.mark.parametrize('suffix', ['.txt', '.bin'])
@pytest.mark.parametrize('name', sorted(HELD['colmap']))
def test_colmap_reads_what_we_write_and_sees_half_a_pixel_more(tmp_path, suffix, name):
    pycolmap = pytest.importorskip('pycolmap')
    camera = lens(name)
    write_camera(tmp_path / ('cameras' + suffix), 'colmap', camera)
    for other in ('images', 'points3D', 'rigs', 'frames'):
        empty = bytes(8) if suffix == '.bin' else b''
        (tmp_path / (other + suffix)).write_bytes(empty)
    model = pycolmap.Reconstruction()
    (model.read_binary if suffix == '.bin' else model.read_text)(str(tmp_path))
    theirs = model.cameras[1]
    assert (theirs.width, theirs.height) == (640, 480)
    seen = np.array(theirs.img_from_cam(rays()))
    assert np.abs(seen - 0.5 - camera.project(rays())).max() < 1e-9
    assert read_camera(tmp_path).camera.model in (camera.model, 'plumb_bob')


@pytest.mark.parametrize('binary', [False, True])
@pytest.mark.parametrize('model, d', [
    ('SIMPLE_PINHOLE', []), ('PINHOLE', []), ('SIMPLE_RADIAL', [-0.1]), ('RADIAL', [-0.1, 0.02]),
    ('OPENCV', [-0.1, 0.02, 1e-3, 2e-3]), ('OPENCV_FISHEYE', [-0.02, 0.01, -0.004, 0.0007]),
    ('FULL_OPENCV', [0.3, 0.05, 1e-3, -2e-3, 0.01, 0.4, 0.08, 0.002]), ('FOV', [0.9]),
    ('SIMPLE_RADIAL_FISHEYE', [-0.02]), ('RADIAL_FISHEYE', [-0.02, 0.01]),
    ('SIMPLE_FISHEYE', []), ('FISHEYE', []), ('EUCM', [0.5, 1.1])])
def test_we_read_what_colmap_writes(tmp_path, model, d, binary):
    pycolmap = pytest.importorskip('pycolmap')
    if not hasattr(pycolmap.CameraModelId, model):
        pytest.skip(f'this COLMAP has no model {model}')
    simple = 'SIMPLE' in model or model in ('RADIAL', 'RADIAL_FISHEYE')
    focal = [500.0] if simple else [500.0, 505.0]
    theirs = pycolmap.Camera(camera_id=7, model=model, width=640, height=480,
                             params=[*focal, 321.0, 239.0, *d])
    reconstruction = pycolmap.Reconstruction()
    reconstruction.add_camera(theirs)
    (reconstruction.write_binary if binary else reconstruction.write_text)(str(tmp_path))
    found = read_camera(tmp_path, '7')
    seen = np.array(theirs.img_from_cam(rays()))
    assert np.abs(found.camera.project(rays()) + 0.5 - seen).max() < 1e-9


KALIBR = """\
cam0:
  cam_overlaps: [1]
  camera_model: pinhole
  distortion_coeffs: [-0.28, 0.07, 0.0002, 1.8e-05]
  distortion_model: radtan
  intrinsics: [458.6, 457.2, 367.2, 248.3]
  resolution: [752, 480]
  rostopic: /cam0/image_raw
cam1:
  T_cn_cnm1:
  - [1.0, 0.0, 0.0, 0.1]
  - [0.0, 1.0, 0.0, 0.0]
  - [0.0, 0.0, 1.0, 0.0]
  - [0.0, 0.0, 0.0, 1.0]
  cam_overlaps: [0]
  camera_model: pinhole
  distortion_coeffs: [0.01, 0.02, -0.03, 0.004]
  distortion_model: equidistant
  intrinsics: [457.5, 456.1, 379.9, 255.2]
  resolution: [752, 480]
  rostopic: /cam1/image_raw
"""


def written(tmp_path, text, name='camera.yaml'):
    """Write a file and return its path."""
    path = tmp_path / name
    path.write_text(text, encoding='utf-8')
    return path


def test_a_chain_of_kalibr(tmp_path):
    path = written(tmp_path, KALIBR)
    with pytest.raises(InputError, match='choose one with --camera: cam0, cam1'):
        read_camera(path)
    first, second = (read_camera(path, name) for name in ('cam0', 'cam1'))
    assert first.camera.model == 'plumb_bob' and first.topic == '/cam0/image_raw'
    assert first.camera.distortion.tolist() == [-0.28, 0.07, 0.0002, 1.8e-05, 0]
    assert second.camera.model == 'equidistant' and second.camera.K[1, 2] == 255.2
    # the keys of an OpenCV fisheye
    back = written(tmp_path, '', 'back.xml')
    write_camera(back, 'opencv', second.camera)
    assert '<fisheye_model>1</fisheye_model>' in back.read_text(encoding='utf-8')


#: As mrcal 2 writes it, shortened, with an apostrophe where its comments have one.
MRCAL = """\
# generated on 2020-11-14 21:49:59 with   mrcal-calibrate-cameras --lensmodel LENSMODEL_OPENCV8
{
    'lensmodel':  'LENSMODEL_OPENCV8',

    # intrinsics are fx,fy,cx,cy,distortion0,distortion1,....
    'intrinsics': [ 1761.18, 1761.25, 1965.70, 1087.51, -0.01266, 0.03590, -2.5e-4, 5.2e-4,
                    0.01968, 0.01482, -0.05622, 0.05002,],

    'valid_intrinsics_region': [
    [ 622, 0 ],
    [ 0, 634 ],
],
    # extrinsics are rt_fromref
    'extrinsics': [ 2e-2, -3e-1, -1e-2,  1., 2, -3., ],

    'imagersize': [ 4000, 2200,],

    'icam_intrinsics': None,

    # a chunk of data that isn't useful for humans
    'optimization_inputs': b'P)h>@6aWAK2mk;8#"{[+-(000*}',
}
"""


def test_a_camera_model_of_mrcal(tmp_path):
    path = written(tmp_path, MRCAL, 'left.cameramodel')
    found, (stored,) = read_cameras(path)
    camera = stored.camera
    assert found == 'mrcal' and camera.model == 'rational_polynomial'
    assert (camera.width, camera.height) == (4000, 2200)
    assert camera.K[0, 0] == 1761.18 and camera.K[1, 2] == 1087.51
    assert camera.distortion.tolist() == [-0.01266, 0.03590, -2.5e-4, 5.2e-4, 0.01968, 0.01482,
                                          -0.05622, 0.05002]
    # by its content, under any name
    assert read_cameras(written(tmp_path, MRCAL, 'left.txt'))[0] == 'mrcal'
    for name, model in (('none', 'PINHOLE'), ('radtan', 'OPENCV4'), ('plumb_bob', 'OPENCV5'),
                        ('rational', 'OPENCV8')):
        write_camera(path, 'mrcal', lens(name))
        assert f"'LENSMODEL_{model}'" in path.read_text(encoding='utf-8')


@pytest.mark.parametrize('coefficients, fisheye, counts', [
    ([0.1, 0.2, 0.3], True, 'takes 4.'), ([0.1] * 5, True, 'takes 4.'),
    ([0.1, 0.2, 0.3], False, 'takes 4, 5, 8, 12, 14.')])
def test_another_number_of_coefficients_is_refused(tmp_path, coefficients, fisheye, counts):
    path = tmp_path / 'camera.yml'
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    storage.write('camera_matrix', K)
    storage.write('distortion_coefficients', np.array([coefficients]))
    storage.release()
    with pytest.raises(InputError, match=re.escape(counts)):
        read_camera(path, fisheye=fisheye)


XML = ('<?xml version="1.0"?><opencv_storage><camera_matrix type_id="opencv-matrix"><rows>3</rows>'
       '<cols>3</cols><dt>d</dt><data>5. 0. 3. 0. 5. 2. 0. 0. 1.</data></camera_matrix>'
       '</opencv_storage>')


@pytest.mark.parametrize('name, text, words', [
    ('a.yaml', KALIBR.replace('camera_model: pinhole', 'camera_model: omni', 1),
     'xi fu fv pu pv'),
    ('a.yaml', KALIBR.replace('camera_model: pinhole', 'camera_model: eucm', 1), 'eucm-none'),
    ('a.yaml', KALIBR.replace('radtan', 'wavy'), 'wavy'),
    ('a.yaml', KALIBR.replace('[458.6, 457.2, 367.2, 248.3]', '[458.6, 457.2]'),
     'fu fv pu pv'),
    ('a.yaml', KALIBR.replace('[458.6, 457.2, 367.2, 248.3]', '12'), 'list'),
    ('a.yaml', KALIBR.replace('[-0.28, 0.07, 0.0002, 1.8e-05]', '[-0.28]'), '4 coefficients'),
    ('a.yaml', KALIBR.replace('  resolution: [752, 480]\n', ''), 'lacks its resolution'),
    ('a.yaml', KALIBR.replace('752', '-3'), 'positive integer'),
    ('a.yaml', KALIBR.replace('458.6', 'inf'), 'not finite'),
    ('a.yaml', KALIBR.replace('458.6', '-458.6'), 'positive focal'),
    ('a.xml', XML, 'no distortion_coefficients'),
    ('a.xml', XML.replace('camera_matrix', 'homography'), 'without a camera'),
    ('a.xml', XML.replace('<opencv_storage>', '<!DOCTYPE x [<!ENTITY a "b">]><opencv_storage>'),
     'entities'),
    ('a.xml', XML[:-20], 'not valid XML'),
    ('a.json', '{"camera_matrix": {"type_id": "opencv-matrix"', 'not valid JSON'),
    ('a.json', '{"status": "calibrated"}', 'neither a result.json'),
    ('a.json', '{' * 100_000, 'neither'),
    ('a.json', '{"status": "not_calibrated", "reason": "no parallax.", "advice": ""}',
     'no parallax.'),
    ('a.txt', '1 OPENCV 640 480 500 500 320\n', 'OPENCV has 8 parameters'),
    ('a.txt', '1 OPENCV 640 480 x\n', 'line 1: expected'),
    ('a.txt', '1 DIVISION 640 480 1 1 1 1 1\n', 'no exact counterpart'),
    ('a.txt', '1 EUCM 640 480 1 1 1 1 1.5 1\n', 'between 0 and 1'),
    ('a.txt', '1 PINHOLE 640 -480 500 500 320 240\n', 'positive image size'),
    ('a.txt', '1 PINHOLE 640 480 nan 500 320 240\n', 'finite'),
    ('a.txt', '# Camera list with one line of data per camera:\n', 'without cameras'),
    ('a.txt', 'hello\n', 'no keys'),
    ('a.bin', 'hello', 'no cameras.bin'),
    ('a.cameramodel', 'hello', 'not one dictionary'),
    ('a.cameramodel', MRCAL.replace('OPENCV8', 'CAHVORE'), 'CAHVORE of mrcal has no exact'),
    ('a.cameramodel', MRCAL.replace(
        'OPENCV8', 'SPLINED_STEREOGRAPHIC_order=3_Nx=30_Ny=20_fov_x_deg=170'),
     'mrcal-convert-lensmodel'),
    ('a.cameramodel', MRCAL.replace('0.05002,', ''), '12 intrinsics'),
    ('a.cameramodel', MRCAL.replace('4000', '0'), 'positive integer'),
    ('a.cameramodel', MRCAL.replace('1761.18', '[1]'), 'not a number'),
    ('a.cameramodel', MRCAL.replace('1761.18', '1e999'), 'not finite'),
    ('a.cameramodel', MRCAL.replace('1761.18', 'exit()'), 'not one dictionary'),
    ('a.cameramodel', MRCAL.replace('1761.18', '1' + '+1' * 100_000), 'not one dictionary'),
    ('a.cameramodel', MRCAL.replace('1761.18', '-' * 100_000 + '1'), 'not one dictionary'),
    ('a.cameramodel', '(' * 100_000, 'not one dictionary'),
    ('a.cameramodel', MRCAL.replace("    'imagersize'", "    'size'"), 'lacks its lensmodel'),
    ('a.bin', '\x01' + '\0' * 11 + '\x63' + '\0' * 40, 'no camera model 99'),
])
def test_wrong_files_are_refused_in_a_sentence(tmp_path, name, text, words):
    path = written(tmp_path, text, name)
    with pytest.raises(InputError, match=re.escape(words)) as refusal:
        read_camera(path, 'cam0' if 'cam0' in text else None)
    assert str(refusal.value).startswith(str(path)) and str(refusal.value).endswith('.')
    assert len(str(refusal.value)) < 600


def test_skew_is_refused_where_the_program_would_drop_it(tmp_path):
    skewed = Camera(K + [[0, 0.4, 0], [0, 0, 0], [0, 0, 0]], [], 640, 480)
    for kind in ('opencv', 'kalibr', 'colmap'):
        with pytest.raises(ArgumentError, match='knows no skew, and this camera has 0.4 px'):
            write_camera(tmp_path / 'a', kind, skewed)
    write_camera(tmp_path / 'a.yaml', 'ros', skewed)
    assert read_camera(tmp_path / 'a.yaml').camera.K[0, 1] == 0.4
    path = written(tmp_path, XML.replace('5. 0. 3.', '5. 1. 3.').replace(
        '</opencv_storage>', '<d><rows>1</rows><cols>1</cols><data>0</data></d></opencv_storage>'),
        'a.xml')
    with pytest.raises(InputError, match='skew of 1 px'):
        read_camera(path)


def test_thin_prisms_are_refused_and_zeros_are_not(tmp_path):
    path = tmp_path / 'camera.yml'
    for coefficients, fine in (([0.1] * 5 + [0.0] * 9, True), ([0.1] * 12, False)):
        storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
        storage.write('camera_matrix', K)
        storage.write('distortion_coefficients', np.array([coefficients]))
        storage.release()
        if fine:
            assert read_camera(path).camera.model == 'plumb_bob'
        else:
            with pytest.raises(InputError, match='thin prisms'):
                read_camera(path)


def test_result_json_is_a_camera_with_its_covariance(tmp_path):
    content = {
        'status': 'calibrated', 'motion': 'planar', 'parameters': {'fx': 'estimated'},
        'held_by': {}, 'frames': {'used': [0, 1]}, 'reprojection_rms_px': 0.1,
        'noise_sigma_px': 0.1, 'observations': 10, 'outliers': 0, 'notes': [],
        'covariance': np.eye(len(PARAMETER_NAMES)).tolist(), 'facts': {'principal_point': [1, 2]},
        'camera': {'width': 640, 'height': 480, 'fx': 500, 'fy': 501, 'cx': 320, 'cy': 240,
                   'skew': 0, 'd': [0.1, 0, 0, 0, 0]}}
    found = read_camera(written(tmp_path, json.dumps(content), 'result.json'))
    assert found.camera.K[1, 1] == 501
    assert np.array_equal(found.covariance, np.eye(len(PARAMETER_NAMES)))
    # before k3 was estimated a file had nine parameters, with their names; k3 was held
    content['parameter_names'] = PARAMETER_NAMES[:-1]
    content['covariance'] = np.eye(len(PARAMETER_NAMES) - 1).tolist()
    older = read_camera(written(tmp_path, json.dumps(content), 'result.json'))
    assert np.array_equal(older.covariance, np.diag([1.0] * 9 + [0]))
    for covariance in ([[1]], np.eye(11).tolist(), 1):
        with pytest.raises(InputError, match='neither'):
            read_camera(written(tmp_path, json.dumps({**content, 'covariance': covariance}),
                                'result.json'))


@pytest.mark.parametrize('name', LENSES)
def test_rays_undo_the_projection(name):
    camera = lens(name)
    u, v = np.meshgrid(np.linspace(0, 639, 9), np.linspace(0, 479, 7))
    pixels = np.stack([u, v], axis=-1)
    seen = camera.rays(pixels)
    assert np.abs(np.linalg.norm(seen, axis=-1) - 1).max() < 1e-12
    assert np.abs(camera.project(seen) - pixels).max() < 1e-6


def test_where_a_lens_sees_nothing_there_is_nan():
    # the polynomial of the angle turns at 60 degrees
    folded = Camera(K, [-1 / (3 * np.radians(60)**2)], 640, 480, 'equidistant')
    angle = np.radians([30, 59, 61])
    there = np.stack([np.sin(angle), 0 * angle, np.cos(angle)], axis=-1)
    pixels = folded.project(there)
    assert np.isfinite(pixels[:2]).all() and np.isnan(pixels[2]).all()
    assert np.abs(folded.rays(pixels[:2]) - there[:2]).max() < 1e-9
    assert np.isnan(folded.rays([[320 + 520 * 3.0, 240]])).all()
    barrel = Camera(K, [-0.4, 0, 0, 0, 0, 0.1], 640, 480, 'rational_polynomial')
    assert np.isnan(barrel.rays([[320 + 520 * 3.0, 240]])).all()
    assert np.isnan(lens('radtan').project([[0.1, 0.1, -1]])).all()


def test_impossible_lenses():
    for model, d in (('magic', []), ('fov', []), ('fov', [4]), ('equidistant', [np.nan]),
                     ('plumb_bob', [0] * 6)):
        with pytest.raises(ArgumentError):
            Camera(K, d, model=model)
    assert set(LENS_MODELS) == {model for model, _ in LENSES.values()}
    for model, d in (('ucm', [-0.1]), ('eucm', [1.1, 1]), ('eucm', [0.5, 0]),
                     ('double_sphere', [-1, 0.5]), ('double_sphere', [0, 1.5])):
        with pytest.raises(ArgumentError, match=f'lens model {model} '):
            Camera(K, d, model=model)
    with pytest.raises(ArgumentError, match='fov is not supported'):
        lens('fov').as_model('plumb_bob')
