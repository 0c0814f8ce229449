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
--force: no verb replaces a camera file or a model that exists without it.

The camera file of an earlier run is replaced where nobody has named it.

A camera file may be what a driver serves, and a model what somebody has worked on. Reports, tables
and pictures are made anew from the same recording, and replace those of the last run.
"""

from __future__ import annotations

import argparse
from collections.abc import Collection, Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
import os
from pathlib import Path

from selfcal_ros.cli.machine_output import STANDARD_OUTPUT
from selfcal_ros.errors import ArgumentError, InputError


def add_force_argument(parser: argparse._ActionsContainer,
                       what: str = 'replace the camera file if it exists') -> None:
    """Add the option --force to a verb, or to a group of its arguments."""
    parser.add_argument('--force', action='store_true', help=what)


def check_outputs(precious: Iterable[str | os.PathLike[str] | None],
                  inputs: Iterable[str | os.PathLike[str] | None], force: bool,
                  derived: Iterable[str | os.PathLike[str] | None] = (),
                  options: Mapping[str, str | os.PathLike[str] | None] | None = None) -> None:
    """
    Make sure before the work that outputs can be written, and replace nothing without a word.

    Folders that are missing are made.

    Parameters
    ----------
    precious : iterable of path or None
        Outputs that are kept where they exist. None and '-' are passed over; an empty file, or a
        device such as /dev/null, has nothing to lose.
    inputs : iterable of path or None
    force : bool
        Whether --force was given.
    derived : iterable of path or None
        Outputs that replace what is there.
    options : mapping of str to path or None, optional
        Outputs by their options, for the sentence about two of one name.

    Raises
    ------
    InputError, ArgumentError
        If a file exists already; see also `selfcal_ros.values.output_files.check_outputs`.

    """
    from selfcal_ros.values import output_files
    kept, others = ([path for path in paths if path is not None and str(path) != STANDARD_OUTPUT]
                    for paths in (precious, derived))
    with _folders_of([*kept, *others]):
        output_files.check_outputs([*kept, *others], inputs, options or {})
        _refuse_taken(kept, force)


def check_suffix(what: str, path: Path | None, kind: str, *suffixes: str) -> None:
    """Refuse a name that tells of another kind of file; one without a suffix tells of none."""
    if path is not None and path.suffix.lower() not in ('', *suffixes):
        raise ArgumentError(f'The {what} {path} {kind}, and must be named {suffixes[0]}.')


def _refuse_taken(kept: list[str | os.PathLike[str]], force: bool) -> None:
    """Refuse to replace what is kept."""
    taken = [] if force else [str(path) for path in kept
                              if os.path.isfile(path) and os.path.getsize(path)]
    if len(taken) == 1:
        raise InputError(f'{taken[0]} exists already; choose another name, or replace it with '
                         '--force.')
    if taken:
        raise InputError(f'{", ".join(taken[:-1])} and {taken[-1]} exist already; choose other '
                         'names, or replace them with --force.')


def is_made_here(path: Path) -> bool:
    """Tell whether a camera file comes from this package, by its first line."""
    try:
        with path.open('rb') as stream:
            return stream.readline(200).startswith(b'# selfcal_ros ')
    except OSError:
        return False


def written_line(written: Iterable[Path], replaced: Collection[Path] = ()) -> str:
    """
    Say which files a run leaves behind.

    Parameters
    ----------
    written : iterable of Path
    replaced : collection of Path
        Those of them that took the place of earlier ones.

    """
    names = [f'{path} (replaced)' if path in replaced else str(path) for path in written]
    return f'Written: {", ".join(names)}.' if names else 'Nothing was written.'


def make_folder(folder: Path) -> None:
    """
    Make a folder for outputs, unless it is there.

    Parameters
    ----------
    folder : Path

    Raises
    ------
    InputError
        If it cannot be made, or nothing can be written in it.

    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except FileExistsError:
        raise InputError(f'{folder} is a file; name a folder, or one to be made.') from None
    except OSError as error:
        there = next((parent for parent in folder.parents if parent.exists()), folder)
        what = (f'the folder {there} refuses new ones' if there.is_dir()
                else f'{there} is not a folder')
        raise InputError(f'The folder {folder} cannot be made: {what} ({error.strerror}); name '
                         'another.') from None


@contextmanager
def _folders_of(outputs: Iterable[str | os.PathLike[str]]) -> Iterator[None]:
    """Make the folders that outputs need; what is refused then leaves no empty ones."""
    folders = [Path(os.path.realpath(output)).parent for output in outputs]
    new = [place for folder in folders for place in (*reversed(folder.parents), folder)
           if not os.path.lexists(place)]
    try:
        for folder in folders:
            make_folder(folder)
        yield
    except BaseException:
        _remove_empty(new)
        raise


def _remove_empty(folders: list[Path]) -> None:
    """Remove folders, the last first; what holds something stays."""
    for place in reversed(folders):
        with suppress(OSError):
            place.rmdir()


@contextmanager
def output_folder(folder: Path, *inside: str) -> Iterator[None]:
    """
    Make a folder that belongs to one run; a run that is refused leaves no empty one.

    Parameters
    ----------
    folder : Path
    *inside : str
        Folders to make in it.

    Raises
    ------
    InputError
        If it cannot be made, or another run is writing there; see `make_folder` and `claimed`.

    """
    from selfcal_ros.values.output_files import claimed
    places = [folder, *(folder / name for name in inside)]
    new = [place for place in (*reversed(folder.parents), *places) if not place.exists()]
    try:
        for place in places:
            make_folder(place)
        with claimed(folder):
            yield
    except BaseException:
        _remove_empty(new)
        raise
