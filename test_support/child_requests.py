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
"""What a child process is asked in tests; a module of its own, so that the child can import it."""

from dataclasses import dataclass
import os
import signal
import sys

from selfcal_ros.calibration.result import NotCalibrated


@dataclass(frozen=True)
class Request:
    """Stands for an EstimateRequest."""

    what: str

    def run(self):
        """Answer with the process that runs it, fail, die, or never answer."""
        if self.what == 'fault':
            raise ValueError('of the program')
        if self.what == 'endless':
            print(os.getpid(), flush=True)
            signal.pause()
        if self.what == 'death':
            os._exit(1)
        if self.what == 'loaded':
            return NotCalibrated(f"loaded {'selfcal_ros.calibration.calibrate' in sys.modules}")
        return NotCalibrated(f'{self.what} from {os.getpid()}')
