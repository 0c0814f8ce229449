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
Parameters of a node as one frozen dataclass: declared once, described, bounded.

What makes sense to change while a node runs is marked `live`; everything else is read-only.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import TypeVar

from selfcal_ros.geometry.camera_facts import FOCAL_CHOICES, SHUTTERS
from selfcal_ros.geometry.lenses.catalogue import LENS_CHOICES
from selfcal_ros.rorapid.options import CAMERA_MODELS, LINES, METHODS, MOTIONS

Value = TypeVar('Value', bool, int, float, str)

#: How a calibration file is named.
_FILE = ('calibration file: a path, file:///PATH or package://PACKAGE/PATH, with ${NAME} for the '
         'name of the camera')
_WHERE = '${ROS_HOME}/camera_info/${NAME}.yaml, where camera drivers look'


def parameter(default: Value, description: str, low: float | None = None,
              high: float | None = None, one_of: Iterable[str] = (), live: bool = False) -> Value:
    """
    Describe one parameter; use it as the default of a dataclass field.

    Parameters
    ----------
    default : bool, int, float or str
        Its type is the type of the parameter.
    description : str
    low, high : number, optional
        Inclusive bounds.
    one_of : tuple of str, optional
        The only values allowed.
    live : bool
        Whether it may change while the node runs.

    """
    return field(default=default, metadata={'description': description, 'low': low, 'high': high,
                                            'one_of': tuple(one_of), 'live': live})


def _image_transport() -> str:
    return parameter('auto', 'which of the topics image and image/compressed to follow; auto '
                     'takes the one that speaks first, until it falls silent',
                     one_of=('auto', 'raw', 'compressed'), live=True)


def _reliability() -> str:
    return parameter('auto', 'of the subscription to the images; auto: reliable where all '
                     'publishers are, best effort otherwise, which fits every publisher',
                     one_of=('auto', 'best_effort', 'reliable'), live=True)


def _silence_s(what_has: str) -> float:
    return parameter(5.0, f'warn when {what_has} come for so long', 0.5, 3600.0, live=True)


@dataclass(frozen=True)
class FeatureTrackerParameters:
    """Parameters of feature_tracker."""

    image_transport: str = _image_transport()
    reliability: str = _reliability()
    max_features: int = parameter(400, 'points to follow at once', 20, 5000, live=True)
    mask: str = parameter(
        '', 'image file of the size of the images: white (not zero) where points may be followed, '
        'black where not, such as on the body of the robot; empty: everywhere, but for what is '
        'black around a fisheye image', live=True)
    lazy: bool = parameter(True, 'subscribe to images only while somebody listens to the tracks',
                           live=True)
    silence_s: float = _silence_s('no image has')


def _motion(default: str) -> str:
    return parameter(default, 'how the camera moves: in a plane, as robots on wheels do; freely, '
                     'as arms do; auto finds out', one_of=('planar', 'general', 'auto'),
                     live=True)


@dataclass(frozen=True)
class CalibratorParameters:
    """Parameters of planar_calibrator and affine_calibrator."""

    camera_name: str = parameter('camera', 'name in the calibration file, and its file name')
    output: str = parameter('', f'{_FILE}; empty: {_WHERE}', live=True)
    begin_with_file: bool = parameter(
        True, 'publish the calibration of this file, if it is there, until one is estimated')
    auto_save: bool = parameter(False, 'write the file after every estimate, not on ~/save only',
                                live=True)
    set_camera_info_service: str = parameter(
        '', 'whenever the file is written, also give the calibration to a driver by this service, '
        'such as camera/set_camera_info; empty: to none', live=True)
    motion: str = _motion('auto')
    aspect_ratio: float = parameter(1.0, 'known fy/fx; 0: not known', 0.0, 10.0, live=True)
    aspect_ratio_sigma: float = parameter(0.0, 'its standard deviation; 0: exact', 0.0, 10.0,
                                          live=True)
    zero_skew: bool = parameter(True, 'the skew is known to be zero', live=True)
    distortion: str = parameter('auto', 'lens model to estimate; auto: the family, and its '
                                'richest member that the images determine',
                                one_of=('auto', *LENS_CHOICES), live=True)
    lens_population: bool = parameter(True, 'what real lenses are like counts as a measurement',
                                      live=True)
    trust_facts: bool = parameter(
        False, 'keep to the facts where the images contradict them, too', live=True)
    focal: str = parameter('auto', 'whether the focal length is constant or varies (zoom, focus, '
                           'warm-up); auto: constant, unless the images contradict',
                           one_of=FOCAL_CHOICES, live=True)
    shutter: str = parameter('auto', 'whether all rows are read at once, or one after the other; '
                             'auto: found out', one_of=SHUTTERS, live=True)
    max_keyframes: int = parameter(40, 'views to keep', 3, 400, live=True)
    first_estimate: int = parameter(8, 'views before the first estimate', 3, 400, live=True)
    keyframe_parallax: float = parameter(
        0.03, 'a view is kept when its points have moved by this share of the image diagonal',
        1e-4, 0.5, live=True)
    monitor: bool = parameter(
        True, 'watch whether the camera changes, or how it is mounted on the robot, once that is '
        'known; switched off during an alarm, estimates go on from the views since the change '
        'and replace the calibration',
        live=True)
    false_alarm_keyframes: float = parameter(
        3.6e6, 'mean number of views between false alarms of the monitor, at least', 1e3, 1e12,
        live=True)
    world_frame: str = parameter(
        'calibration_world_unscaled', 'frame of structure, camera_path and markers: the body '
        'frame of the first view, the median step between views being 1 (no metres)')
    robot: str = parameter(
        '', 'topic of poses of the robot: Odometry, PoseStamped or PoseWithCovarianceStamped, '
        'such as /odom, or /tf:FIXED:BODY, such as /tf:odom:base_link; then where the camera sits '
        'on it is estimated, too; empty: none')
    robot_kind: str = parameter(
        'auto', 'whether each pose errs by itself, or the way from one to the next; auto: '
        'odometry for Odometry and TF from odom', one_of=('auto', 'absolute', 'odometry'))
    robot_sigma: str = parameter(
        '', 'standard deviation of a pose, metres:degrees, such as 0.001:0.05; of odometry, after '
        'one metre, and after turning by one radian; empty: found from the misfit')
    robot_unit: float = parameter(0.0, 'metres in a unit of the positions, such as 0.001 for '
                                  'millimetres; 0: they are metres', 0.0, 1e6)
    robot_frame: str = parameter('', 'name of the frame whose poses these are; empty: what '
                                 'messages call it, else base_link')
    mount_facts: str = parameter(
        '', 'known parts of the mount, such as z=0.52:0.01 roll=0: x, y, z (metres), roll, pitch, '
        'yaw (degrees), scale (of odometry), time_offset (seconds), each with its sigma, or exact')
    camera_frame: str = parameter('', 'frame of the camera in the mount; empty: that of the '
                                  'images')
    publish_tf: bool = parameter(
        False, 'publish the mount on /tf_static, once all six numbers are known; a frame may have '
        'one parent only', live=True)
    idle_s: float = parameter(1.0, 'estimate with what there is when no tracks come for so long',
                              0.1, 3600.0, live=True)
    silence_s: float = _silence_s('no tracks have')


@dataclass(frozen=True)
class PlanarCalibratorParameters(CalibratorParameters):
    """Parameters of planar_calibrator."""

    motion: str = _motion('planar')


@dataclass(frozen=True)
class AffineCalibratorParameters(CalibratorParameters):
    """Parameters of affine_calibrator."""

    motion: str = _motion('general')


@dataclass(frozen=True)
class RorapidTrackerParameters:
    """Parameters of rorapid_tracker."""

    model: str = parameter('', "shape of the object: ViSP's .cao, our .yaml, or a mesh: .obj, "
                           '.ply or .stl; several parted by commas')
    model_scale: float = parameter(1.0, 'metres per unit of a mesh: 0.001 where it is in '
                                   'millimetres', 1e-6, 1e6)
    camera_file: str = parameter('', 'calibration file to use until a camera_info comes; empty: '
                                 'wait for one')
    cameras: str = parameter('', 'names of several cameras that see the object, such as '
                             'left,right: their images are on left/image and right/image; '
                             'empty: one camera')
    rig_file: str = parameter('', 'with cameras: their calibrations and places, result.json of '
                              "selfcal calibrate --cameras or Kalibr's camchain.yaml; empty: "
                              'camera_info and /tf_static')
    rig_sigma: str = parameter('', 'with cameras: standard deviations "DEGREES METRES" of their '
                               'places; empty: those of the file, else 0.05 0.0005')
    start_pose: str = parameter('', 'where the object is at first: "tx ty tz rx ry rz" (metres, '
                                'angle-axis radians, in the optical frame of the camera), or a '
                                '.pos file; of several objects parted by semicolons; auto: it '
                                'is sought in each image until it is found; empty: wait for '
                                'initialpose')
    image_transport: str = _image_transport()
    reliability: str = _reliability()
    method: str = parameter('modern', "RAPiD and RoRAPiD are the thesis's; modern adds what has "
                            'been learned since', one_of=METHODS)
    camera_model: str = parameter(
        'perspective', 'zoom: the focal length changes and is tracked; weak, affine: for long '
        'lenses', one_of=CAMERA_MODELS)
    motion: str = parameter('general', 'how the object can move before the camera',
                            one_of=MOTIONS)
    plane_axis: str = parameter('', 'with planar motion: axis of rotation "x y z" in the optical '
                                'frame; empty: learned')
    control_points_per_line: int = parameter(6, 'control points on each line', 2, 200, live=True)
    control_points_per_conic: int = parameter(10, 'control points on each circle', 5, 400,
                                              live=True)
    search_least_px: float = parameter(8.0, 'least search range to each side of an edge', 2.0,
                                       100.0, live=True)
    search_most_px: float = parameter(24.0, 'most search range to each side of an edge', 2.0,
                                      200.0, live=True)
    least_contrast: float = parameter(4.0, 'weakest edge that counts, in grey levels', 0.5, 255.0,
                                      live=True)
    texture: bool = parameter(True, "remember and use what the object's faces look like",
                              live=True)
    recovery: bool = parameter(True, 'search for the object again after a loss', live=True)
    depth: bool = parameter(False, 'use the depth images of the topic depth, registered to the '
                            'images')
    depth_scale_sigma: float = parameter(
        0.005, 'standard deviation of the one factor by which all depths err', 1e-5, 1.0,
        live=True)
    line_delay_s: float = parameter(
        0.0, 'rolling shutter: seconds from one row to the next, negative from the lowest row '
        'up; 0: as camera_file says, else all rows at once', -1e-3, 1e-3)
    lines: str = parameter('rows', 'what is read one after the other', one_of=LINES)
    object_frame: str = parameter('object', 'frame of the object')
    publish_tf: bool = parameter(False, 'publish the transform from the camera to object_frame; '
                                 'a frame may have one parent only', live=True)
    camera_name: str = parameter('camera', 'name of the camera in the diagnostics')
    silence_s: float = _silence_s('no image has')


@dataclass(frozen=True)
class BagPlayerParameters:
    """Parameters of bag_player."""

    bag: str = parameter('', 'rosbag2 folder, .mcap, .db3 or .bag file')
    topic: str = parameter('', 'image topic of the bag; empty: the only one')
    rate: float = parameter(1.0, 'playback speed', 0.01, 100.0, live=True)
    loop: bool = parameter(False, 'start again at the end', live=True)
    start_offset: float = parameter(0.0, 'seconds of the bag to skip', 0.0, 1e6)
    publish_clock: bool = parameter(True, 'publish the time of the bag on /clock')
    wait_for_subscribers_s: float = parameter(
        30.0, 'wait for a subscriber for at most so long; 0: do not wait', 0.0, 3600.0)


@dataclass(frozen=True)
class CameraInfoPublisherParameters:
    """Parameters of camera_info_publisher."""

    camera_name: str = parameter('camera', 'name of the camera, and of its file')
    camera_info_url: str = parameter('', f'{_FILE}; empty: {_WHERE}', live=True)
    source: str = parameter(
        'driver', 'whose stamps to take: driver/camera_info, which also tells binning and region '
        'of interest, or the images of a driver without one',
        one_of=('driver', 'image', 'compressed'))
    silence_s: float = _silence_s('nothing has')


@dataclass(frozen=True)
class CalibrationPageParameters:
    """Parameters of calibration_page."""

    calibrator: str = parameter('', 'name of the calibrator to watch, such as '
                                '/left/planar_calibrator; empty: the first that speaks, those '
                                'of the own namespace before others')
    host: str = parameter('127.0.0.1', 'address to serve on; of any but this machine, the page '
                          'asks for the token that is in the printed address')
    port: int = parameter(8765, 'of the address; where it is taken, the next that is free; 0: '
                          'any that is free', 0, 65535)
    image_rate: float = parameter(10.0, 'images a second, at most, that a browser gets', 0.1,
                                  60.0, live=True)
    image_width: int = parameter(960, 'wider images are made smaller, pixels', 64, 8192,
                                 live=True)
