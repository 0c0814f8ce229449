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
"""Angular rates of a gyro from the bag that holds the images."""

from __future__ import annotations

from pathlib import Path

from msg_adapters.angular_rates import angular_rate, IMU_TYPE

import numpy as np

from selfcal_ros.errors import InputError
from selfcal_ros.pipeline.bag_source import open_bag
from selfcal_ros.values.angular_rates import AngularRates

#: Columns of a table of rates, rad/s.
COLUMNS = ('gyro_x', 'gyro_y', 'gyro_z')


def read_rate_topic(path: str | Path, topic: str) -> AngularRates | None:
    """
    Read what a gyro measured from a topic of sensor_msgs/Imu; None where it carries others.

    Raises
    ------
    InputError
        If the messages have no rates, or no stamps.

    """
    path = Path(path)
    with open_bag(path) as bag:
        chosen = [one for one in bag.connections
                  if one.topic in (topic, f'/{topic}') and one.msgtype == IMU_TYPE]
        if not chosen:
            return None
        read = [angular_rate(msg) for _, msg in bag.messages(chosen)]
    stamps = np.array([one[0] for one in read], np.int64)
    if len(read) < 2 or not stamps.any():
        raise InputError(f'The topic {topic} of {path} holds {len(read)} messages, and a gyro '
                         'needs two at least, with their stamps in the header.')
    rates = np.array([one[1] for one in read], float)
    if np.isnan(rates).all():
        raise InputError(f'The messages of {topic} in {path} say that they have no angular '
                         'velocity; name the topic of a gyro.')
    # messages that come twice are common
    first = np.unique(stamps, return_index=True)[1]
    try:
        return AngularRates(stamps[first], rates[first], read[0][2] or 'imu_link')
    except InputError as error:
        raise InputError(f'{topic} of {path}: {error}') from None
