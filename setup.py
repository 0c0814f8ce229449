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
"""Installation with pip and with colcon; the metadata live here because colcon reads them here."""

from glob import glob
import os
from pathlib import Path
import re

from setuptools import find_packages, setup

PACKAGE = 'selfcal_ros'
EXECUTABLES = {
    'feature_tracker': 'selfcal_ros.nodes.feature_tracker:main',
    'planar_calibrator': 'selfcal_ros.nodes.planar_calibrator:main',
    'affine_calibrator': 'selfcal_ros.nodes.affine_calibrator:main',
    'rorapid_tracker': 'selfcal_ros.nodes.rorapid_tracker:main',
    'bag_player': 'selfcal_ros.nodes.bag_player:main',
    'camera_info_publisher': 'selfcal_ros.nodes.camera_info_publisher:main',
    'calibration_page': 'selfcal_ros.nodes.calibration_page:main',
    'all_nodes': 'selfcal_ros.nodes.composition:main',
    'selfcal': 'selfcal_ros.cli.main:main',
}

version = re.search(r"^__version__ = '(.+)'$",
                    Path('selfcal_ros/version.py').read_text(encoding='utf-8'), re.M).group(1)

data_files = [
    ('share/ament_index/resource_index/packages', ['resource/' + PACKAGE]),
    (f'share/{PACKAGE}', ['package.xml', 'docs/result.schema.json']),
    ('share/man/man1', ['docs/selfcal.1']),
    (f'share/{PACKAGE}/launch', sorted(glob('launch/*.launch.py'))),
    (f'share/{PACKAGE}/config', sorted(
        file for kind in ('yaml', 'xml', 'rviz', 'json') for file in glob(f'config/*.{kind}'))),
    # the demos replay these recordings, wherever the package is installed
    (f'share/{PACKAGE}/bags', sorted(glob('bags/*.truth.json') + glob('bags/tracked_object.*.yaml')
                                     + glob('bags/*.pos') + glob('bags/*.csv'))),
    (f'share/{PACKAGE}/bags/agv_drive', sorted(glob('bags/agv_drive/*'))),
    (f'share/{PACKAGE}/bags/arm_move', sorted(glob('bags/arm_move/*'))),
    (f'share/{PACKAGE}/bags/tracked_object', sorted(glob('bags/tracked_object/*'))),
]
if os.environ.get('COLCON') != '1':
    # pip puts console scripts on PATH only; `ros2 run` and launch look in lib/<package>
    data_files.append((f'lib/{PACKAGE}', sorted(glob('scripts/*'))))

setup(
    name=PACKAGE,
    version=version,
    description="Camera self-calibration from a robot's own motion",
    long_description=Path('README.md').read_text(encoding='utf-8'),
    long_description_content_type='text/markdown',
    author='selfcal_ros contributors',
    maintainer='selfcal_ros contributors',
    maintainer_email='selfcal-ros@users.noreply.github.com',
    license='Apache-2.0',
    packages=find_packages(include=[PACKAGE, PACKAGE + '.*', 'msg_adapters', 'msg_adapters.*']),
    package_data={PACKAGE: ['py.typed', 'report/templates/*', 'report/*.j2', 'report/*.html'],
                  'msg_adapters': ['py.typed']},
    data_files=[(folder, files) for folder, files in data_files if files],
    python_requires='>=3.11',
    install_requires=[
        'setuptools',
        'numpy>=1.26',
        'scipy>=1.11',
        'opencv-python-headless>=4.6',
        # its readers are bounded by the names that they have since
        'rosbags>=0.11.9',
        'matplotlib>=3.6',
        'tqdm>=4.64',
        'PyYAML>=6.0',
        'jinja2>=3.1',
        'argcomplete>=3.0',
        'threadpoolctl>=3.0',
    ],
    extras_require={
        'ros-wheels': [
            "ros-jazzy-rclpy[fastrtps]; sys_platform == 'linux' and platform_machine == 'x86_64'",
            "ros-jazzy-common-interfaces; sys_platform == 'linux' "
            "and platform_machine == 'x86_64'",
        ],
        # selfcal calibrate --engine dask
        'dask': [
            'distributed>=2023.1',
        ],
        # selfcal calibrate --view
        'view': [
            'rerun-sdk>=0.23',
        ],
        # the live page: calibration_page, selfcal watch
        'watch': [
            'tornado>=6.2',
        ],
        # make docs
        'docs': [
            'mkdocs>=1.6',
        ],
        'test': [
            'pytest>=7',
            'pytest-xdist',
            'hypothesis',
            'flake8',
            'mypy>=1.11',
            'distributed>=2023.1',
            'mkdocs>=1.6',
            'tornado>=6.2',
        ],
    },
    zip_safe=True,
    entry_points={'console_scripts': [f'{name} = {target}'
                                      for name, target in EXECUTABLES.items()]},
)
