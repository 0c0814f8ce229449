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
Read result.json as `selfcal calibrate --json` and the topic `~/result` write it.

    selfcal calibrate bags/agv_drive --json result.json
    python examples/read_result.py result.json --least-sigma 1.0

Nothing of selfcal_ros is needed: the file is plain JSON.
"""

import argparse
import json
from pathlib import Path
import sys


def main(argv: list[str] | None = None) -> int:
    """Say whether a camera is good enough; returns 0 if it is, 1 if not."""
    parser = argparse.ArgumentParser(description='Decide whether a calibration is good enough.')
    parser.add_argument('result', type=Path)
    parser.add_argument('--least-sigma', type=float, default=1.0, metavar='PX',
                        help='largest sigma of the focal length and the principal point')
    args = parser.parse_args(argv)

    result = json.loads(args.result.read_text(encoding='utf-8'))
    if result['status'] != 'calibrated':
        print(f'no calibration: {result["reason"]} {result["advice"]}')
        return 1
    for name, status in result['parameters'].items():
        # 'held' by a fact, 'estimated' from the images, or 'unobservable': then sigma is null
        sigma = result['sigma'][name]
        spread = 'not determined' if sigma is None else f'{sigma:.3g}'
        print(f'{name:5} {status:13} sigma {spread}')
    worst = max(result['sigma'][name] or 0.0 for name in ('fx', 'fy', 'cx', 'cy'))
    print(f'from {result["frames"]["count"]} images, {result["motion"]} motion; '
          f'largest sigma {worst:.3g} px')
    return 0 if worst <= args.least_sigma else 1


if __name__ == '__main__':
    sys.exit(main())
