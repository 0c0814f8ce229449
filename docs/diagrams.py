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
"""Diagrams of boxes and arrows: the house, the ways of data, the nodes. See `make_figures.py`."""

from __future__ import annotations

from dataclasses import dataclass, field

from matplotlib.patches import FancyArrowPatch, FancyBboxPatch

from selfcal_ros.nodes.interfaces import INTERFACES
from selfcal_ros.report.style import BLUE, GREEN, GREY, INK, ORANGE, PURPLE

_FACE = {BLUE: '#e6f1f8', GREEN: '#e5f5f0', ORANGE: '#fbeee4', PURPLE: '#f3eaf4', GREY: '#f4f5f6'}
_SIDES = {'l': (-0.5, 0), 'r': (0.5, 0), 't': (0, 0.5), 'b': (0, -0.5)}


@dataclass
class Diagram:
    """
    Boxes on a plane whose units are inches.

    Attributes
    ----------
    axes : matplotlib Axes
    boxes : dict of str to tuple
        Centre and size (x, y, width, height) by name.

    """

    axes: object
    boxes: dict = field(default_factory=dict)

    def box(self, name, x, y, width, height, title, text='', colour=BLUE, size=10.5):
        """Draw a box about a centre; the title is bold, the text below it is not."""
        self.boxes[name] = (x, y, width, height)
        self.axes.add_patch(FancyBboxPatch(
            (x - width / 2, y - height / 2), width, height, linewidth=1.2, edgecolor=colour,
            boxstyle='round,pad=0,rounding_size=0.08', facecolor=_FACE[colour]))
        lines = text.split('\n') if text else []
        step = 0.185
        top = y + step * len(lines) / 2
        self.axes.text(x, top, title, ha='center', va='center', weight='bold', fontsize=size)
        for number, line in enumerate(lines, start=1):
            self.axes.text(x, top - step * number, line, ha='center', va='center',
                           fontsize=size - 1.5)

    def arrow(self, start, end, label='', colour=INK, at=0.5, shift=(0, 0), bend=0.0, style='-'):
        """Join two boxes; ends are 'name:side', with an optional offset as in 'name:r+0.2'."""
        tail, head = self._end(start), self._end(end)
        self.axes.add_patch(FancyArrowPatch(
            tail, head, arrowstyle='-|>', mutation_scale=12, linewidth=1.2, color=colour,
            shrinkA=0, shrinkB=0, linestyle=style, connectionstyle=f'arc3,rad={bend}'))
        if label:
            x, y = (tail[k] + at * (head[k] - tail[k]) + shift[k] for k in (0, 1))
            self.axes.text(x, y, label, ha='center', va='center', fontsize=9, color=colour,
                           bbox={'facecolor': 'white', 'edgecolor': 'none', 'pad': 1.2})

    def _end(self, text):
        name, _, side = text.partition(':')
        x, y, width, height = self.boxes[name]
        along = float(side[1:] or 0)
        dx, dy = _SIDES[side[0]]
        return (x + dx * width + (along if dy else 0), y + dy * height + (along if dx else 0))


def sheet(figure, width, height) -> Diagram:
    """Lay an empty sheet over a whole figure."""
    axes = figure.add_axes((0, 0, 1, 1))
    axes.set(xlim=(0, width), ylim=(0, height), aspect='equal')
    axes.axis('off')
    return Diagram(axes)


def house(figure) -> Diagram:
    """Draw the storeys of the package; imports go down only."""
    figure.set_size_inches(9.2, 8.0)
    d = sheet(figure, 9.2, 8.0)
    d.box('nodes', 2.25, 7.5, 3.9, 0.75, 'nodes/', 'rclpy, and nothing but translation', ORANGE)
    d.box('cli', 6.65, 7.5, 3.9, 0.75, 'cli/', 'selfcal: one file a verb', ORANGE)
    d.box('report', 4.45, 6.4, 8.3, 0.75, 'report/', 'what a person or a program reads', PURPLE)
    d.box('pipeline', 4.45, 5.3, 8.3, 0.75, 'pipeline/', 'what nodes and command line both drive',
          PURPLE)
    d.box('features', 1.27, 4.1, 1.94, 0.95, 'features/', 'images in,\ntracks out', GREEN)
    d.box('calibration', 3.4, 4.1, 1.94, 0.95, 'calibration/', 'tracks in,\ncamera out', GREEN)
    d.box('rorapid', 5.53, 4.1, 1.94, 0.95, 'rorapid/', 'images and model in,\npose out', GREEN)
    d.box('synthetic', 7.63, 4.1, 1.94, 0.95, 'synthetic/', 'scenes with\nknown truth', GREEN)
    d.box('values', 3.4, 3.0, 6.2, 0.7, 'values/', 'tracks, known objects, wireframes', BLUE)
    d.box('geometry', 3.4, 2.1, 6.2, 0.7, 'geometry/', 'the mathematics: NumPy and SciPy only',
          BLUE)
    d.box('findings', 3.4, 1.2, 6.2, 0.7, 'findings/, errors.py', 'refusals and remarks as data, '
          'and their words', BLUE)
    d.box('adapters', 7.75, 2.1, 1.7, 2.5, 'msg_adapters', 'ROS messages\nto values,\nand back',
          GREY)
    for start, end in (('nodes:b', 'report:t-2.2'), ('cli:b', 'report:t+2.2'),
                       ('report:b', 'pipeline:t'), ('pipeline:b-3.18', 'features:t'),
                       ('pipeline:b-1.05', 'calibration:t'), ('pipeline:b+1.08', 'rorapid:t'),
                       ('pipeline:b+3.18', 'synthetic:t'), ('features:b', 'values:t-2.13'),
                       ('calibration:b', 'values:t'), ('rorapid:b', 'values:t+2.13'),
                       ('values:b', 'geometry:t'), ('geometry:b', 'findings:t')):
        d.arrow(start, end, colour=GREY)
    d.axes.text(4.6, 0.4, 'A room may import what lies below it. Rooms of one storey do not '
                'import each other:\nwhat they share is a value. test/test_layers.py holds the '
                'storeys.', ha='center', va='center', fontsize=9.5)
    return d


def calibrate(figure) -> None:
    """Draw the way of data through `calibrate`."""
    figure.set_size_inches(9.2, 6.9)
    d = sheet(figure, 9.2, 6.9)
    left, right, wide, high = 2.3, 6.9, 3.9, 0.92
    d.box('tracks', left, 6.3, wide, high, 'Tracks', 'frame, track, x, y\nvalues/tracks.py', GREY)
    d.box('facts', right, 6.3, wide, high, 'CameraFacts', 'what is known, each with a sigma\n'
          'geometry/camera_facts.py', GREY)
    d.box('graph', left, 5.05, wide, high, 'View graph', 'which views share points; F of pairs\n'
          'initialisation/view_graph.py')
    d.box('closed', left, 3.8, wide, high, 'Closed forms', 'fixed points, pencil of conics; '
          'affine chain\nplanar/, affine/')
    d.box('starts', left, 2.55, wide, high, 'Starts', 'proposed cameras, each with a structure\n'
          'initialisation/multi_start.py')
    d.box('bundle', left, 1.3, wide, high, 'One adjustment',
          'camera, path and points; Huber loss; outliers\nbundle/', GREEN)
    d.box('model', right, 1.3, wide, high, 'Which model?', 'distortion, planarity, rotation only\n'
          'estimators/model_selection.py', GREEN)
    d.box('sigma', right, 2.55, wide, high, 'What sigma misses',
          'shared errors, lens misfit, weak directions\nuncertainty/', GREEN)
    d.box('accept', right, 3.8, wide, high, 'Acceptance', 'tests that a result must pass\n'
          'estimators/acceptance.py', ORANGE)
    d.box('result', right, 5.05, wide, high, 'Calibration or NotCalibrated',
          'a refusal is a value with a reason\ncalibration/result.py', ORANGE)
    for start, end in (('tracks:b', 'graph:t'), ('graph:b', 'closed:t'), ('closed:b', 'starts:t'),
                       ('starts:b', 'bundle:t'), ('bundle:r', 'model:l'), ('model:t', 'sigma:b'),
                       ('sigma:t', 'accept:b'), ('accept:t', 'result:b')):
        d.arrow(start, end)
    d.arrow('facts:l-0.15', 'bundle:r+0.3', 'as measurements', GREY, 0.378, style='--')
    d.axes.text(4.6, 0.4, 'calibration/calibrate.py chooses the motion; each kind of motion is a '
                'file of estimators/.', ha='center', va='center', fontsize=9.5)


def tracker_frame(figure) -> None:
    """Draw what the object tracker does with one image."""
    figure.set_size_inches(9.2, 5.2)
    d = sheet(figure, 9.2, 5.2)
    wide, high = 2.72, 1.05
    columns = (1.55, 4.6, 7.65)
    d.box('image', columns[0], 4.5, wide, high, 'Image', 'cut out, distortion removed\n'
          'region/region_of_interest.py', GREY, 10)
    d.box('predict', columns[1], 4.5, wide, high, 'Predict', 'constant velocity\n'
          'estimation/kalman_filter.py', BLUE, 10)
    d.box('visible', columns[2], 4.5, wide, high, 'Visible primitives', 'control points on them\n'
          'visibility/visible_model.py', BLUE, 10)
    d.box('search', columns[2], 2.95, wide, high, 'Edge search', 'along the normals\n'
          'edges/edgels.py', GREEN, 10)
    d.box('texture', columns[1], 2.95, wide, high, 'Texture', 'corners of the faces\n'
          'texture/texture_memory.py', GREEN, 10)
    d.box('correct', columns[1], 1.4, wide, high, 'Correct the pose', 'one robust estimate\n'
          'estimation/robust_tracker.py', GREEN, 10)
    d.box('quality', columns[0], 1.4, wide, high, 'Judge', 'share that is confirmed\n'
          'estimation/track_quality.py', ORANGE, 10)
    d.box('memory', columns[2], 1.4, wide, high, 'Found again?', 'after a loss\n'
          'texture/view_memory.py', PURPLE, 10)
    d.box('frame', columns[0], 2.95, wide, high, 'TrackedFrame', 'state, pose, covariance\n'
          'tracked_frame.py', ORANGE, 10)
    for start, end in (('image:r', 'predict:l'), ('predict:r', 'visible:l'),
                       ('visible:b', 'search:t'), ('visible:b-0.9', 'texture:t+0.6'),
                       ('search:b-0.8', 'correct:t+0.9'), ('texture:b', 'correct:t'),
                       ('correct:l', 'quality:r'), ('quality:t', 'frame:b')):
        d.arrow(start, end)
    d.arrow('memory:l', 'correct:r', colour=PURPLE, style='--')
    d.arrow('frame:t+0.9', 'predict:b-0.9', 'next image', GREY, 0.5, (0.55, -0.05), style='--')
    d.axes.text(4.6, 0.4, 'All paths lie in rorapid/; rorapid/tracker.py calls them in this '
                'order.', ha='center', va='center', fontsize=9.5)


def _topic(node, direction, name) -> str:
    """Return a name that the node has."""
    assert any(end.name == name and end.direction == direction for end in INTERFACES[node]), name
    return name


def nodes(figure) -> None:
    """Draw the nodes and the topics between them."""
    figure.set_size_inches(9.2, 6.1)
    d = sheet(figure, 9.2, 6.1)
    wide, high = 2.2, 0.72
    d.box('player', 1.25, 5.6, wide, high, 'bag_player', 'or ros2 bag play', ORANGE)
    d.box('driver', 1.25, 4.5, wide, high, 'camera driver', '', GREY)
    d.box('tracker', 4.6, 5.05, wide, high, 'feature_tracker', '', BLUE)
    d.box('planar', 7.95, 5.6, wide, high, 'planar_calibrator', '', BLUE)
    d.box('affine', 7.95, 4.5, wide, high, 'affine_calibrator', '', BLUE)
    d.box('rorapid', 4.6, 3.1, wide, high, 'rorapid_tracker', '', GREEN)
    d.box('publisher', 1.25, 1.7, wide, high, 'camera_info_publisher', '', ORANGE)
    d.box('file', 7.95, 1.7, wide, high, 'calibration file', 'camera_info/NAME.yaml', GREY)
    d.box('consumers', 4.6, 1.7, wide, high, 'consumers', 'image_proc, drivers, ...', GREY)
    image = _topic('feature_tracker', 'in', 'image')
    tracks = _topic('planar_calibrator', 'in', _topic('feature_tracker', 'out', 'tracks'))
    _topic('affine_calibrator', 'in', tracks)
    info = _topic('planar_calibrator', 'out', 'camera_info')
    _topic('rorapid_tracker', 'in', info)
    d.arrow('driver:r', 'tracker:l-0.15', image)
    d.arrow('player:r', 'tracker:l+0.15', _topic('bag_player', 'out', 'image'))
    d.arrow('tracker:r+0.15', 'planar:l', tracks)
    d.arrow('tracker:r-0.15', 'affine:l', tracks)
    d.arrow('driver:b', 'rorapid:l+0.15', _topic('rorapid_tracker', 'in', 'image'), at=0.45)
    d.arrow('affine:b-0.7', 'rorapid:r+0.15', info)
    d.arrow('affine:b-0.2', 'consumers:t+0.8', info, at=0.62)
    d.arrow('affine:b+0.7', 'file:t+0.7', _topic('planar_calibrator', 'service', '~/save'),
            at=0.5, style='--')
    d.arrow('rorapid:b', 'consumers:t', _topic('rorapid_tracker', 'out', 'pose'))
    d.arrow('publisher:r', 'consumers:l', _topic('camera_info_publisher', 'out', 'camera_info'),
            shift=(0, 0.2))
    d.arrow('file:l', 'consumers:r', 'read at start', GREY, shift=(0, 0.2), style='--')
    d.arrow('file:b', 'publisher:b', 'followed when it changes', GREY, bend=-0.09,
            shift=(0, -0.33), style='--')
    also = [_topic('planar_calibrator', 'out', name) for name in (
        'structure', 'camera_path', '~/markers', '~/result', '/diagnostics')]
    d.axes.text(4.6, 0.4, f'Both calibrators also publish {", ".join(also[:-1])} and {also[-1]}.',
                ha='center', va='center', fontsize=9.5)
