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
"""The messages of TF, which not every installation has."""

from selfcal_ros.errors import InputError


def transform_type(for_what: str) -> type:
    """
    Return tf2_msgs/TFMessage.

    Parameters
    ----------
    for_what : str
        Who needs it, for the sentence.

    Raises
    ------
    InputError
        If it is not installed.

    """
    try:
        from tf2_msgs.msg import TFMessage
    except ImportError:
        raise InputError(f'{for_what} needs the package tf2_msgs (ros-jazzy-tf2-msgs), which is '
                         'not installed.') from None
    kind: type = TFMessage
    return kind
