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
"""The tracks drawn over the images, for viewers."""

from msg_adapters.image import image_to_bgr
from msg_adapters.tracks import tracks_from_message
import numpy as np
from selfcal_ros.nodes.feature_tracker_node import FeatureTrackerNode
from sensor_msgs.msg import Image, PointCloud2
from test_support import image_stream


def test_the_overlay_has_colour_at_the_points_and_the_header_of_its_image(graph):
    graph = graph()
    graph.add(FeatureTrackerNode())
    camera = graph.probe.create_publisher(Image, 'image', 5)
    overlays = graph.listen(Image, 'feature_tracker/overlay')
    # the overlay alone wakes the tracker up
    image_stream.play(graph, camera, image_stream.image, overlays, 3)
    assert overlays[-1].encoding == 'bgr8'
    tracks = graph.listen(PointCloud2, 'tracks')
    image_stream.play(graph, camera, image_stream.image, tracks, 2, first=3)
    graph.wait_for(lambda: overlays[-1].header == tracks[-1].header)
    drawn = image_to_bgr(overlays[-1])
    grey = image_stream.wall(4)
    assert drawn.shape == (*grey.shape, 3)
    coloured = np.ptp(drawn.astype(int), axis=2) > 0
    columns, rows = np.round(tracks_from_message(tracks[-1]).xy).astype(int).T
    assert coloured[rows, columns].mean() > 0.95
    # the image is still to be seen between them, above the caption
    above = ~coloured[:-30]
    assert (drawn[:-30][above][:, 0] == grey[:-30][above]).mean() > 0.99
    assert coloured.mean() < 0.5
