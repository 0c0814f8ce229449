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
"""Shared memory that processes left behind which were killed."""

from __future__ import annotations

from pathlib import Path
import re
import time

#: Where Fast DDS keeps what it sends between processes of one computer.
FOLDER = Path('/dev/shm')
#: One of the segments: 16 MB each, with the settings of config/fastdds.xml.
_SEGMENT = re.compile(r'fastrtps_[0-9a-f]{16}')
#: Younger ones may belong to a process that is just starting and has not locked them yet.
YOUNGEST_S = 30.0


def sweep(folder: Path = FOLDER, youngest_s: float = YOUNGEST_S) -> int:
    """
    Remove the segments of Fast DDS whose processes are no more; `fastdds shm clean` does the same.

    Each segment has a file beside it, NAME_el, that its process holds locked as long as it lives.
    A process that is killed cannot clean up, and nobody else does.

    Parameters
    ----------
    folder : Path
    youngest_s : float
        Age below which a segment is left alone.

    Returns
    -------
    int
        Number of segments that were removed.

    """
    try:
        import fcntl
    except ImportError:
        return 0
    removed = 0
    oldest = time.time() - youngest_s
    for lock in folder.glob('fastrtps_*_el'):
        segment = folder / lock.name.removesuffix('_el')
        if not _SEGMENT.fullmatch(segment.name):
            continue
        try:
            if lock.stat().st_mtime > oldest:
                continue
            with lock.open('rb') as held:
                fcntl.flock(held, fcntl.LOCK_EX | fcntl.LOCK_NB)
                segment.unlink(missing_ok=True)
                lock.unlink(missing_ok=True)
            removed += 1
        except OSError:
            # locked: its process lives; or it belongs to another user
            continue
    return removed
