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
"""What a node says where ROS does not start: what to do, and nothing of rcl's own."""

from pathlib import Path

import pytest
import rclpy
from rclpy.context import Context
from selfcal_ros.nodes.start_failure import start_failure, unheard


@pytest.mark.parametrize('arguments, words', [
    (['--params-file', 'none.yaml'], 'The parameter file none.yaml does not exist; name another.'),
    (['--params-file', '.'], 'The parameter file . is a folder; name a file in it.'),
    (['--params-file', 'flat.yaml'], 'at line 2); it holds NODE:, in it ros__parameters:, and'),
    (['-p', 'rate'], 'rate is no rule of ROS; write --ros-args -p NAME:=VALUE.'),
    (['-r', 'image'], 'image is no rule of ROS; write --ros-args -r FROM:=TO.'),
    (['-r', '__ns:=robot1'], 'slash; write --ros-args -r __ns:=/robot1.'),
    (['-r', '__node:=my node'], '__node:=my node holds a name that ROS cannot take; use letters'),
    (['--frob'], "ROS knows no argument ['--frob']; leave it out, or put -- before it."),
    (['--log-level', 'loud'], "ROS did not start: Couldn't parse log level: '--log-level loud'.")])
def test_arguments_that_ros_refuses_are_one_sentence(tmp_path, monkeypatch, capfd, arguments,
                                                     words):
    monkeypatch.chdir(tmp_path)
    Path('flat.yaml').write_text('node:\n  rate: 3\n', encoding='utf-8')
    with pytest.raises(Exception) as caught, unheard():  # noqa: B017, its class is private
        rclpy.init(args=['--ros-args', *arguments], context=Context())
    sentence = start_failure(caught.value)
    assert words in sentence and sentence.endswith('.') and '\n' not in sentence
    assert capfd.readouterr() == ('', '')
