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
"""The image messages of a bag as they were recorded, without decoding, for replay."""

from __future__ import annotations

from collections.abc import Callable, Iterator

from selfcal_ros.errors import InputError
from selfcal_ros.pipeline.bag_source import BagSource, readable


class ImageRecording(BagSource):
    """
    One image topic of a bag, message by message.

    Parameters and errors are those of `BagSource`.

    Attributes
    ----------
    message_type : str
        sensor_msgs/msg/Image or sensor_msgs/msg/CompressedImage.

    """

    @property
    def message_type(self) -> str:
        """Type of the messages."""
        return str(self._connections[0].msgtype)

    def messages(self, start_offset_s: float = 0.0) -> Iterator[tuple[int, bytes]]:
        """
        Yield the messages in the order in which they were recorded.

        Parameters
        ----------
        start_offset_s : float
            Skip so many seconds from the start of the bag.

        Yields
        ------
        log_ns : int
            Time of recording.
        content : bytes
            The message in CDR, as a ROS 2 publisher takes it.

        Raises
        ------
        InputError
            If the bag is damaged; what lies before the damage has been yielded.

        """
        if self._reader is None:
            raise InputError(f'{self.path} is closed.')
        to_cdr = self._converter()
        start = self._reader.start_time + int(start_offset_s * 1e9) if start_offset_s else None
        with readable(self.path):
            for connection, log_ns, data in self._reader.messages(self._connections, start=start):
                yield int(log_ns), bytes(to_cdr(data, connection.msgtype))

    def _converter(self) -> Callable[[bytes, str], bytes | memoryview]:
        """Return what turns the bag's bytes into CDR."""
        if self.path.suffix != '.bag' or self.path.is_dir():
            return lambda data, _: data
        from rosbags.typesys import get_typestore, Stores
        return get_typestore(Stores.ROS1_NOETIC).ros1_to_cdr
