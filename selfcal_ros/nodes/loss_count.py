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
"""Counts the messages that a subscription never sees, and says why they are lost."""

from __future__ import annotations

from collections import deque

#: Losses are looked at over so many looks back, one a second.
WINDOW = 10
#: Fewer than this share of the messages in the window, or fewer than these, are no news.
NEWS_FRACTION, NEWS_COUNT = 0.02, 3
#: A wider gap is that between two publishers.
WIDEST_GAP = 300
#: Default room of Fast DDS for what is sent through shared memory, in bytes.
DEFAULT_SEGMENT = 512 * 1024


class LossCount:
    """
    Counts what came of the messages of one publisher, by the numbers that it gave them.

    The middleware numbers what a publisher sends. A gap is something that was sent and never
    read. If our own queue was full at that moment, the queue has dropped it: we were too slow.
    Otherwise it was lost on the way, while there was time for it.

    Attributes
    ----------
    received : int
    lost : int
        On the way.
    overrun : int
        Dropped by our queue.
    skipped : int
        Received, and left out by whoever reads them.

    """

    def __init__(self) -> None:
        self.received = self.lost = self.overrun = self.skipped = 0
        self._newest: int | None = None
        self._bytes = 0
        self._work_s = 0.0
        self._looks: deque[tuple[int, ...]] = deque([(0, 0, 0, 0)], WINDOW + 1)
        self._said: set[str] = set()

    def begin(self) -> None:
        """Count from here on: another subscription, or another publisher."""
        self._newest = None

    def arrive(self, number: int | None, size: int = 0, *, alone: bool = True,
               overrun: bool = False) -> None:
        """
        Count a message.

        Parameters
        ----------
        number : int or None
            That of its publisher; None where the middleware does not number.
        size : int
            In bytes.
        alone : bool
            Whether its topic has one publisher only: numbers of two say nothing.
        overrun : bool
            Whether our queue was full.

        """
        self.received += 1
        self._bytes = size
        newest, self._newest = self._newest, number if alone else None
        if number is None or newest is None or not alone:
            return
        gap = number - newest - 1
        if not 0 < gap <= WIDEST_GAP:
            return
        if overrun:
            self.overrun += gap
        else:
            self.lost += gap

    def skip(self) -> None:
        """Count a message that was received and that there is no time for."""
        self.skipped += 1

    def worked(self, seconds: float) -> None:
        """Note how long the work on one message took."""
        self._work_s += 0.1 * (seconds - self._work_s) if self._work_s else seconds

    def look(self) -> None:
        """Note the counts; to be called once a second."""
        self._looks.append((self.received, self.lost, self.overrun, self.skipped))

    def _recent(self) -> tuple[int, int, int]:
        """Return what was sent, lost on the way, and had no time in the window."""
        received, lost, overrun, skipped = (
            new - old for new, old in zip(self._looks[-1], self._looks[0]))
        return received + lost + overrun, lost, overrun + skipped

    def complaint(self, what: str, topic: str, best_effort: bool) -> str:
        """
        Say what is being lost, and why; '' where that is nothing worth a word.

        Parameters
        ----------
        what : str
            Plural of what is sent.
        topic : str
        best_effort : bool
            Whether they are sent so.

        """
        sent, lost, late = self._recent()
        if late >= lost and _matters(late, sent):
            took = f' ({1000 * self._work_s:.0f} ms each)' if self._work_s else ''
            return (f'{late} of the last {sent} {what} on {topic} came while those before them '
                    f'were still worked on{took}: this computer is too slow for so many')
        if not _matters(lost, sent):
            return ''
        text = (f'{lost} of the last {sent} {what} on {topic} were lost on the way, though there '
                'was time for them')
        if best_effort and self._bytes > DEFAULT_SEGMENT:
            return (f'{text}: {self._bytes / 1e6:.1f} MB each, sent best effort, are more than '
                    'Fast DDS has room for; start the publisher with config/fastdds.xml')
        if best_effort:
            return f'{text}: they are sent best effort; let the publisher be reliable'
        return f'{text}: their publisher keeps too few; raise the depth of its queue'

    def news(self, what: str, topic: str, best_effort: bool) -> str:
        """Return a complaint once: again only after a window without such a loss."""
        _, lost, late = self._recent()
        self._said -= {kind for kind, count in (('lost', lost), ('late', late)) if not count}
        text = self.complaint(what, topic, best_effort)
        kind = 'late' if late >= lost else 'lost'
        if not text or kind in self._said:
            return ''
        self._said.add(kind)
        return text

    @property
    def values(self) -> dict[str, int]:
        """The counts, for diagnostics."""
        return {'received': self.received, 'lost on the way': self.lost,
                'no time for': self.overrun + self.skipped}


def _matters(count: int, sent: int) -> bool:
    return count >= max(NEWS_COUNT, NEWS_FRACTION * sent)
