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
"""What camera_info_publisher serves: files of OpenCV as well, and none that is a trap."""

import cv2
import numpy as np
import pytest
from selfcal_ros.errors import InputError
from selfcal_ros.report.copied_camera_yaml import read_copied_camera, write_copied_camera

K = np.array([[505, 0, 322.5], [0, 506, 241.5], [0, 0, 1]])
D = np.array([[-0.1, 0.02, 0.001, -0.002, 0.003]])


@pytest.mark.parametrize('suffix', ['xml', 'yml', 'json'])
def test_what_opencv_itself_wrote_is_served_exactly(tmp_path, suffix):
    path = tmp_path / f'camera.{suffix}'
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    for key, value in (('calibration_time', 'today'), ('image_width', 640), ('image_height', 480),
                       ('camera_matrix', K), ('distortion_coefficients', D)):
        storage.write(key, value)
    storage.release()
    camera, name = read_copied_camera(path)
    assert name == '' and (camera.width, camera.height, camera.model) == (640, 480, 'plumb_bob')
    assert np.array_equal(camera.K, K) and np.array_equal(camera.d, D[0])
    assert np.array_equal(camera.P, np.column_stack([K, np.zeros(3)]))
    again = tmp_path / 'again.yaml'
    write_copied_camera(again, camera, 'front')
    assert np.array_equal(read_copied_camera(again)[0].d, D[0])
    with pytest.raises(InputError, match='end in .yaml'):
        write_copied_camera(tmp_path / 'served.xml', camera, 'front')


@pytest.mark.parametrize('text', [
    '<!DOCTYPE x [<!ENTITY a "aaaa"><!ENTITY b "&a;&a;">]><opencv_storage>&b;</opencv_storage>',
    '<opencv_storage>' + '<a>' * 200_000, '<opencv_storage><camera_matrix>'])
def test_xml_that_is_a_trap_is_one_sentence(tmp_path, text):
    path = tmp_path / 'camera.xml'
    path.write_text(text, encoding='utf-8')
    with pytest.raises(InputError) as told:
        read_copied_camera(path)
    assert str(told.value).count('\n') == 0 and 'camera.xml' in str(told.value)
