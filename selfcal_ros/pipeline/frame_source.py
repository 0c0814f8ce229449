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
"""What every source of frames offers."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal, Self

import numpy as np

from selfcal_ros.errors import DamagedImage, InputError
from selfcal_ros.findings.finding import Finding
from selfcal_ros.pipeline.excerpt import Excerpt, Reading
from selfcal_ros.values.tracks import Tracks


#: Kinds of sources, and where their stamps come from; see `FrameSource`.
SourceKind = Literal['', 'bag', 'images', 'video', 'tracks']
ClockName = Literal['header', 'log', 'video', 'nominal', 'none']
#: Clocks whose stamps tell when an image was taken.
OWN_CLOCKS: tuple[ClockName, ...] = ('header', 'log', 'video')


@dataclass(frozen=True)
class Frame:
    """
    One image of a source.

    Attributes
    ----------
    index : int
        Count of the image in its recording, from 0; an excerpt leaves some out.
    stamp_ns : int
        Acquisition time in nanoseconds; see `FrameSource.clock`.
    image : ndarray of uint8, shape (H, W)
        Grey.
    frame_id : str
        Coordinate frame of the camera; empty where the source does not name one.
    name : str
        What to call this image before a user: a file name, or the like of 'frame 7'.
    bgr : ndarray of uint8, shape (H, W, 3), or None
        Colour, where the source was opened with colour=True and the image has colours.

    """

    index: int
    stamp_ns: int
    image: np.ndarray
    frame_id: str = ''
    name: str = ''
    bgr: np.ndarray | None = None

    def changed(self, change: Callable[[np.ndarray], np.ndarray]) -> Frame:
        """Return the frame with something done to the image, in grey and in colour."""
        return replace(self, image=change(self.image),
                       bgr=None if self.bgr is None else change(self.bgr))


class _Pairs:
    """The first two of every `stride` image numbers, for `FrameSource.pairs`."""

    def __init__(self, stride: int) -> None:
        self._stride = stride

    def __contains__(self, index: object) -> bool:
        return isinstance(index, int) and index % self._stride < 2


class FrameSource(ABC):
    """
    Frames, one at a time; a context manager, and iterable more than once.

    Every iteration starts at the first frame, and holds one frame in memory. What an excerpt
    leaves out is not decoded. Errors of the input
    are InputErrors, raised on opening or at the frame that is wrong.

    Attributes
    ----------
    kind : {'bag', 'images', 'video', 'tracks'}
    description : str
        The source in a few words, for a person.
    path : Path
    topic : str
        Topic of a bag; empty otherwise.
    frame_id : str
        Coordinate frame of the camera in the first message of a bag; empty otherwise.
    image_size : (int, int) or None
        Width and height in pixels.
    count : int or None
        Number of frames. An estimate for videos and for excerpts.
    excerpt : Excerpt
        The part of the recording that is used.
    began_ns : int
        Stamp of the first image of the recording, whatever the excerpt.
    ended_ns : int or None
        About that of the last one, where it is known.
    clock : {'header', 'log', 'video', 'nominal', 'none'}
        Where the stamps come from: the header of the message, the recorder's log (where headers
        are zero), the video's frame rate, or made up at 30 Hz because image files have no clock.
    leaves_out_damaged : bool
        Pass over damaged images after the first, and count them; otherwise they are errors.
    deinterlaces : bool
        Use the even rows of interlaced images alone, and count these.

    """

    kind: SourceKind = ''
    clock: ClockName = 'none'

    def __init__(self, path: str | Path, image_size: tuple[int, int] | None = None,
                 colour: bool = False, excerpt: Excerpt = Excerpt()) -> None:
        """Keep what all sources have."""
        self.path = Path(path)
        self._colour = colour
        self.excerpt = excerpt
        self.began_ns = 0
        self.ended_ns: int | None = None
        self.description = ''
        self.topic = ''
        self.frame_id = ''
        self.count: int | None = None
        self._stated_size = None if image_size is None else (int(image_size[0]),
                                                             int(image_size[1]))
        self.image_size = self._stated_size
        self.leaves_out_damaged = False
        self._damaged: dict[int, tuple[str, str]] = {}
        self.deinterlaces = False
        self._interlaced: set[int] = set()
        self._turned: set[int] = set()

    @property
    def has_own_clock(self) -> bool:
        """Tell whether the stamps say when the images were taken."""
        return self.clock in OWN_CLOCKS

    @property
    def names(self) -> list[str]:
        """File names of all images, in the order of their frames; empty where none has one."""
        return []

    def __enter__(self) -> Self:
        """Return the source itself."""
        return self

    def __exit__(self, *_: object) -> None:
        """Close the source."""
        self.close()

    def __len__(self) -> int:
        """Return the number of frames; TypeError where it is not known."""
        if self.count is None:
            raise TypeError(f'the number of frames of {self.path} is not known')
        return self.count

    def __bool__(self) -> bool:
        """Be true, whatever the number of frames."""
        return True

    def __iter__(self) -> Iterator[Frame]:
        """Iterate over the frames from the first."""
        reading = Reading(self.excerpt)
        yield from self._read(reading)
        if not reading.used:
            raise self._beyond_the_end(reading.past_s)

    def only(self, indices: Iterable[int]) -> Iterator[Frame]:
        """
        Iterate over some of the frames; the others are not decoded.

        Parameters
        ----------
        indices : iterable of int
            `Frame.index` of the frames, in any order; those that there are not are passed over.

        """
        wanted = {int(index) for index in indices}
        if wanted:
            yield from self._read(Reading(self.excerpt, wanted))

    def pairs(self, stride: int) -> Iterator[Frame]:
        """Iterate over images number 0, 1, stride, stride + 1, ...; others are not decoded."""
        yield from self._read(Reading(self.excerpt, _Pairs(stride)))

    @abstractmethod
    def _read(self, reading: Reading) -> Iterator[Frame]:
        """Iterate over the recording, and decode what the reading uses."""

    def tracks(self) -> Tracks:
        """
        Return the tracks of a source of kind 'tracks'.

        Raises
        ------
        InputError
            If the source holds images.

        """
        raise InputError(f'{self.path} holds images, not tracks.')

    def losses(self) -> tuple[Finding, ...]:
        """Tell of images that were passed over so far, or used in part."""
        told: tuple[Finding, ...] = ()
        if self._interlaced:
            told += Finding('images_interlaced', count=len(self._interlaced)),
        if self._turned and self.image_size is not None:
            width, height = self.image_size
            told += Finding('images_turned', count=len(self._turned), width=width,
                            height=height),
        if not self._damaged:
            return told
        name, why = self._damaged[min(self._damaged)]
        return Finding('images_damaged', count=len(self._damaged), first=name, why=why), *told

    def close(self) -> None:
        """Release what is open; may be called twice."""

    def _refuse(self, error: InputError, index: int, name: str, where: str) -> None:
        """Pass over a damaged image where that is wanted; otherwise say where it is."""
        text = str(error)
        if self.leaves_out_damaged and index and isinstance(error, DamagedImage):
            self._damaged[index] = name, text.rstrip('.')
            return
        raise type(error)(text if where in text else f'{where}: {text}') from error

    def _beyond_the_end(self, lasts_s: float) -> InputError:
        return InputError(f'{self.path} lasts {lasts_s:.1f} s, so there is no image '
                          f'{self.excerpt.start_s:g} s after the first; begin earlier.')

    def _cut(self, rate_hz: float) -> None:
        """Count the frames of the excerpt; InputError where it surely begins beyond the end."""
        if self.count is None or self.excerpt.is_whole or rate_hz <= 0:
            return
        lasts_s = (self.count - 1) / rate_hz
        if self.excerpt.start_s > lasts_s + 1.0:
            raise self._beyond_the_end(lasts_s)
        self.count = self.excerpt.among(self.count, rate_hz)

    def _see_first(self) -> bool:
        """Learn the image size from the first frame of the recording; False if there is none."""
        if self.excerpt != Excerpt():
            self.description += f', {self.excerpt}'
        first = next(self._read(Reading(Excerpt())), None)
        if first is not None:
            self.image_size = first.image.shape[1], first.image.shape[0]
            self.began_ns = first.stamp_ns
        return first is not None

    def _checked(self, frame: Frame) -> Frame:
        """Take what is used of a frame; refuse a size that differs from those before."""
        if self.excerpt.half is not None:
            frame = frame.changed(self.excerpt.cut)
        if self.deinterlaces:
            from selfcal_ros.features.interlaced import is_interlaced, of_even_rows
            if is_interlaced(frame.image):
                self._interlaced.add(frame.index)
                frame = frame.changed(of_even_rows)
        size = frame.image.shape[1], frame.image.shape[0]
        if self.image_size is None:
            self.image_size = size
        if size != self.image_size:
            had = f'{self.image_size[0]}x{self.image_size[1]}'
            if frame.index == 0 and self._stated_size:
                raise InputError(f'{self.path}: {frame.name} is {size[0]}x{size[1]}, but the '
                                 f'stated image size is {had}; correct the image size.')
            raise InputError(f'{self.path}: the images change size at {frame.name} from {had} to '
                             f'{size[0]}x{size[1]}; split the input there, because one '
                             'calibration holds for one size.')
        return frame
