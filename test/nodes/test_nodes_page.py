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
"""The commands of docs/nodes.md for whoever has no `ros2` do together what they promise."""

from pathlib import Path
import re
import shlex
import time

ROOT = Path(__file__).resolve().parents[2]


def _commands() -> list[list[str]]:
    """Return the words of the commands in the section on life without ros2."""
    text = (ROOT / 'docs' / 'nodes.md').read_text(encoding='utf-8')
    section = text.split('## Without the command `ros2`')[1].split('\n## ')[0]
    block = re.search(r'(?:^    \S.*\n)+', section, re.M)
    assert block is not None
    return [shlex.split(line) for line in block.group(0).splitlines()]


def test_the_nodes_of_the_page_find_each_other_and_leave_a_file(launch, tmp_path):
    (tmp_path / 'bags').symlink_to(ROOT / 'bags')
    nodes = {name: launch(name, *arguments[1:]) for name, *arguments in _commands()}
    assert set(nodes) == {'feature_tracker', 'planar_calibrator', 'bag_player'}
    player, deadline = nodes['bag_player'], time.monotonic() + 90
    while not (tmp_path / 'front.yaml').is_file():
        assert time.monotonic() < deadline, player.said
        player.has_said('')
        time.sleep(0.1)
    assert 'waiting for a subscriber on /image/compressed (30 s)' in player.said
    assert 'nobody subscribes' not in player.said
