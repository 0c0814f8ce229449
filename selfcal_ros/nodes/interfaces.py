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
"""Topics and services of the nodes, for documentation; a test holds them against the nodes."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Endpoint:
    """
    One topic or service of a node.

    Attributes
    ----------
    direction : {'in', 'out', 'service'}
    name : str
        As in the code: relative, ~/private or absolute.
    type : str
        package/Name.
    description : str

    """

    direction: str
    name: str
    type: str  # noqa: A003
    description: str


_CALIBRATOR = (
    Endpoint('in', 'tracks', 'sensor_msgs/PointCloud2', 'x, y, id of the points of one image'),
    Endpoint('in', 'tracks/announced', 'sensor_msgs/CameraInfo',
             'optional: an image whose tracks will follow; its `camera_info` does not wait for '
             'them'),
    Endpoint('in', 'driver/camera_info', 'sensor_msgs/CameraInfo',
             'optional: that of a driver without a calibration, for its binning and region of '
             'interest'),
    Endpoint('out', 'camera_info', 'sensor_msgs/CameraInfo',
             'one for every image, with its stamp and frame, for the full sensor; K is zero until '
             'there is a calibration, in the file or estimated'),
    Endpoint('out', '~/result', 'std_msgs/String',
             'the result, as result.json; latched'),
    Endpoint('out', 'structure', 'sensor_msgs/PointCloud2',
             'points that are known well, in `world_frame`; latched'),
    Endpoint('out', 'camera_path', 'nav_msgs/Path',
             'poses of the camera in `world_frame`, with the stamps of their images; latched'),
    Endpoint('out', '~/markers', 'visualization_msgs/MarkerArray',
             'path, cameras and structure for RViz and Foxglove; latched'),
    Endpoint('out', '~/mount', 'geometry_msgs/TransformStamped',
             'with `robot`: from its frame to that of the camera, once all six numbers are known; '
             'latched'),
    Endpoint('out', '/tf_static', 'tf2_msgs/TFMessage', 'with `publish_tf`: the same; latched'),
    Endpoint('out', '/diagnostics', 'diagnostic_msgs/DiagnosticArray',
             'once a second: calibrated or what is missing, every parameter with its sigma; a '
             'warning when the camera has changed'),
    Endpoint('service', '~/calibrate', 'std_srvs/Trigger',
             'estimate now, from what there is; after a change of the camera, from what came '
             'since'),
    Endpoint('service', '~/reset', 'std_srvs/Trigger', 'forget everything'),
    Endpoint('service', '~/save', 'std_srvs/Trigger', 'write the calibration file'),
)

#: By node.
INTERFACES = {
    'feature_tracker': (
        Endpoint('in', 'image', 'sensor_msgs/Image', 'any encoding of a grey or colour camera'),
        Endpoint('in', 'image/compressed', 'sensor_msgs/CompressedImage', 'JPEG or PNG'),
        Endpoint('out', 'tracks', 'sensor_msgs/PointCloud2',
                 'x, y (pixels) and id of the points of each image, with its stamp and frame; '
                 'no points where there was no time to follow them; no id comes twice, nor from a '
                 'tracker that is started again'),
        Endpoint('out', 'tracks/announced', 'sensor_msgs/CameraInfo',
                 'stamp, frame and size of each image before its points are followed, without a '
                 'calibration; a calibrator answers it at once'),
        Endpoint('out', '~/overlay', 'sensor_msgs/Image',
                 'the tracks drawn over each image, for RViz and Foxglove; only while somebody '
                 'subscribes'),
        Endpoint('out', '/diagnostics', 'diagnostic_msgs/DiagnosticArray',
                 'once a second: images received, lost on the way, and that there was no time '
                 'for; a warning with the cause where they are many'),
    ),
    'planar_calibrator': _CALIBRATOR,
    'affine_calibrator': _CALIBRATOR,
    'rorapid_tracker': (
        Endpoint('in', 'image', 'sensor_msgs/Image',
                 'any encoding of a grey or colour camera; with the parameter cameras NAME/image '
                 'of each'),
        Endpoint('in', 'image/compressed', 'sensor_msgs/CompressedImage',
                 'JPEG or PNG; NAME/image/compressed of each'),
        Endpoint('in', 'camera_info', 'sensor_msgs/CameraInfo',
                 'calibration of the camera, with distortion, binning and region of interest; '
                 'NAME/camera_info of each of several, and where they sit on /tf_static, if '
                 'there is no rig_file'),
        Endpoint('in', 'depth', 'sensor_msgs/Image',
                 'with the parameter depth: 16UC1 (millimetres) or 32FC1 (metres), registered to '
                 'the images, with their stamps'),
        Endpoint('in', 'initialpose', 'geometry_msgs/PoseWithCovarianceStamped',
                 'where the object is, roughly, in the optical frame of the camera'),
        Endpoint('out', 'pose', 'geometry_msgs/PoseWithCovarianceStamped',
                 'pose of the object in the optical frame, with the stamp of the image; none '
                 'while the object is lost'),
        Endpoint('out', '~/overlay', 'sensor_msgs/Image',
                 'the image with the object drawn over it: green found, vermilion rejected, '
                 'orange nothing found, grey hidden; drawn only while somebody listens; '
                 '~/NAME/overlay of each of several cameras'),
        Endpoint('out', '~/markers', 'visualization_msgs/MarkerArray',
                 'the wireframe at its pose, for RViz and Foxglove'),
        Endpoint('out', '~/state', 'std_msgs/String',
                 'initialising, tracking, degraded or lost, and why, whenever that changes; '
                 'latched'),
        Endpoint('out', '~/camera_info', 'sensor_msgs/CameraInfo',
                 'with camera_model zoom: the camera at the focal length of each image'),
        Endpoint('out', '/diagnostics', 'diagnostic_msgs/DiagnosticArray',
                 'once a second: state and reason, share of the object that is confirmed, '
                 'sigmas, time an image takes'),
        Endpoint('out', '/tf', 'tf2_msgs/TFMessage',
                 'with publish_tf: from the optical frame to `object_frame`'),
        Endpoint('service', '~/start', 'std_srvs/Trigger',
                 'track from the start pose: the last initialpose, or the parameter'),
        Endpoint('service', '~/reset', 'std_srvs/Trigger',
                 'stop, and wait for ~/start or another initialpose'),
    ),
    'bag_player': (
        Endpoint('out', 'image', 'sensor_msgs/Image', 'where the bag holds this type'),
        Endpoint('out', 'image/compressed', 'sensor_msgs/CompressedImage',
                 'where the bag holds this type'),
        Endpoint('out', '/clock', 'rosgraph_msgs/Clock', 'the time of the bag'),
    ),
    'camera_info_publisher': (
        Endpoint('in', 'driver/camera_info', 'sensor_msgs/CameraInfo',
                 'with `source: driver`: that of a driver without a calibration'),
        Endpoint('in', 'image', 'sensor_msgs/Image', 'with `source: image`'),
        Endpoint('in', 'image/compressed', 'sensor_msgs/CompressedImage',
                 'with `source: compressed`'),
        Endpoint('out', 'camera_info', 'sensor_msgs/CameraInfo',
                 'the calibration, with the stamp, frame, binning and region of what came in'),
        Endpoint('service', '~/set_camera_info', 'sensor_msgs/SetCameraInfo',
                 'take another calibration, at once, and write it to the file'),
    ),
    'calibration_page': (
        Endpoint('in', '/diagnostics', 'diagnostic_msgs/DiagnosticArray',
                 'what calibrator and tracker say of themselves'),
        Endpoint('in', 'tracks', 'sensor_msgs/PointCloud2',
                 'from when a calibrator has spoken: coverage and turns'),
        Endpoint('in', 'feature_tracker/overlay', 'sensor_msgs/Image',
                 'only while a browser shows the page'),
    ),
}
