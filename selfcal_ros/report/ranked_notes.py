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
What a reader should know, in the order of what it does to the result.

A finding carries its kind, so its weight follows from that and from its own numbers; a sentence
without a kind tells how the tracks came about, and comes last.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from selfcal_ros.calibration.result import Calibration, NotCalibrated
from selfcal_ros.calibration.structure.angular_measurement import measurement_findings
from selfcal_ros.findings.finding import Finding

#: Notes that are seen at once; the others are folded.
MOST_SHOWN = 7
#: Weights: the result may be wrong; it is, or had to be, less certain or another model; it leans
#: on something; what it means; how it was made.
DOUBT, WIDER, LEANS, MEANS, MADE = 4, 3, 2, 1, 0

_DOUBT = ('fact_contradicted_too', 'fact_doubtful', 'fact_trusted', 'fact_unchecked',
          'images_rectified', 'images_shifted', 'fact_decides', 'other_camera_left_out',
          'parameters_unobservable',
          'camera_changed', 'tracks_unexplained_whole', 'image_size_not_stated',
          'image_size_doubtful', 'points_outside', 'fixed_camera', 'body_poses_partly',
          'fixed_camera_features', 'rolling_shutter_suspected', 'line_delay_open',
          'object_misfits_frames', 'views_unconnected')
_WIDER = ('fact_unsure', 'errors_within_track', 'errors_within_region', 'errors_within_segment',
          'errors_at_object_points', 'errors_within_edge', 'regions_beyond_lens', 'lens_deviates',
          'lens_may_be_prism', 'fisheye_decentred', 'focal_drifts', 'focal_varies',
          'lever_not_excluded', 'board_print_off', 'circular_motion', 'not_exactly_planar',
          'not_exactly_rotation', 'frames_turned_estimated', 'rolling_shutter',
          'rolling_shutter_unstamped', 'rolling_shutter_stated', 'rows_by_view',
          'object_moves_in_rows', 'tracks_moving', 'motion_suggestion', 'motion_needed')
_MEANS = ('field_of_view', 'central_angle', 'typical_measurements')
_MADE = ('few_images', 'mode_chosen', 'frames_far_apart', 'frames_thinned', 'division_model',
         'tracks_contradictory', 'positions_surplus', 'positions_unregistered',
         'positions_contradictory',
         'keyframes_chosen', 'views_used', 'compressed_taken', 'image_circle', 'static_matches',
         'still_tracks', 'static_tracks', 'static_region',
         'pairs_degenerate', 'object_seen', 'object_followed', 'translation_groups',
         'images_interlaced', 'images_turned', 'images_halved', 'too_fast_to_follow',
         'tracks_jump', 'turning_left_out')
_WEIGHTS = {kind: weight for kinds, weight in ((_DOUBT, DOUBT), (_WIDER, WIDER), (_MEANS, MEANS),
                                               (_MADE, MADE)) for kind in kinds}
#: What a finding multiplies sigmas by, or moves by so many of them, is among its values.
_FACTORS = ('sigmas', 'ratio', 'factor')


@dataclass(frozen=True)
class Note:
    """
    A sentence, and whether the result may be wrong because of it.

    Attributes
    ----------
    text : str
    doubtful : bool

    """

    text: str
    doubtful: bool = False


def ranked_notes(result: Calibration | NotCalibrated,
                 further: Iterable[Finding | str] = ()) -> tuple[Note, ...]:
    """
    Return all notes, those that do most to the result first.

    Parameters
    ----------
    result : Calibration or NotCalibrated
    further : iterable of Finding or str
        Of the tracks, or from outside.

    """
    found: list[Finding | str] = []
    if result:
        known = result.identifiability
        found = [*result.findings, *(known.findings() if known else ()),
                 *measurement_findings(result.camera, result.covariance, result.measured)]
    weighed = {str(one): _weight(one) for one in reversed([*found, *further])}
    # as they came, where they weigh the same
    order = sorted(reversed(weighed), key=weighed.__getitem__, reverse=True)
    return tuple(Note(text, weighed[text][0] == DOUBT) for text in order)


def _weight(note: Finding | str) -> tuple[int, float]:
    """Return the class of a note, and how many sigmas it is about."""
    if isinstance(note, str):
        return MADE, 0.0
    sizes = (note.values.get(name) for name in _FACTORS)
    size = next((float(one) for one in sizes if isinstance(one, (int, float))), 1.0)
    return _WEIGHTS.get(note.kind, LEANS), size
