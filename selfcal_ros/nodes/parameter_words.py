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
"""Sentences that name options of the command line, in the words of a node: its parameters."""

from __future__ import annotations

import re

#: Options and what a node has for them; the first pattern that fits holds.
_WORDS = (
    (r'--motion rotation', 'motion:=auto'),
    (r'--motion (auto|planar|general)', r'motion:=\1'),
    (r'--aspect-ratio free', 'aspect_ratio:=0.0'),
    (r'--skew free', 'zero_skew:=false'),
    (r'--skew 0', 'zero_skew:=true'),
    (r'--trust-facts', 'trust_facts:=true'),
    (r'--no-lens-population', 'lens_population:=false'),
    (r'--(?:lens|distortion) (\w+)', r'distortion:=\1'),
    (r'--(?:lens|distortion)\b', 'the parameter distortion'),
    (r'--(focal|shutter) (\w+)', r'\1:=\2'),
    (r'--camera-model (\w+)', r'camera_model:=\1'),
    (r'--model-scale ([\d.e+-]*\d)', r'model_scale:=\1'),
    (r'--model-scale', 'the parameter model_scale'),
    (r'--init FILE\.init with --clicks', 'start_pose:=FILE.pos'),
    (r'--init (")', r'start_pose:=\1'),
    (r'--init\b', 'the parameter start_pose'),
    (r'--robot-(kind|sigma|unit|frame) ([\d.:]+\d|\d)', r'robot_\1:=\2'),
    (r'--robot-(kind|sigma|unit|frame)', r'the parameter robot_\1'),
    # a node listens, and reads no table
    (r'--robot takes poses\.csv, a topic of the bag such as', 'the parameter robot takes a topic, '
     'such as'),
    (r'--robot\b(?!-)', 'the parameter robot'),
    (r'--mount-fact (\w+=)', r'mount_facts:=\1'),
    (r'--mount-fact', 'the parameter mount_facts'),
    # a node plays one camera
    (r', or several with --cameras', ''),
    (r'--topic\b', 'the parameter topic'),
    (r'--camera\b(?!-)', 'the parameter camera_file'),
)
#: What is for the command line itself stays so.
_COMMAND = re.compile(r'(`selfcal [^`]*`)')


def in_parameters(text: str) -> str:
    """
    Return a sentence with parameters of the nodes for options of the command line.

    What stands within `selfcal ...` is for the command line, and stays as it is.
    """
    if '--' not in text:
        return text
    parts = _COMMAND.split(text)
    for pattern, words in _WORDS:
        parts[::2] = [re.sub(pattern, words, part) for part in parts[::2]]
    return ''.join(parts)
