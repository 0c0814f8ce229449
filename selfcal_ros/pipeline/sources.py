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
Open whatever holds frames: a bag, an image folder, a video, or a table of tracks.

    with open_source('drive.mcap') as source:
        for frame in source:
            frame.image          # (H, W) uint8
"""

from __future__ import annotations

from pathlib import Path

from selfcal_ros.errors import ArgumentError, InputError
from selfcal_ros.pipeline.bag_limits import is_compressed_file
from selfcal_ros.pipeline.bag_source import BAG_SUFFIXES, BagSource, is_bag_folder
from selfcal_ros.pipeline.excerpt import Excerpt
from selfcal_ros.pipeline.file_sources import (IMAGE_SUFFIXES, ImageFolderSource, TracksSource,
                                               VIDEO_SUFFIXES, VideoSource)
from selfcal_ros.pipeline.frame_source import Frame, FrameSource

__all__ = ['Excerpt', 'Frame', 'FrameSource', 'open_source']

_EXPECTED = ('expected a rosbag2 folder, an .mcap, .db3 or .bag file, an image folder, a video '
             f'({", ".join(VIDEO_SUFFIXES)}), or a .csv file of tracks')


def open_source(path: str | Path, topic: str | None = None,
                image_size: tuple[int, int] | None = None, colour: bool = False,
                excerpt: Excerpt = Excerpt()) -> FrameSource:
    """
    Open a source of frames or tracks.

    Parameters
    ----------
    path : str or Path
        A rosbag2 folder (mcap or sqlite3), an .mcap, .db3 or ROS 1 .bag file, an image folder, a
        video, or a .csv file of tracks.
    topic : str, optional
        Image topic of a bag. By default the only one that has images.
    image_size : (int, int), optional
        Width and height in pixels: needed for tracks, checked for images.
    colour : bool
        Give the frames in colour as well as in grey.
    excerpt : Excerpt
        The part of the recording that is used; of a table of tracks, all of it.

    Returns
    -------
    FrameSource
        A context manager.

    Raises
    ------
    InputError
        If the input is missing, damaged or of no known kind.
    ArgumentError
        If the image size is impossible.

    """
    path = Path(path)
    if image_size is not None and not (len(image_size) == 2 and min(image_size) > 0):
        raise ArgumentError(f'The image size must be a positive width and height, '
                            f'not {tuple(image_size)}.')
    try:
        folder, file = path.is_dir(), path.is_file()
        bag = folder and is_bag_folder(path)
    except (OSError, ValueError) as error:
        raise InputError(f'{str(path)!r:.200} cannot be opened: '
                         f'{getattr(error, "strerror", None) or error}.') from None
    if not folder and not file:
        missing = 'is neither a file nor a folder' if path.exists() else 'does not exist'
        raise InputError(f'{path} {missing}; {_EXPECTED}.')
    check_kind(path)
    suffix = path.suffix.lower()
    is_bag = bag or file and (path.suffix in BAG_SUFFIXES or is_compressed_file(path))
    if topic and not is_bag:
        raise InputError(f'{path} is no bag, so it has no topic {topic}; leave the topic out.')
    if is_bag:
        return BagSource(path, topic, image_size, colour, excerpt)
    if folder:
        return ImageFolderSource(path, image_size, colour, excerpt)
    if suffix in VIDEO_SUFFIXES:
        return VideoSource(path, image_size, colour, excerpt)
    if excerpt != Excerpt():
        raise InputError(f'{path} is a table of tracks, and a start, a duration, every how many '
                         'and a half are for images; leave them out.')
    return TracksSource(path, image_size)


def check_kind(path: str | Path) -> None:
    """
    Refuse a file that is no recording, by its name alone; what does not exist passes.

    Parameters
    ----------
    path : str or Path

    Raises
    ------
    InputError
        If it is a file of no kind that `open_source` knows.

    """
    path = Path(path)
    suffix = path.suffix.lower()
    if path.suffix in BAG_SUFFIXES or suffix in (*VIDEO_SUFFIXES, '.csv') or not path.is_file() \
            or is_compressed_file(path):
        return
    if suffix in IMAGE_SUFFIXES:
        raise InputError(f'{path} is a single image; give the folder that holds the images.')
    if path.name == 'metadata.yaml' and is_bag_folder(path.parent):
        raise InputError(f'{path} is a part of a bag; give its folder, {path.parent}.')
    raise InputError(f'{path} is of no known kind; {_EXPECTED}.')
