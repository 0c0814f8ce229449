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
"""Parameters of a node as one frozen dataclass: declared once, described, bounded, read-only."""

from __future__ import annotations

from dataclasses import dataclass, field, fields
import math

from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor
from rclpy.exceptions import InvalidParameterValueException

from selfcal_ros.errors import ArgumentError
from selfcal_ros.rorapid.options import CAMERA_MODELS, METHODS, MOTIONS


def parameter(default, description: str, low=None, high=None, one_of=()):
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

    """
    return field(default=default, metadata={'description': description, 'low': low, 'high': high,
                                            'one_of': tuple(one_of)})


def declare(node, table):
    """
    Declare the parameters of a dataclass on a node and read their values.

    Parameters
    ----------
    node : rclpy.node.Node
    table : type
        Dataclass whose fields were made with `parameter`.

    Returns
    -------
    table
        An instance with the values in force.

    Raises
    ------
    ArgumentError
        If a value has the wrong type or is out of range; the sentence names the parameter.

    """
    values = {}
    for entry in fields(table):
        try:
            given = node.declare_parameter(entry.name, entry.default, _descriptor(entry)).value
        except InvalidParameterValueException:
            # rclpy has looked at the range before us
            raise ArgumentError(f'The parameter {entry.name} must be {_bounds(entry)}.') from None
        values[entry.name] = _checked(entry, given)
    return table(**values)


def _descriptor(entry) -> ParameterDescriptor:
    """Describe a field; the type is ours to check, so that a YAML 20 may stand for 20.0."""
    about = entry.metadata
    descriptor = ParameterDescriptor(description=about['description'], read_only=True,
                                     dynamic_typing=True)
    if about['one_of']:
        descriptor.additional_constraints = 'one of ' + ', '.join(about['one_of'])
    low, high = about['low'], about['high']
    if low is not None or high is not None:
        # read-only: nobody can set it later, the range is there to be read
        if isinstance(entry.default, float):
            descriptor.additional_constraints = f'from {low} to {high}'
            descriptor.floating_point_range = [FloatingPointRange(
                from_value=float(-math.inf if low is None else low),
                to_value=float(math.inf if high is None else high), step=0.0)]
        else:
            descriptor.integer_range = [IntegerRange(
                from_value=int(-2 ** 63 if low is None else low),
                to_value=int(2 ** 63 - 1 if high is None else high), step=0)]
    return descriptor


def _checked(entry, value):
    """Return the value in the type of its default."""
    wanted, about = type(entry.default), entry.metadata
    if wanted is float and isinstance(value, int) and not isinstance(value, bool):
        value = float(value)
    if type(value) is not wanted:
        raise ArgumentError(f'The parameter {entry.name} must be of type {wanted.__name__}, '
                            f'not {value!r}.')
    if about['one_of'] and value not in about['one_of']:
        raise ArgumentError(f'The parameter {entry.name} must be one of '
                            f'{", ".join(about["one_of"])}, not {value!r}.')
    low, high = about['low'], about['high']
    # written so that NaN fails
    if (low is not None and not value >= low) or (high is not None and not value <= high):
        raise ArgumentError(f'The parameter {entry.name} must be {_bounds(entry)}, '
                            f'not {value!r}.')
    return value


def _bounds(entry) -> str:
    """Say between what a number must lie."""
    low, high = entry.metadata['low'], entry.metadata['high']
    if None in (low, high):
        return f'at least {low}' if high is None else f'at most {high}'
    return f'from {low} to {high}'


@dataclass(frozen=True)
class FeatureTrackerParameters:
    """Parameters of feature_tracker."""

    image_transport: str = parameter(
        'auto', 'which of the topics image and image/compressed to follow; auto takes the one '
        'that speaks first', one_of=('auto', 'raw', 'compressed'))
    reliability: str = parameter(
        'auto', 'of the subscription to the images; auto: reliable where all publishers are, '
        'best effort otherwise, which fits every publisher', one_of=('auto', 'best_effort',
                                                                     'reliable'))
    max_features: int = parameter(400, 'points to follow at once', 20, 5000)
    lazy: bool = parameter(True, 'subscribe to images only while somebody listens to the tracks')
    silence_s: float = parameter(5.0, 'warn when no image has come for so long', 0.5, 3600.0)


def _motion(default: str):
    return parameter(default, 'how the camera moves: in a plane, as robots on wheels do; freely, '
                     'as arms do; auto finds out', one_of=('planar', 'general', 'auto'))


@dataclass(frozen=True)
class CalibratorParameters:
    """Parameters of planar_calibrator and affine_calibrator."""

    camera_name: str = parameter('camera', 'name in the calibration file, and its file name')
    output: str = parameter('', 'calibration file; empty: ${ROS_HOME}/camera_info/<name>.yaml, '
                            'where camera drivers look')
    auto_save: bool = parameter(False, 'write the file after every estimate, not on ~/save only')
    set_camera_info_service: str = parameter(
        '', 'whenever the file is written, also give the calibration to a driver by this service, '
        'such as camera/set_camera_info; empty: to none')
    motion: str = _motion('auto')
    aspect_ratio: float = parameter(1.0, 'known fy/fx; 0: not known', 0.0, 10.0)
    aspect_ratio_sigma: float = parameter(0.0, 'its standard deviation; 0: exact', 0.0, 10.0)
    zero_skew: bool = parameter(True, 'the skew is known to be zero')
    distortion: str = parameter('auto', 'coefficients to estimate; auto: the richest model with '
                                'which the images determine the camera',
                                one_of=('auto', 'none', 'radial1', 'radial2', 'plumb_bob'))
    max_keyframes: int = parameter(40, 'views to keep', 3, 400)
    first_estimate: int = parameter(8, 'views before the first estimate', 3, 400)
    keyframe_parallax: float = parameter(
        0.03, 'a view is kept when its points have moved by this share of the image diagonal',
        1e-4, 0.5)
    monitor: bool = parameter(True, 'watch whether the camera changes, once it is calibrated')
    false_alarm_keyframes: float = parameter(
        3.6e6, 'mean number of views between false alarms of the monitor, at least', 1e3, 1e12)
    world_frame: str = parameter(
        'calibration_world_unscaled', 'frame of structure, camera_path and markers: the body '
        'frame of the first view, the median step between views being 1 (no metres)')
    idle_s: float = parameter(1.0, 'estimate with what there is when no tracks come for so long',
                              0.1, 3600.0)
    silence_s: float = parameter(5.0, 'warn when no tracks have come for so long', 0.5, 3600.0)


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

    model: str = parameter('', "wireframe of the object: ViSP's .cao, or our .yaml")
    camera_file: str = parameter('', 'calibration file to use until a camera_info comes; empty: '
                                 'wait for one')
    start_pose: str = parameter('', 'where the object is at first: "tx ty tz rx ry rz" (metres, '
                                'angle-axis radians, in the optical frame of the camera), or a '
                                '.pos file; empty: wait for initialpose')
    image_transport: str = parameter(
        'auto', 'which of the topics image and image/compressed to follow; auto takes the one '
        'that speaks first', one_of=('auto', 'raw', 'compressed'))
    method: str = parameter('modern', "RAPiD and RoRAPiD are the thesis's; modern adds what has "
                            'been learned since', one_of=METHODS)
    camera_model: str = parameter(
        'perspective', 'zoom: the focal length changes and is tracked; weak, affine: for long '
        'lenses', one_of=CAMERA_MODELS)
    motion: str = parameter('general', 'how the object can move before the camera',
                            one_of=MOTIONS)
    plane_axis: str = parameter('', 'with planar motion: axis of rotation "x y z" in the optical '
                                'frame; empty: learned')
    control_points_per_line: int = parameter(6, 'control points on each line', 2, 200)
    control_points_per_conic: int = parameter(10, 'control points on each circle', 5, 400)
    search_least_px: float = parameter(8.0, 'least search range to each side of an edge', 2.0,
                                       100.0)
    search_most_px: float = parameter(24.0, 'most search range to each side of an edge', 2.0,
                                      200.0)
    least_contrast: float = parameter(4.0, 'weakest edge that counts, in grey levels', 0.5, 255.0)
    texture: bool = parameter(True, "remember and use what the object's faces look like")
    recovery: bool = parameter(True, 'search for the object again after a loss')
    object_frame: str = parameter('object', 'frame of the object')
    publish_tf: bool = parameter(False, 'publish the transform from the camera to object_frame; '
                                 'a frame may have one parent only')
    camera_name: str = parameter('camera', 'name of the camera in the diagnostics')
    silence_s: float = parameter(5.0, 'warn when no image has come for so long', 0.5, 3600.0)


@dataclass(frozen=True)
class BagPlayerParameters:
    """Parameters of bag_player."""

    bag: str = parameter('', 'rosbag2 folder, .mcap, .db3 or .bag file')
    topic: str = parameter('', 'image topic of the bag; empty: the only one')
    rate: float = parameter(1.0, 'playback speed', 0.01, 100.0)
    loop: bool = parameter(False, 'start again at the end')
    start_offset: float = parameter(0.0, 'seconds of the bag to skip', 0.0, 1e6)
    publish_clock: bool = parameter(True, 'publish the time of the bag on /clock')
    wait_for_subscribers_s: float = parameter(
        30.0, 'wait for a subscriber for at most so long; 0: do not wait', 0.0, 3600.0)


@dataclass(frozen=True)
class CameraInfoPublisherParameters:
    """Parameters of camera_info_publisher."""

    camera_name: str = parameter('camera', 'name of the camera, and of its file')
    camera_info_url: str = parameter(
        '', 'calibration file, also as file:// URL; empty: ${ROS_HOME}/camera_info/<name>.yaml, '
        'where camera drivers look')
    source: str = parameter(
        'driver', 'whose stamps to take: driver/camera_info, which also tells binning and region '
        'of interest, or the images of a driver without one',
        one_of=('driver', 'image', 'compressed'))
    silence_s: float = parameter(5.0, 'warn when nothing has come for so long', 0.5, 3600.0)
