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
Bad inputs by the thousand: no traceback, no hang, nothing half-written, little memory, a sentence.

Each case runs in a process of its own, which is forked from this one: the command line as a
function, with its real streams. Signals go to real processes.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from dataclasses import dataclass, replace
import os
from pathlib import Path
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import traceback

import numpy as np

from bench.hostile.hostile_cases import Case, draw, OUTPUTS, whole, write_good_files
from bench.inputs import process_environment, ROOT
from bench.tables import Report

RUNS, SEED = 3000, 2026
#: Processor time after which a case hangs, and when it is given up on a busy machine, seconds.
MAX_CPU_S, MAX_WALL_S = 60, 600
MAX_MEMORY_MB = 1500
#: Address space, much of which is never used.
MAX_ADDRESSES = 6 * 2**30
FAULTS = ('traceback', 'hang', 'half-written', 'memory', 'not one sentence')


@dataclass(frozen=True)
class Outcome:
    """
    What became of a case.

    Attributes
    ----------
    status : int
        Exit status, negative for a signal.
    heard : str
        What it said on standard error.
    memory_mb : float
        Most that it had in memory.
    faults : tuple of str
    seconds : float

    """

    status: int
    heard: str
    memory_mb: float
    faults: tuple[str, ...]
    seconds: float


def run(report: Report, args) -> None:
    """Run the cases, and count what must not be."""
    runs = args.runs or RUNS
    report.section('Bad inputs', f'{runs} bad inputs, seed {SEED}; a process each.')
    began = time.perf_counter()
    counts: dict[str, Counter] = defaultdict(Counter)
    total: Counter = Counter()
    most = longest = 0.0
    with tempfile.TemporaryDirectory(prefix='hostile-') as temporary:
        good = Path(temporary) / 'good'
        good.mkdir()
        write_good_files(good)
        signals = max(runs // 60, 2)
        for number in range(runs - signals):
            rng = np.random.default_rng((SEED, number))
            case = draw(rng)
            outcome = run_case(case, good, Path(temporary), rng)
            most, longest = max(most, outcome.memory_mb), max(longest, outcome.seconds)
            _count(report, counts, total, number, case.kind, outcome, case.arguments)
        for number in range(signals):
            outcome = run_signal(number, Path(temporary))
            _count(report, counts, total, number, 'signals', outcome, ())
    rows = [[kind, *(found[name] for name in ('runs', 'done', 'refused', *FAULTS))]
            for kind, found in sorted(counts.items())]
    report.table(['kind', 'runs', 'done', 'refused', *FAULTS], rows)
    report.say(f'{time.perf_counter() - began:.0f} s; the longest {longest:.1f} s of processor '
               f'time, the most memory {most:.0f} MB.')
    for fault in FAULTS:
        report.verdict(f'{runs} bad inputs: {fault}', total[fault], 0)


def _count(report, counts, total, number, kind, outcome, arguments) -> None:
    group = kind.partition(':')[0] if kind.startswith('file') else kind
    counts[group]['runs'] += 1
    counts[group]['done' if outcome.status in (0, 1) else 'refused'] += 1
    for fault in outcome.faults:
        counts[group][fault] += 1
        total[fault] += 1
        if total[fault] <= 20:
            last = outcome.heard.strip().splitlines()[-3:]
            report.say(f'{number} {fault} ({kind}, status {outcome.status}, '
                       f'{outcome.memory_mb:.0f} MB): {" ".join(arguments)!r:.300}\n    '
                       + '\n    '.join(f'{line:.300}' for line in last))


def run_case(case: Case, good: Path, temporary: Path, rng: np.random.Generator) -> Outcome:
    """Run one case in a folder and a process of its own."""
    folder = temporary / 'case'
    shutil.rmtree(folder, ignore_errors=True)
    shutil.copytree(good, folder)
    if case.prepare is not None:
        case.prepare(folder, rng)
    old = [name for name in OUTPUTS if '.' in name and rng.random() < 0.3
           and 'convert' not in case.arguments]
    for name in old:
        (folder / name).write_text('old\n', encoding='utf-8')
    if old and tuple(case.arguments[:1]) in (('calibrate',), ('model',)):
        # without it they are refused before anything is read, which is one case and not all
        case = replace(case, arguments=(*case.arguments, '--force'))
    before = set(_names(folder))
    # a pipe, which has room even where the disk has none
    reading, writing = os.pipe()
    child = os.fork()
    if not child:
        _be_child(case, folder, writing)
    os.close(writing)
    os.set_blocking(reading, False)
    heard = bytearray()
    status, seconds, memory_mb = _wait(child, reading, heard)
    os.close(reading)
    text = heard.decode('utf-8', 'replace')
    faults = _faults(case, folder, old, before, status, text, memory_mb)
    return Outcome(status, text, memory_mb, faults, seconds)


def _be_child(case: Case, folder: Path, heard: int) -> None:
    """Run the case, and end the process."""
    import resource
    status = 70
    try:
        os.chdir(folder)
        os.dup2(heard, 2)
        os.dup2(os.open(os.devnull, os.O_RDWR), 1)
        os.dup2(1, 0)
        sys.stdin, sys.stdout, sys.stderr = (
            open(k, mode, errors='backslashreplace', closefd=False)
            for k, mode in enumerate(('r', 'w', 'w')))
        resource.setrlimit(resource.RLIMIT_CPU, (MAX_CPU_S, MAX_CPU_S + 1))
        resource.setrlimit(resource.RLIMIT_AS, (MAX_ADDRESSES, MAX_ADDRESSES))
        if case.file_bytes is not None:
            resource.setrlimit(resource.RLIMIT_FSIZE, (case.file_bytes,) * 2)
        status = _called(case.call) if case.call else _commanded(case.arguments)
    except BaseException:
        traceback.print_exc()
    finally:
        # in whatever way: above lies the program that tests
        try:
            sys.stderr.flush()
        finally:
            os._exit(status)


def _called(call) -> int:
    from selfcal_ros.cli.own_process import keep_standard_error
    from selfcal_ros.errors import SelfcalError
    # only what is ours counts
    keep_standard_error()
    try:
        call()
    except SelfcalError as error:
        print(error, file=sys.stderr)
        return 2
    except (TypeError, ValueError) as error:
        if not _from_the_caller(error):
            raise
        print('An argument is of another type.', file=sys.stderr)
        return 2
    return 0


def _from_the_caller(error: BaseException) -> bool:
    """Tell whether an argument of a wrong type was met where it was given, and not deep inside."""
    frames = [frame for frame in traceback.extract_tb(error.__traceback__)
              if 'selfcal_ros' in frame.filename and 'hostile' not in frame.filename.rpartition(
                  os.sep)[2]]
    return len(frames) <= 3


def _commanded(arguments: tuple[str, ...]) -> int:
    from selfcal_ros.cli.main import main
    sys.argv = ['selfcal', *arguments]
    try:
        return main()
    except SystemExit as stop:
        return int(stop.code or 0)


def _wait(child: int, reading: int, heard: bytearray) -> tuple[int, float, float]:
    """Listen until a process ends; returns status, processor time and most memory."""
    deadline = time.monotonic() + MAX_WALL_S
    while True:
        ended, code, usage = os.wait4(child, os.WNOHANG)
        try:
            while more := os.read(reading, 2**16):
                heard += more
        except BlockingIOError:
            pass
        if ended:
            return (os.waitstatus_to_exitcode(code), usage.ru_utime + usage.ru_stime,
                    usage.ru_maxrss / 1024)
        if time.monotonic() > deadline:
            os.kill(child, signal.SIGKILL)
            deadline += MAX_WALL_S
        time.sleep(0.002)


def _faults(case, folder, old, before, status, text, memory_mb) -> tuple[str, ...]:
    """Name what must not be."""
    faults = []
    if status in (-signal.SIGXCPU, -signal.SIGKILL):
        faults.append('hang')
    elif 'Traceback' in text or status not in (0, 1, 2):
        faults.append('traceback')
    elif status == 2 and not _one_sentence(text):
        faults.append('not one sentence')
    left = set(_names(folder)) - before
    if any(re.search(r'\.selfcal-|\.part$', name) for name in left):
        faults.append('half-written')
    elif status == 2 and case.file_bytes is None and any(
            name.startswith('out') for name in left):
        faults.append('half-written')
    elif not all(_old_or_whole(folder / name, name in old, status) for name in OUTPUTS):
        faults.append('half-written')
    if memory_mb > MAX_MEMORY_MB:
        faults.append('memory')
    return tuple(faults)


def _one_sentence(text: str) -> bool:
    # how far it came is told beside
    lines = [line for line in text.strip().splitlines() if not re.match(r'\[ *[\d.]+ s\] ', line)]
    return len(lines) == 1 and lines[0].rstrip().endswith(('.', '`', '?'))


def _old_or_whole(path: Path, was_there: bool, status: int) -> bool:
    """Tell whether an output is what was there before, or all there."""
    if not path.exists():
        return not was_there
    if was_there and path.is_file() and path.read_bytes() == b'old\n':
        return True
    try:
        return whole(path)
    except Exception:
        return False


def _names(folder: Path) -> list[str]:
    return [str(path.relative_to(folder)) for path in folder.rglob('*')]


def _orphans(folder: Path) -> bool:
    """Tell whether processes that were started in a folder still run after a while."""
    deadline = time.monotonic() + 60
    mark = f'TMPDIR={folder}'.encode()
    while time.monotonic() < deadline:
        left = []
        for process in Path('/proc').glob('[0-9]*'):
            try:
                left += [process] * (mark in (process / 'environ').read_bytes())
            except OSError:
                continue
        if not left:
            return False
        time.sleep(0.1)
    return True


def run_signal(number: int, temporary: Path) -> Outcome:
    """Send a signal to a command at a random time of its work."""
    rng = np.random.default_rng((SEED, number, 1))
    folder = temporary / 'signal'
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir()
    arm, drive = (str(ROOT / 'bags' / name) for name in ('arm_move', 'agv_drive'))
    verb = [['calibrate', arm, '--report', 'out.html'], ['convert', arm, 'out_bag'],
            ['calibrate', arm, drive, '--jobs', '2', '--output-dir', 'many']][number % 3]
    code = 'import sys; from selfcal_ros.cli.main import main; print("on", flush=True); main()'
    began = time.perf_counter()
    process = subprocess.Popen(
        [sys.executable, '-c', code, *verb], cwd=folder, stdout=subprocess.PIPE,
        stderr=subprocess.PIPE, env=process_environment(TMPDIR=str(folder), PYTHONUNBUFFERED='1'))
    # what comes before is the start of Python
    process.stdout.readline()
    time.sleep(float(rng.uniform(0, 3)))
    sent = [signal.SIGTERM, signal.SIGINT, signal.SIGHUP, signal.SIGKILL][int(rng.integers(4))]
    process.send_signal(sent)
    try:
        heard = process.communicate(timeout=MAX_WALL_S)[1].decode('utf-8', 'replace')
    except subprocess.TimeoutExpired:
        process.kill()
        process.communicate()
        return Outcome(-9, '', 0.0, ('hang',), 0.0)
    faults = ['traceback'] * ('Traceback' in heard)
    if _orphans(folder):
        faults.append('hang')
    # nobody can tidy up after what cannot be caught
    if process.returncode not in (0, -signal.SIGKILL) and any(re.search(
            '^tmp|selfcal-', name) for name in _names(folder)) or not _old_or_whole(
                folder / 'out_bag', False, 0):
        faults.append('half-written')
    if process.returncode not in (0, -sent):
        faults.append('traceback')
    return Outcome(process.returncode, heard, 0.0, tuple(faults), time.perf_counter() - began)
