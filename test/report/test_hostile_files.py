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
"""Camera files, models and images made to hang or to fill the memory are one sentence, at once."""

import json
import os

import cv2
import numpy as np
import pytest
from selfcal_ros.errors import InputError
from selfcal_ros.features.mask import read_mask
from selfcal_ros.report.camera_files.formats import read_camera
from selfcal_ros.report.camera_yaml import read_camera_yaml
from selfcal_ros.rorapid.acquisition.picked_vertices import read_picked
from selfcal_ros.rorapid.estimation.initial_pose import read_pose_file
from selfcal_ros.rorapid.model import read_model
from selfcal_ros.values.image_headers import check_image
from selfcal_ros.values.known_object import KnownObject
from selfcal_ros.values.tracks import Tracks


def refusal(reader, path):
    """Return the one sentence with which a reader refuses a file."""
    with pytest.raises(InputError) as caught:
        reader(path)
    sentence = str(caught.value)
    assert sentence.endswith('.') and '\n' not in sentence and len(sentence) < 400
    return sentence


def doubling(first, following):
    """Return 60 lines of YAML, each of twice as many entries as the one before."""
    return first + ''.join(following.format(k, k - 1) for k in range(1, 60))


BOMBS = {'alias': doubling('a0: &a0 [1, 1]\n', 'a{0}: &a{0} [*a{1}, *a{1}]\n'),
         'merge': doubling('a0: &a0 {x: 1}\n', 'a{0}: &a{0}\n  <<: [*a{1}, *a{1}]\n'),
         'itself': 'a: &a [*a]\n'}


@pytest.mark.parametrize('bomb', BOMBS)
@pytest.mark.parametrize('reader', [read_camera, read_camera_yaml, read_model, read_picked])
def test_yaml_of_aliases_of_aliases(tmp_path, reader, bomb):
    path = tmp_path / 'bomb.yaml'
    path.write_text(BOMBS[bomb], encoding='utf-8')
    assert 'by aliases' in refusal(reader, path)


@pytest.mark.parametrize('opening', ['[', '{', '- ', '? ', '{a: ', '[{'])
def test_yaml_that_is_nested_without_end(tmp_path, opening):
    path = tmp_path / 'deep.yaml'
    path.write_text('a:\n  ' + opening * 200_000, encoding='utf-8')
    for reader in (read_camera, read_model):
        assert 'not valid YAML' in refusal(reader, path)


def test_aliases_may_be(tmp_path):
    path = tmp_path / 'model.yaml'
    path.write_text('points: [&o [0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]]\n'
                    'faces: [&f [0, 1, 2]]\nlines: [[0, 3]]\n'
                    'conics:\n- {centre: *o, axis_u: [1, 0, 0], axis_v: [0, 1, 0]}\n',
                    encoding='utf-8')
    assert len(read_model(path).conics) == 1


@pytest.mark.parametrize('name, text', [
    ('c.xml', '<opencv_storage>' + '<!--' * 250_000),
    ('c.xml', '<opencv_storage>' + '<!-- --><!' * 90_000),
    ('c.txt', '\n' * 990_000), ('c.txt', ' ' * 990_000), ('c.json', '{' + ' ' * 990_000),
    ('c.cameramodel', "{'lensmodel': '" + "\\'" * 400_000),
    ('c.cameramodel', "{'lensmodel': [" + '1,' * 600_000)])
def test_texts_that_regular_expressions_choke_on(tmp_path, name, text):
    path = tmp_path / name
    path.write_text(text, encoding='utf-8')
    refusal(read_camera, path)


def test_models_that_regular_expressions_choke_on_or_load_each_other_too_deeply(tmp_path):
    for k in range(200):
        (tmp_path / f'{k}.cao').write_text(f'V1\nload("{k + 1}.cao")\n', encoding='utf-8')
    assert 'deep' in refusal(read_model, tmp_path / '0.cao')
    path = tmp_path / 'wide.cao'
    path.write_text('V1\nload("x", t=[1' + ' ' * 300_000 + 'x; 0; 0])\n', encoding='utf-8')
    refusal(read_model, path)
    path.write_text('V1\n2\n0 0 0\n1 0 0\n1\n0 1 ' + 'name=a ' * 200_000 + '\n0\n0\n0\n0\n',
                    encoding='utf-8')
    assert len(read_model(path).lines) == 1
    path.write_text('V1\n' + f'load("{tmp_path}/heavy.cao")\n' * 20, encoding='utf-8')
    (tmp_path / 'heavy.cao').write_text('V1\n#' + 'x' * 600_000 + '\n0' * 6, encoding='utf-8')
    assert 'longer' in refusal(read_model, path)


#: A result.json as it should be.
RESULT = {'schema': 2, 'status': 'calibrated', 'motion': 'planar', 'facts': {}, 'parameters': {},
          'held_by': {}, 'frames': {'used': [0, 1]}, 'reprojection_rms_px': 0.1,
          'noise_sigma_px': 0.1, 'observations': 10, 'outliers': 0, 'notes': [],
          'camera': {'width': 640, 'height': 480, 'fx': 500.0, 'fy': 500.0, 'cx': 320.0,
                     'cy': 240.0, 'skew': 0.0, 'distortion_model': 'plumb_bob', 'd': [0.0] * 5},
          'covariance': np.eye(10).tolist()}


def test_a_result_with_values_of_any_other_kind_is_a_camera_or_a_sentence(tmp_path):
    path = tmp_path / 'result.json'
    path.write_text(json.dumps(RESULT), encoding='utf-8')
    assert read_camera(path).camera.width == 640
    odd = ['1e999', '-1e999', 'null', '"x"', '[]', '{}', '[[1]]', '9' * 400, '-1', 'true', '0.5']
    places = [('camera', key) for key in RESULT['camera']] + [(key,) for key in RESULT]
    for place in places:
        for value in odd:
            content = json.loads(json.dumps(RESULT))
            inner = content[place[0]] if len(place) == 2 else content
            inner[place[-1]] = '@'
            path.write_text(json.dumps(content).replace('"@"', value), encoding='utf-8')
            try:
                read_camera(path)
            except InputError as error:
                assert str(error).endswith('.')


@pytest.mark.skipif(not os.path.exists('/dev/zero'), reason='there is no /dev/zero here')
@pytest.mark.parametrize('reader', [read_camera, read_model, read_pose_file, read_mask])
def test_devices_and_pipes_without_a_writer_are_no_files(tmp_path, reader):
    for suffix in ('.yaml', '.png'):
        link = tmp_path / f'zero{suffix}'
        link.symlink_to('/dev/zero')
        refusal(reader, link)
        pipe = tmp_path / f'pipe{suffix}'
        os.mkfifo(pipe)
        refusal(reader, pipe)


def announced(kind):
    """Return a small image whose header announces 16384 x 16384 pixels."""
    side = 16384
    done, data = cv2.imencode(kind, np.zeros((16, 16), np.uint8))
    data = bytearray(data.tobytes())
    if kind == '.png':
        data[16:24] = side.to_bytes(4, 'big') * 2
    elif kind == '.jpg':
        at = data.index(b'\xff\xc0') + 5
        data[at:at + 4] = side.to_bytes(2, 'big') * 2
    elif kind == '.bmp':
        data[18:26] = side.to_bytes(4, 'little') * 2
    elif kind == '.tiff':
        start = int.from_bytes(data[4:8], 'little') + 2
        for at in range(start, len(data) - 12, 12):
            if data[at:at + 2] in (b'\x00\x01', b'\x01\x01'):
                data[at + 8:at + 12] = side.to_bytes(4, 'little')
    else:
        data = data.replace(b'16 16', b'16384 16384')
    return bytes(data)


@pytest.mark.parametrize('kind', ['.png', '.jpg', '.bmp', '.tiff', '.pgm'])
def test_headers_that_announce_more_than_there_is(kind):
    check_image(cv2.imencode(kind, np.zeros((16, 16), np.uint8))[1].tobytes())
    with pytest.raises(InputError, match='16384 x 16384'):
        check_image(announced(kind))


@pytest.mark.parametrize('frame', [[0, 0.5], [0, np.nan], [0, np.inf], ['a', 'b'], [None, 1],
                                   [0, 2**63], [0, 1j]])
def test_frame_and_track_numbers_are_whole(frame):
    for one, other in ((frame, [0, 1]), ([0, 1], frame)):
        with pytest.raises(InputError, match='whole numbers'):
            Tracks(one, other, np.zeros((2, 2)))
    with pytest.raises(InputError, match='identities of a known object must be whole numbers'):
        KnownObject(frame, np.zeros((2, 3)))
    assert Tracks([0.0, 1.0], [0, 1], np.zeros((2, 2))).frame.dtype == np.int64


def test_tracks_with_a_byte_order_mark(tmp_path):
    path = tmp_path / 'tracks.csv'
    path.write_text('frame,track,x,y\n0,1,2,3\n', encoding='utf-8-sig')
    assert len(Tracks.from_csv(path)) == 1
