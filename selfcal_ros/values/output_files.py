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
"""Output files that appear whole or not at all."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
import os
from pathlib import Path
import stat
import tempfile
from types import MappingProxyType

from selfcal_ros.errors import ArgumentError, InputError

#: In a folder that is an input, files named so are what is read; others may lie beside them.
RECORDED = ('.mcap', '.db3', '.bag', '.zstd', '.zst', '.png', '.jpg', '.jpeg', '.bmp', '.tif',
            '.tiff', '.pgm', '.ppm')
#: Where nobody says what names an output.
NO_OPTIONS: Mapping[str, str | os.PathLike[str] | None] = MappingProxyType({})


class OutputTaken(InputError):
    """A file that was not there before the work is there now, and is kept."""


def check_outputs(outputs: Iterable[str | os.PathLike[str] | None],
                  inputs: Iterable[str | os.PathLike[str] | None],
                  options: Mapping[str, str | os.PathLike[str] | None] = NO_OPTIONS) -> None:
    """
    Make sure beforehand that outputs can be written, and that none replaces what is read.

    Files are compared by what they are, not by name: links and `..` lead to the same one.

    Parameters
    ----------
    outputs, inputs : iterable of path or None
        None is passed over.
    options : mapping of str to path or None
        Outputs by what the user names them with.

    Raises
    ------
    InputError, ArgumentError
        If an output is an input, a part of one, or another output; see also `check_writable`.

    """
    read = [Path(path) for path in inputs if path is not None]
    seen: list[str] = []
    for output in (Path(path) for path in outputs if path is not None):
        place = os.path.realpath(output)
        if place in seen:
            named = [option for option, path in options.items()
                     if path is not None and os.path.realpath(path) == place]
            raise ArgumentError(f'{" and ".join(named) if len(named) > 1 else "Two outputs"} have '
                                f'the same name, {output}; give each its own file.')
        seen.append(place)
        for source in read:
            if _is_part(output, source):
                raise ArgumentError(f'{output} is the input {source}, or a part of it; choose '
                                    'another name for the output.')
        check_writable(output)


def _is_part(output: Path, source: Path) -> bool:
    """Tell whether writing to a file would replace what is read from a file or folder."""
    try:
        if not output.exists() or not source.exists():
            return os.path.realpath(output) == os.path.realpath(source)
        if not source.is_dir():
            return output.samefile(source)
        recorded = output.suffix.lower() in RECORDED or output.name == 'metadata.yaml'
        return recorded and any(output.samefile(one) for one in source.iterdir())
    except OSError:
        # what cannot be looked at cannot be replaced either, or is refused when it is read
        return False


def check_writable(path: str | os.PathLike[str]) -> Path:
    """
    Make sure beforehand that a file can be written, so that no long work is lost at its end.

    Permissions alone do not tell (root may write anywhere but to a read-only disk), so a
    temporary file is made in the folder and removed again.

    Returns
    -------
    Path
        The path, as a Path.

    Raises
    ------
    InputError
        If the folder is missing or cannot be written to, or the path is a folder.

    """
    path = Path(path)
    check_place(path)
    if not _is_special(path):
        name = _temporary(path)
        os.unlink(name)
    return path


@contextmanager
def claimed(folder: Path) -> Iterator[None]:
    """
    Keep other runs out of a folder; the end of the process, of whatever kind, lets them in again.

    Parameters
    ----------
    folder : Path
        It must exist. Where the file system knows no locks, nobody is kept out.

    Raises
    ------
    InputError
        If another run has claimed it.

    """
    try:
        import fcntl
        descriptor = os.open(folder, os.O_RDONLY)
    except (ImportError, OSError):
        yield
        return
    try:
        with suppress(OSError):
            try:
                fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                raise InputError(f'Another run is writing to {folder}; name another folder with '
                                 '--output-dir, or wait for its end.') from None
        yield
    finally:
        os.close(descriptor)


def atomic_write(path: str | os.PathLike[str], data: str | bytes, replace: bool = True) -> Path:
    """
    Write a file: a temporary file beside it, then renamed.

    A symbolic link is followed; a device such as /dev/null is written to, not replaced.

    Parameters
    ----------
    path : str or Path
    data : str or bytes
        Text is encoded as UTF-8, line ends as they are.
    replace : bool
        Whether a file with content may be replaced.

    Returns
    -------
    Path
        The path, as a Path.

    Raises
    ------
    OutputTaken
        If there is one that may not.
    InputError
        If the file cannot be written; what was there before is still there.

    """
    path = Path(path)
    # a file name that is not UTF-8 comes with bytes that are no characters
    data = data.encode('utf-8', 'backslashreplace') if isinstance(data, str) else bytes(data)
    check_place(path)
    try:
        if _is_special(path):
            with path.open('wb') as stream:
                stream.write(data)
            return path
        temporary = _temporary(path)
        try:
            with open(temporary, 'wb') as stream:
                stream.write(data)
                stream.flush()
                os.fsync(stream.fileno())
            os.chmod(temporary, _mode(path))
            _move(temporary, path, replace)
        except BaseException:
            os.unlink(temporary)
            raise
    except OSError as error:
        raise InputError(f'{path} cannot be written: {_why(error)}.') from None
    return path


def _move(temporary: str, path: Path, replace: bool) -> None:
    """Give a temporary file its name; where nothing is replaced, no other run can come between."""
    place = os.path.realpath(path)
    if not replace:
        try:
            os.link(temporary, place)
        except OSError:
            # it exists, or the file system has no links
            if os.path.isfile(place) and os.path.getsize(place):
                raise OutputTaken(
                    f'{path} has been made meanwhile and is kept, so it does not hold this '
                    'result; choose another name, or replace it with --force.') from None
        else:
            os.unlink(temporary)
            return
    os.replace(temporary, place)


def check_place(path: Path, makes_folders: bool = False) -> None:
    """
    Refuse folders, and files in what is no folder.

    Parameters
    ----------
    path : Path
    makes_folders : bool
        Folders that are missing will be made; else they are refused, too.

    Raises
    ------
    InputError

    """
    try:
        if path.is_dir():
            raise InputError(f'{path} is a folder; give the name of a file in it.')
        parent = Path(os.path.realpath(path)).parent
        if makes_folders:
            parent = next(one for one in (parent, *parent.parents) if one.exists())
        if not parent.exists():
            raise InputError(f'{path} cannot be written: the folder {parent} does not exist; '
                             'make it first.')
        if not parent.is_dir():
            raise InputError(f'{path} cannot be written: {parent} is not a folder; name another '
                             'file.')
    except (OSError, ValueError) as error:
        raise InputError(f'{str(path)!r:.200} cannot be written: {_why(error)}.') from None


def _is_special(path: Path) -> bool:
    """Tell devices, pipes and sockets."""
    return path.exists() and not stat.S_ISREG(path.stat().st_mode)


def _temporary(path: Path) -> str:
    """Make a temporary file where the path is."""
    parent = os.path.dirname(os.path.realpath(path))
    if os.path.exists(path) and not os.access(path, os.W_OK):
        raise InputError(f'{path} cannot be written: it is read-only.')
    try:
        descriptor, name = tempfile.mkstemp(prefix='.selfcal-', dir=parent)
    except OSError as error:
        raise refused_by_folder(path, Path(parent), error) from None
    os.close(descriptor)
    return name


def refused_by_folder(path: Path, folder: Path, error: OSError) -> InputError:
    """Return the sentence for a file or folder that cannot be made where it should be."""
    return InputError(f'{path} cannot be written: the folder {folder} refuses new files '
                      f'({_why(error)}); choose another folder.')


def _mode(path: Path) -> int:
    """Return the permissions of the file, or of a new one."""
    if path.exists():
        return stat.S_IMODE(path.stat().st_mode)
    mask = os.umask(0)
    os.umask(mask)
    return 0o666 & ~mask


def _why(error: Exception) -> str:
    """Say in words what the system refused."""
    return getattr(error, 'strerror', None) or str(error)
