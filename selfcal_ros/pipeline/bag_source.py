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
"""Frames from rosbag2 (mcap, sqlite3) and ROS 1 bags, read by rosbags."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from msg_adapters.image import ImageDecoder
from msg_adapters.stamps import stamp_ns

from selfcal_ros.errors import InputError, SelfcalError
from selfcal_ros.findings.finding import Finding
from selfcal_ros.pipeline.bag_files import check_files, format_name
from selfcal_ros.pipeline.bag_limits import BagLimit, bound_rosbags
from selfcal_ros.pipeline.excerpt import Excerpt, Reading
from selfcal_ros.pipeline.frame_source import Frame, FrameSource

IMAGE_TYPES = ('sensor_msgs/msg/Image', 'sensor_msgs/msg/CompressedImage')
BAG_SUFFIXES = ('.mcap', '.db3', '.bag')
#: What image_transport adds to the name of a topic for the same images, compressed.
COMPRESSED = '/compressed'
#: Raw images are preferred, where there are so many of them for each compressed one.
_ENOUGH = 0.9


@contextmanager
def readable(path: str | Path) -> Iterator[None]:
    """
    Turn whatever a damaged bag makes rosbags raise into an InputError.

    Besides its own errors these are assertions, struct errors, those of SQLite, zstd and lz4,
    KeyErrors, MemoryErrors and so on, hence the wide net.
    """
    try:
        yield
    except SelfcalError:
        raise
    except BagLimit as error:
        raise InputError(f'{path} cannot be read: {error}.') from None
    except Exception as error:
        detail = ' '.join(str(error).split())[:160].rstrip('.') or type(error).__name__
        raise InputError(f'{path} cannot be read as a bag; it is damaged, truncated or was not '
                         f'closed by the recorder ({detail}); {_remedy(Path(path))}.') from error


def _remedy(path: Path) -> str:
    """Name the tool that saves what a damaged bag still holds."""
    if path.suffix == '.bag':
        return 'try `rosbag reindex` on it'
    if path.suffix == '.db3':
        return 'try `sqlite3` with `.recover` on it'
    if path.suffix == '.mcap':
        return 'try `mcap recover` on it'
    if any(path.glob('*.mcap')):
        return 'try `mcap recover` on its file, then `ros2 bag reindex`'
    return 'try `ros2 bag reindex` on it'


def is_bag_folder(path: Path) -> bool:
    """Tell a rosbag2 folder from a folder of images."""
    if any(entry.suffix in ('.mcap', '.db3') for entry in path.iterdir()):
        return True
    metadata = path / 'metadata.yaml'
    if not metadata.is_file():
        return False
    with metadata.open('rb') as stream:
        return b'rosbag2_bagfile_information' in stream.read(100_000)


def is_bag(path: Path) -> bool:
    """Tell whether something is named like a file of a bag, or is a folder that holds one."""
    return path.suffix in BAG_SUFFIXES or path.is_dir() and is_bag_folder(path)


class BagSource(FrameSource):
    """
    Images of one topic of a bag.

    Parameters
    ----------
    path : Path
        A rosbag2 folder, an .mcap, .db3 or .bag file.
    topic : str, optional
        By default the only topic with images.
    image_size : (int, int), optional
        Refuse images of another size.
    colour : bool
        Give the frames in colour, too.
    excerpt : Excerpt
        The part that is used.

    Raises
    ------
    InputError
        If the bag is damaged, or the topic is missing, ambiguous or without images.

    """

    kind = 'bag'

    def __init__(self, path: str | Path, topic: str | None = None,
                 image_size: tuple[int, int] | None = None, colour: bool = False,
                 excerpt: Excerpt = Excerpt()) -> None:
        """Open the bag and choose the topic."""
        super().__init__(path, image_size, colour, excerpt)
        self._reader: Any = None
        self._asked = self._twin = ''
        self._frame_ids: dict[str, None] = {}
        self._disordered = 0
        check_files(self.path)
        with readable(self.path):
            self._reader, self._deserialize = _opened(self.path)
        try:
            self._connections = self._choose(topic)
            self.topic = self._connections[0].topic
            self.count = self._announced = sum(
                connection.msgcount for connection in self._connections)
            self.description = (f'{format_name(self.path)} {self.path.name}, topic '
                                f'{self.topic}, {self.count} images')
            if not excerpt.is_whole and self._reader.duration > 0:
                self._cut(1e9 * max(self._announced - 1, 1) / self._reader.duration)
            self._peek()
        except BaseException:
            self.close()
            raise

    def _choose(self, topic: str | None) -> list[Any]:
        """Return the connections of the topic."""
        connections = list(self._reader.connections)
        images = [c for c in connections if c.msgtype in IMAGE_TYPES]
        counts: dict[str, int] = {}
        for connection in images:
            counts[connection.topic] = counts.get(connection.topic, 0) + connection.msgcount
        listing = ', '.join(f'{name} ({number})' for name, number in sorted(counts.items()))
        if topic:
            wanted = [c for c in connections if c.topic in (topic, f'/{topic}')]
            beside = [c for c in images if c.topic in (topic + COMPRESSED,
                                                       f'/{topic}{COMPRESSED}')]
            if beside and not sum(c.msgcount for c in wanted):
                # recorded are the same images in another coding
                wanted, self._asked = beside, topic
            if not wanted:
                there = f'its image topics are {listing}' if images else 'it holds no images'
                meant = _nearest(topic, list(counts))
                there += f'; perhaps {meant} is meant' if meant else ''
                raise InputError(f'{self.path} has no topic {topic}; {there}.')
            chosen = [c for c in wanted if c.msgtype in IMAGE_TYPES]
            if not chosen:
                there = f'its image topics are {listing}' if images else 'it holds no images'
                raise InputError(f'The topic {topic} of {self.path} carries {wanted[0].msgtype}, '
                                 f'not images; {there}.')
        else:
            filled = self._of_one_coding({name: number for name, number in counts.items()
                                          if number})
            if counts and not filled:
                named = ', '.join(sorted(counts))
                raise InputError(f'{self.path} has no images: its image topic {named} holds no '
                                 'message.' if len(counts) == 1 else
                                 f'{self.path} has no images: its image topics {named} hold no '
                                 'messages.')
            if not filled:
                topics = sorted({c.topic for c in connections})
                there = ('it holds ' + _shortened(topics)) if topics else 'it is empty'
                raise InputError(f'{self.path} has no images (sensor_msgs Image or '
                                 f'CompressedImage); {there}; record a topic of images.')
            if len(filled) > 1:
                raise InputError(f'{self.path} has {len(filled)} image topics, choose one with '
                                 f'--topic, or several with --cameras: {listing}.')
            chosen = [c for c in images if c.topic == filled[0]]
        if not sum(c.msgcount for c in chosen):
            raise InputError(f'The topic {chosen[0].topic} of {self.path} holds no messages.')
        return chosen

    def _of_one_coding(self, counts: dict[str, int]) -> list[str]:
        """Return the topics of different cameras: of two codings of the same images, one."""
        chosen = []
        for name, number in counts.items():
            raw = name.removesuffix(COMPRESSED)
            if raw != name and raw in counts:
                continue
            coded = counts.get(name + COMPRESSED, 0)
            # of the larger messages a recorder may have lost many
            taken, other = ((name, name + COMPRESSED) if number >= _ENOUGH * coded
                            else (name + COMPRESSED, name))
            chosen.append(taken)
            self._twin = other if coded else self._twin
        return chosen

    def _peek(self) -> None:
        """Learn size, frame and clock from the first message."""
        for _, msg in self._messages():
            self.frame_id = str(msg.header.frame_id)
            self.clock = 'header' if stamp_ns(msg.header.stamp) else 'log'
            break
        self._see_first()
        # what carries no images may go on for longer
        self.ended_ns = self.began_ns + int(self._reader.duration)

    def _messages(self) -> Iterator[tuple[int, Any]]:
        """Yield log time and message; raise InputError if fewer come than the bag announces."""
        if self._reader is None:
            raise InputError(f'{self.path} is closed.')
        seen = 0
        with readable(self.path):
            for connection, log_ns, data in self._reader.messages(self._connections):
                seen += 1
                yield log_ns, self._deserialize(data, connection.msgtype)
        if seen < self._announced:
            raise InputError(f'{self.path} announces {self._announced} images on {self.topic} but '
                             f'holds only {seen}; it is truncated.')

    def _read(self, reading: Reading) -> Iterator[Frame]:
        """Iterate over the images in the order of recording."""
        decoder, before, disordered = ImageDecoder(), -1, 0
        for index, (log_ns, msg) in enumerate(self._messages()):
            name = f'frame {index}'
            stamp = stamp_ns(msg.header.stamp) if self.clock != 'log' else int(log_ns)
            self._frame_ids.setdefault(str(msg.header.frame_id))
            disordered += stamp <= before
            # a recording may be read in parts, and more than once
            before, self._disordered = stamp, max(self._disordered, disordered)
            if not reading.uses(index, stamp):
                if reading.is_over(index):
                    return
                continue
            try:
                image = decoder.grey(msg)
                bgr = decoder.colour(msg) if self._colour else None
            except InputError as error:
                self._refuse(error, index, name, f'{self.path}, {self.topic}, {name}')
                continue
            yield self._checked(Frame(index, stamp, image, str(msg.header.frame_id), name, bgr))

    def losses(self) -> tuple[Finding, ...]:
        """Tell of what is odd: damaged images, topics taken for others, frames, stamps."""
        told = super().losses()
        if self._asked:
            told = Finding('compressed_taken', asked=self._asked, taken=self.topic), *told
        if self._twin:
            told = Finding('one_coding_taken', taken=self.topic, other=self._twin), *told
        if len(self._frame_ids) > 1:
            first, second, *_ = self._frame_ids
            told = *told, Finding('frames_differ', first=first, second=second)
        if self._disordered:
            told = *told, Finding('stamps_disordered', count=self._disordered)
        return told

    def close(self) -> None:
        """Close the bag."""
        reader, self._reader = self._reader, None
        if reader is not None:
            with readable(self.path):
                reader.close()


def _nearest(topic: str, names: list[str]) -> str:
    """Return the one topic that ends like this, or is spelt nearly so; '' if there is none."""
    ending = [name for name in names
              if f'{name.removesuffix(COMPRESSED)}/'.endswith(f'/{topic.strip("/")}/')]
    if len(ending) == 1:
        return ending[0]
    from difflib import get_close_matches
    return next(iter(get_close_matches(topic, names, 1)), '')


def image_topics(path: str | Path) -> list[str]:
    """
    List the image topics of a bag that hold messages, raw rather than compressed ones.

    Raises
    ------
    InputError
        If the bag is damaged.

    """
    path = Path(path)
    check_files(path)
    with readable(path):
        reader, _ = _opened(path)
        names = {connection.topic for connection in reader.connections
                 if connection.msgtype in IMAGE_TYPES and connection.msgcount}
        reader.close()
    # the same images in another coding would count twice
    return sorted(name for name in names
                  if not (name.endswith(COMPRESSED) and name.removesuffix(COMPRESSED) in names))


def has_image_topic(path: str | Path, topic: str) -> bool:
    """
    Tell whether something is a bag with images on a topic.

    Raises
    ------
    InputError
        If the bag is damaged.

    """
    path = Path(path)
    if not (path.is_file() and path.suffix in BAG_SUFFIXES or is_bag_folder(path)):
        return False
    with open_bag(path) as bag:
        return any(connection.topic in (topic, f'/{topic}') and connection.msgcount
                   and connection.msgtype in IMAGE_TYPES for connection in bag.connections)


class OpenBag:
    """
    A bag whose messages of any topic are read; made by `open_bag`.

    Attributes
    ----------
    connections : list
        Of rosbags: topic, msgtype, msgcount and id of each.

    """

    def __init__(self, path: Path, reader: Any, deserialize: Callable[[Any, str], Any]) -> None:
        """Keep what reads."""
        self._path, self._reader, self._deserialize = path, reader, deserialize
        self.connections = list(reader.connections)

    def messages(self, connections: list[Any]) -> Iterator[tuple[Any, Any]]:
        """Yield connection and message in the order of recording."""
        with readable(self._path):
            for connection, _, data in self._reader.messages(connections):
                yield connection, self._deserialize(data, connection.msgtype)


@contextmanager
def open_bag(path: str | Path) -> Iterator[OpenBag]:
    """
    Open a bag for messages other than images.

    Raises
    ------
    InputError
        If it is damaged.

    """
    path = Path(path)
    check_files(path)
    with readable(path):
        reader, deserialize = _opened(path)
    try:
        yield OpenBag(path, reader, deserialize)
    finally:
        reader.close()


def _opened(path: Path) -> tuple[Any, Callable[[Any, str], Any]]:
    """Return an open reader of rosbags, and what turns its data into messages."""
    from rosbags.typesys import Stores, get_typestore
    bound_rosbags()
    # image messages never changed their layout, so fixed type stores are enough, and the type
    # definitions inside a bag need not be trusted
    if path.suffix == '.bag' and path.is_file():
        from rosbags import rosbag1
        deserialize = get_typestore(Stores.ROS1_NOETIC).deserialize_ros1
        reader: Any = rosbag1.Reader(path)
    else:
        from rosbags import rosbag2
        deserialize = get_typestore(Stores.ROS2_JAZZY).deserialize_cdr
        reader = rosbag2.Reader(path)
    reader.open()
    return reader, deserialize


def _shortened(names: list[str], limit: int = 12) -> str:
    """List names, not too many."""
    more = f' and {len(names) - limit} more' if len(names) > limit else ''
    return ', '.join(names[:limit]) + more
