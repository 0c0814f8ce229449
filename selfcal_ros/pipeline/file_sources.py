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
"""Frames from image folders and videos, and tracks from CSV files."""

from __future__ import annotations

from collections.abc import Iterator
import csv
import itertools
import os
from pathlib import Path
import re

import cv2

from msg_adapters.image import ImageDecoder

from selfcal_ros.errors import InputError
from selfcal_ros.findings.finding import Finding
from selfcal_ros.pipeline.excerpt import Excerpt, Reading
from selfcal_ros.pipeline.frame_source import ClockName, Frame, FrameSource
from selfcal_ros.values.foreign_files import read_limited
from selfcal_ros.values.image_headers import is_turned, MAX_FILE_BYTES
from selfcal_ros.values.tracks import Tracks

IMAGE_SUFFIXES = ('.png', '.jpg', '.jpeg', '.bmp', '.tif', '.tiff', '.pgm', '.ppm')
VIDEO_SUFFIXES = ('.mp4', '.avi', '.mkv', '.mov', '.m4v', '.webm', '.mpg', '.mpeg', '.ogv',
                  '.wmv')
#: Decoders hold many frames at once: 67 million pixels, twice those of 8K.
MAX_VIDEO_PIXELS = 2 ** 26
#: Image files have no clock; their stamps count frames at this rate.
NOMINAL_RATE_HZ = 30
#: The header of a video may announce so many frames more than there are.
MISCOUNTED = 5


def natural_key(name: str) -> list[tuple[int, int, str]]:
    """Return a key that sorts frame2 before frame10."""
    return [(0, int(part), '') if part.isdecimal() else (1, 0, part)
            for part in re.split(r'(\d+)', name.lower()) if part]


class ImageFolderSource(FrameSource):
    """
    The images of a folder in natural order; other files and hidden files are passed over.

    Parameters
    ----------
    path : Path
    image_size : (int, int), optional
        Refuse images of another size.
    colour : bool
        Give the frames in colour, too.
    excerpt : Excerpt
        The part that is used.

    Raises
    ------
    InputError
        If the folder holds no images, or the first one cannot be read.

    """

    kind = 'images'
    clock = 'nominal'

    def __init__(self, path: str | Path, image_size: tuple[int, int] | None = None,
                 colour: bool = False, excerpt: Excerpt = Excerpt()) -> None:
        """List the folder."""
        super().__init__(path, image_size, colour, excerpt)
        try:
            entries = [e for e in self.path.iterdir() if not e.name.startswith('.')]
        except OSError as error:
            raise InputError(f'{self.path} cannot be listed: {error.strerror}.') from None
        self._files = sorted((e for e in entries if e.suffix.lower() in IMAGE_SUFFIXES and
                              e.is_file()), key=lambda e: (natural_key(e.name), e.name))
        lost = sorted(e.name for e in entries if e.suffix.lower() in IMAGE_SUFFIXES
                      and e.is_symlink() and not e.exists())
        if lost:
            raise InputError(f'{self.path / lost[0]} is a link to a file that is not there'
                             f'{f", as are {len(lost) - 1} more" if len(lost) > 1 else ""}; '
                             'restore what the links lead to, or remove them.')
        if not self._files:
            raise InputError(self._nothing_here(entries))
        self.count = len(self._files)
        self.description = f'image folder {self.path.name}, {self.count} images'
        self._cut(NOMINAL_RATE_HZ)
        self._see_first()

    @property
    def names(self) -> list[str]:
        """File names of all images, in the order of their frames."""
        return [file.name for file in self._files]

    def _nothing_here(self, entries: list[Path]) -> str:
        """Say what the folder holds instead of images."""
        if not entries:
            return f'The folder {self.path} is empty; give one that holds images or a bag.'
        inner = [e for e in sorted(entries) if e.is_dir() and any(
            f.suffix.lower() in IMAGE_SUFFIXES for f in e.iterdir())]
        if inner:
            more = ('' if len(inner) == 1 else ', or name folders of cameras that move together: '
                    f'--cameras {",".join(one.name for one in inner[:4])}')
            return f'The folder {self.path} holds no images itself; give {inner[0]} instead{more}.'
        names = ', '.join(sorted(e.name for e in entries)[:4])
        others = 'only' if len(entries) == 1 else f'{len(entries)} other entries, such as'
        return (f'The folder {self.path} holds no images ({", ".join(IMAGE_SUFFIXES)}) and no '
                f'rosbag2 recording, but {others} {names}.')

    def _read(self, reading: Reading) -> Iterator[Frame]:
        """Iterate over the images in natural order."""
        decoder = ImageDecoder()
        for index, file in enumerate(self._files):
            stamp = index * 1_000_000_000 // NOMINAL_RATE_HZ
            if not reading.uses(index, stamp):
                if reading.is_over(index):
                    return
                continue
            try:
                data = read_limited(file, MAX_FILE_BYTES, 'The image')
                image = decoder.file_grey(data)
                bgr = decoder.file_colour(data) if self._colour else None
            except InputError as error:
                self._refuse(error, index, file.name, str(file))
                continue
            if is_turned(data):
                self._turned.add(index)
            yield self._checked(Frame(index, stamp, image, '', file.name, bgr))


class VideoSource(FrameSource):
    """
    The frames of a video file, in the orientation of the sensor.

    Parameters are those of `ImageFolderSource`.

    Raises
    ------
    InputError
        If OpenCV cannot open the video or decode its first frame.

    """

    kind = 'video'
    clock: ClockName = 'video'

    def __init__(self, path: str | Path, image_size: tuple[int, int] | None = None,
                 colour: bool = False, excerpt: Excerpt = Excerpt()) -> None:
        """Open the video and decode its first frame."""
        super().__init__(path, image_size, colour, excerpt)
        capture = self._open()
        try:
            size = [capture.get(one) for one in (cv2.CAP_PROP_FRAME_WIDTH,
                                                 cv2.CAP_PROP_FRAME_HEIGHT)]
            if size[0] * size[1] > MAX_VIDEO_PIXELS:
                raise InputError(f'{self.path} announces frames of {size[0]:.0f} x {size[1]:.0f} '
                                 'pixels, which are too large for a video.')
            count = capture.get(cv2.CAP_PROP_FRAME_COUNT)
            rate = capture.get(cv2.CAP_PROP_FPS)
        finally:
            capture.release()
        self.count = int(count) if 0 < count < 1e9 else None
        # without a rate in the file the stamps are as nominal as those of image files
        self._rate_hz = rate if 0.01 < rate < 1e5 else float(NOMINAL_RATE_HZ)
        self.clock = 'video' if self._rate_hz == rate else 'nominal'
        about = f'about {self.count} frames' if self.count else 'length unknown'
        self.description = f'video {self.path.name}, {about} at {self._rate_hz:.4g} Hz'
        self._announced, self._ended = self.count or 0, 0
        self._cut(self._rate_hz)
        if not self._see_first():
            raise InputError(f'{self.path} opens as a video, but no frame can be decoded; it is '
                             'damaged or uses a codec that this OpenCV lacks.')

    def _open(self) -> cv2.VideoCapture:
        """Return an opened cv2.VideoCapture."""
        if not self.path.stat().st_size:
            raise InputError(f'{self.path} is empty (0 bytes); give another file.')
        # FFmpeg's own complaint would stand before our sentence
        os.environ.setdefault('OPENCV_FFMPEG_LOGLEVEL', '-8')
        try:
            # an absolute path cannot be mistaken for an address or a pipeline
            capture = cv2.VideoCapture(str(self.path.resolve()))
            opened = capture.isOpened()
        except cv2.error:
            opened = False
        if not opened:
            raise InputError(f'{self.path} cannot be opened as a video; it is damaged, truncated '
                             'or uses a codec that this OpenCV lacks; give it anew, or a folder '
                             'of its images.')
        capture.set(cv2.CAP_PROP_ORIENTATION_AUTO, 0)
        return capture

    def _read(self, reading: Reading) -> Iterator[Frame]:
        """Iterate over the frames."""
        capture = self._open()
        turned = capture.get(cv2.CAP_PROP_ORIENTATION_META) % 360 != 0
        try:
            for index in itertools.count():
                stamp = round(index * 1e9 / self._rate_hz)
                try:
                    if not capture.grab():
                        self._ended = index
                        return
                    if not reading.uses(index, stamp):
                        if reading.is_over(index):
                            return
                        continue
                    there, bgr = capture.retrieve()
                except cv2.error as error:
                    raise InputError(f'{self.path}: frame {index} cannot be decoded '
                                     f'({error.err}).') from None
                if not there:
                    self._ended = index
                    return
                image = bgr if bgr.ndim == 2 else cv2.cvtColor(bgr, cv2.COLOR_BGR2GRAY)
                if turned:
                    self._turned.add(index)
                yield self._checked(Frame(index, stamp, image, '', f'frame {index}',
                                          bgr if self._colour else None))
        finally:
            capture.release()

    def losses(self) -> tuple[Finding, ...]:
        """Tell of frames that the header announces and the file does not hold."""
        told = super().losses()
        if not 0 < self._ended < self._announced - max(MISCOUNTED, self._announced // 10):
            return told
        return *told, Finding('video_ends_early', frames=self._ended, announced=self._announced)


class TracksSource(FrameSource):
    """
    Tracks from a CSV file with the columns frame, track, x, y; it has no frames to iterate over.

    Parameters
    ----------
    path : Path
    image_size : (int, int), optional
        Width and height in pixels, which the file does not tell.

    Raises
    ------
    InputError
        If the file is wrong; the sentence names the line.

    """

    kind = 'tracks'

    def __init__(self, path: str | Path, image_size: tuple[int, int] | None = None) -> None:
        """Read the file."""
        super().__init__(path, image_size)
        try:
            self._tracks = Tracks.from_csv(self.path, self.image_size)
        except InputError as error:
            text = str(error)
            raise InputError(text if str(self.path) in text else f'{self.path}: {text}') from error
        except OSError as error:
            raise InputError(f'{self.path} cannot be read: {error.strerror}.') from None
        except (ValueError, OverflowError) as error:
            # a NUL byte, an endless field, a number beyond 64 bits
            raise InputError(f'{self.path} is no table of tracks ({error}).') from None
        except csv.Error as error:
            raise InputError(f'{self.path} is no CSV file ({error}).') from None
        self.count = len(self._tracks.frames)
        self.description = (f'tracks {self.path.name}, {len(self._tracks)} observations in '
                            f'{self.count} frames')

    def __iter__(self) -> Iterator[Frame]:
        """Refuse: there are no images."""
        return self._read(Reading(self.excerpt))

    def _read(self, reading: Reading) -> Iterator[Frame]:
        """Refuse: there are no images."""
        raise InputError(f'{self.path} holds tracks, not images.')

    def tracks(self) -> Tracks:
        """Return the tracks."""
        return self._tracks
