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
What `ros2` does, for machines that have the libraries of ROS and not its command line.

`run` starts what lies in lib/PACKAGE of AMENT_PREFIX_PATH, as the real one does; `topic echo
--once` and `service call` are answered by rclpy.
"""

import os
from pathlib import Path
import sys
import time


def run(package, executable, *arguments):
    """Replace this process by an executable."""
    for prefix in os.environ['AMENT_PREFIX_PATH'].split(os.pathsep):
        path = Path(prefix, 'lib', package, executable)
        if path.is_file():
            os.execv(path, [str(path), *arguments])
    sys.exit(f'No executable found: {package} {executable}')


def echo(topic):
    """Print the first CameraInfo of a topic."""
    import rclpy
    from sensor_msgs.msg import CameraInfo
    rclpy.init()
    node, heard = rclpy.create_node('echo'), []
    node.create_subscription(CameraInfo, topic, heard.append, 10)
    deadline = time.monotonic() + 60
    while not heard and time.monotonic() < deadline:
        rclpy.spin_once(node, timeout_sec=0.1)
    print('width:', heard[0].width, '\nk:', *heard[0].k)


def main(words):
    """Do what the words say."""
    if words[0] == 'run':
        run(*words[1:])
    elif words[:3] == ['topic', 'echo', '--once']:
        echo(words[3])
    else:
        sys.exit(f'not here: ros2 {" ".join(words)}')


if __name__ == '__main__':
    main(sys.argv[1:])
