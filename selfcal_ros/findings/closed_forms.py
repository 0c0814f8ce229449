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
The words of every step that gives no estimate: closed forms, geometry of views, single windows.

Most of them are heard by programs that call these functions. A user hears one where a calibration
rests on it alone. The advice is then said after the sentence.
"""

from __future__ import annotations

from selfcal_ros.findings.phrase import Phrase

CLOSED_FORMS: dict[str, Phrase] = {
    'too_few': Phrase(
        'A {what} needs at least {needed} {items}; there are {found}.',
        'There are fewer data than unknowns, or none to spare for a check.',
        'Give more data, or loosen what was asked.'),
    'too_few_shared': Phrase(
        'No {views:number} views share {needed} {items}.',
        'The tracks are too short, or the views do not overlap.',
        'Check that the images overlap and show texture.'),
    # two and three views
    'no_agreeing_sample': Phrase(
        'No sample of seven matches is supported by an eighth within {threshold_px:g} px.',
        'The matches are wrong, or noisier than the threshold.',
        'Check the matches, or allow a larger distance.'),
    'matches_on_line': Phrase(
        'The matches lie on a line; they leave the homography open.',
        'A homography needs four points of which no three lie on a line.',
        'Give matches that spread over the image.'),
    'point_at_infinity': Phrase(
        'A point is mapped to infinity.',
        'The model that was fitted puts an observed point on its vanishing line.',
        'Check the matches for gross errors.'),
    'points_on_plane': Phrase(
        'The points lie on a plane; they leave the camera matrix open.',
        'A camera matrix needs points with depth.',
        'Use points of a solid, or the homography of the plane.'),
    'camera_matrix_open': Phrase(
        'The points leave the camera matrix open (two solutions fit).',
        'The points and the camera centre lie on a twisted cubic, or nearly all points on a '
        'plane.',
        'Give more points, in another arrangement.'),
    'camera_at_infinity': Phrase(
        'The camera matrix is that of a camera at infinity.',
        'Its left 3 x 3 part is singular. It has no centre and no calibration matrix.',
        'Use a weak-perspective model, or views from nearer.'),
    'tensor_open': Phrase(
        'The point triplets leave more than one trifocal tensor: points in one plane, or equal '
        'views.',
        'The linear equations of the tensor lack rank.',
        'Give points with depth, in views from three places.'),
    'reduced_tensor_open': Phrase(
        'The point triplets leave more than one reduced tensor: equal views or no rotation.',
        'The linear equations of the tensor of planar motion lack rank.',
        'Give views from three places, turned against each other.'),
    'cubic_degenerate': Phrase(
        'The cubic of the fixed lines degenerates.',
        'The reduced tensor has no three fixed lines.',
        'Use another triplet of views.'),
    'fixed_lines_real': Phrase(
        'All three fixed lines of the triplet are real; it says nothing of the circular points.',
        'Noise made the pair of complex lines real. The rotation is too small.',
        'Use another triplet of views, with larger rotations.'),
    'conic_not_finite': Phrase(
        'The image of the absolute conic is not finite.',
        'An earlier step divided by nothing.',
        'Check the input for degenerate views.'),
    'conic_not_definite': Phrase(
        'The image of the absolute conic is not definite (least eigenvalue {least:.2g} after '
        'scaling): no real camera fits.',
        'Noise or a wrong fact exceeds what the views determine.',
        'Give more views or larger rotations, and check the facts.'),
    'dual_conic_degenerate': Phrase(
        'The dual image of the absolute conic is degenerate.',
        'The equations were solved by a conic of lower rank.',
        'Give more views, turned about another axis.'),
    # fixed points of planar motion
    'one_pair_only': Phrase(
        'Only one image pair is sound; the vanishing point needs two screw axes.',
        'The other pairs lack parallax or rotation.',
        'Give more views, with larger rotations.'),
    'pairs_not_planar': Phrase(
        'The motion is not planar: planar epipolar geometry leaves {left_px:.3g} px, general '
        'motion {noise_px:.3g} px.',
        'The views do not share one axis and one plane of motion.',
        'Use a stretch of the recording on even ground, or say that the motion is general.'),
    'pairs_without_parallax': Phrase(
        'The views show no parallax: a homography explains the best pair to {left_px:.3g} px at '
        'a noise of {noise_px:.3g} px. Either the camera only turned, or it hardly moved, or all '
        'points lie in one plane.',
        'The epipolar geometry of such pairs is open.',
        'Move the camera before a scene with depth.'),
    'pairs_without_rotation': Phrase(
        'The views show no rotation: a pure translation explains the best pair to {left_px:.3g} '
        'px at a noise of {noise_px:.3g} px.',
        'Pure translation has no fixed points but those of the plane at infinity.',
        'Turn the camera by 20 degrees or more: a vehicle in curves to the left and to the '
        'right, an arm about two axes.'),
    'no_triplet': Phrase(
        'None of {triplets} triplets gives circular points. {why}',
        'Each triplet of views failed; the reason of the first is given.',
        'Give more views, with larger rotations.'),
    'no_sound_pairs': Phrase(
        'No triplet has sound pairs.',
        'All pairs were left out for want of parallax or rotation.',
        'Give more views, with larger rotations.'),
    # from fixed points to the camera
    'no_fact': Phrase(
        'Planar motion leaves one parameter of the camera open; state the aspect ratio, the skew '
        'or the principal point.',
        'The cameras that fit form a family of one parameter (thesis 5.2).',
        'State one of these facts.'),
    'circular_motion_needs_facts': Phrase(
        'Circular motion leaves the vanishing point of the axis open; the camera needs a known '
        'aspect ratio and a known skew.',
        'All rotations share one axis in space. Two directions of the parameters stay open.',
        'State both facts, or move off the circle.'),
    'circular_points_at_infinity': Phrase(
        'The circular points lie at infinity.',
        'The image plane is parallel to the plane of motion, or the points were not found.',
        'Tilt the camera against the plane of motion.'),
    'axis_in_view': Phrase(
        'The camera looks nearly straight at the axis of its circular motion: the principal '
        'point misses it by about {distance_px:.3g} px, less than {limit_px:.3g} px. State the '
        'principal point, or move off the circle.',
        'Seen straight on, the image of the axis says nothing of the focal length.',
        'State the principal point, or move off the circle.'),
    'no_real_focal_length': Phrase(
        'No real focal length fits the circular points and the image of the rotation axis.',
        'Noise or a wrong fact exceeds what the views determine.',
        'Give more views, and check the facts.'),
    'fact_meets_no_member': Phrase(
        'The fact meets no member of the pencil.',
        'No camera of the family has the stated value.',
        'Check the fact.'),
    'skew_without_hold': Phrase(
        'The known skew cannot fix the camera: the horizon is inclined by only {tilt_deg:.2g} '
        'degrees.',
        'With a level horizon all members of the family of cameras have the same skew.',
        'State the aspect ratio or the principal point.'),
    'fact_without_hold': Phrase(
        'The known {known:and} cannot fix the camera: an error in it comes out {factor:.3g} '
        'times as large, more than {limit:g}. The horizon is inclined by {tilt_deg:.2g} degrees.',
        'The fact is nearly the same for all cameras of the family.',
        'State another fact.'),
    'skew_too_large': Phrase(
        'The only camera that fits has a skew of {skew_px:.3g} px at a focal length of '
        '{focal_px:.3g} px, which is no camera.',
        'Noise or a wrong fact exceeds what the views determine.',
        'Give more views, and check the facts.'),
    # infinite homographies
    'translated_views_equal': Phrase(
        'The translated views do not differ; there is no parallax.',
        'The camera stood still between them.',
        'Move the camera between the translated views.'),
    'translated_scene_flat': Phrase(
        'One plane explains translated frames {first} and {second} to within {ratio:.1f} times '
        'the noise: the points are flat or far, and leave the cameras open.',
        'Affine structure needs depth that differs from a plane.',
        'Move farther between the translated views, before a scene with depth.'),
    'two_views_only': Phrase(
        'Two views do not calibrate a camera; at least one more is needed, rotated against the '
        'translated ones.',
        'Views of one orientation give no infinite homography but the identity.',
        'Turn about the axis that is missing.'),
    'views_not_rotated': Phrase(
        'No view is rotated against another; pure translation says nothing of the camera.',
        'There is no infinite homography to calibrate from.',
        'Turn the camera by 20 degrees or more: a vehicle in curves to the left and to the '
        'right, an arm about two axes.'),
    'views_rotated_within_noise': Phrase(
        'No view is rotated against another by more than the noise; pure translation says '
        'nothing of the camera.',
        'All infinite homographies are the identity to within their covariance.',
        'Turn the camera by 20 degrees or more: a vehicle in curves to the left and to the '
        'right, an arm about two axes.'),
    'rotations_about_camera_axis': Phrase(
        "The rotations leave {missing} open: they are all about the camera's {axis} axis (up to "
        "{largest_deg:.2g} degrees). Add views that are turned about "
        "{wanted:axes}{helps:or_state}.",
        'Rotations about one axis leave a family of cameras (thesis 4.1.3).',
        'Turn about the axis that is missing.'),
    'rotations_about_one_axis': Phrase(
        'The rotations leave {missing} open: they are all about one axis (up to '
        '{largest_deg:.2g} degrees). Add views that are turned about an axis across that '
        'one{helps:or_state}.',
        'Rotations about one axis leave a family of cameras (thesis 4.1.3).',
        'Turn about the axis that is missing.'),
    'rotations_small': Phrase(
        'The rotations leave {missing} open: they reach {largest_deg:.2g} degrees only; turn the '
        'camera further.',
        'The rotations exceed their noise by too little.',
        'Turn further, about two axes.'),
    'no_plane_at_infinity': Phrase(
        'No plane at infinity satisfies the modulus constraint.',
        'Noise exceeds what the views determine, or the camera changed.',
        'Give more views, turned about several axes.'),
    'pairs_leave_camera_open': Phrase(
        "Kruppa's equations leave the camera open: the pairs' rotations are too small or about "
        "one axis.",
        'The slope of the equations vanishes in a direction of the parameters.',
        'Give pairs that are turned about several axes, or state facts.'),
    'no_translated_objects': Phrase(
        'No two objects are related by pure translation. Of {pairs} pairs, objects {first} and '
        '{second} come nearest, where F = [e]x is rejected with {statistic:.3g} against '
        '{limit:.3g}.',
        'Equal objects in one image act as views. All of them are turned against each other.',
        'Name the objects that stand parallel, or use an image with two that do.'),
    # one view of a known object
    'view_too_few': Phrase(
        'Frame {frame} has {points} point{points:plural}, where at least 4 of a plane or 6 of a '
        'solid are needed.',
        'The view gives fewer equations than it has unknowns.',
        'Show more of the object in this view.'),
    'view_too_few_of_solid': Phrase(
        'Frame {frame} has {points} point{points:plural}, where a solid needs at least 6.',
        'The view gives fewer equations than it has unknowns.',
        'Show more of the object in this view.'),
    'view_on_line': Phrase(
        'Frame {frame} has all points on one line.',
        'Points on a line leave the pose open.',
        'Show more of the object in this view.'),
    'view_homography_open': Phrase(
        'Frame {frame} has points that leave the homography open (three of four on a line).',
        'A homography needs four points of which no three lie on a line.',
        'Show more of the object in this view.'),
    'view_camera_open': Phrase(
        'Frame {frame} has no camera matrix: {why:clause}.',
        'The direct linear transformation has no single solution.',
        'Show more of the object in this view.'),
    # windows of the monitoring
    'window_singular': Phrase(
        'The adjustment of the keyframes is singular.',
        'These keyframes leave a parameter open. The window is skipped.',
        'Nothing; the next window may tell.'),
    'window_disconnected': Phrase(
        'Too few of the keyframes are connected.',
        'The keyframes share too few points. The window is skipped.',
        'Nothing; the next window may tell.'),
    'window_without_parallax': Phrase(
        'The keyframes show no parallax.',
        'The camera stood still or only turned. The window is skipped.',
        'Nothing; the next window may tell.'),
    'window_few_points': Phrase(
        'Only {points} point{points:plural} {points:is|are} seen in several keyframes.',
        'The tracks are too short. The window is skipped.',
        'Nothing; the next window may tell.'),
    'window_outside_lens': Phrase(
        'Points of the keyframes lie where the distortion cannot be undone.',
        'The supposed camera does not cover the image, or its adjustment failed. The window is '
        'skipped.',
        'Calibrate anew if it happens often.'),
    'window_unexplained': Phrase(
        'No camera before a still scene explains the keyframes: {left_px:.2g} px are left, with '
        '{still:.0%} of the tracks. Something moves by itself, or the rows are read one after '
        'the other while the camera shakes.',
        'The window says nothing of the camera, and is left out.',
        'Nothing, if it is rare. Else mask what moves, or drive more smoothly.'),
    # models from two views
    'points_outside_lens': Phrase(
        'Some points lie outside what the lens can show.',
        'The distortion of the camera cannot be undone at these points.',
        'Check the camera file and the clicked points.'),
    'points_miss_translation': Phrase(
        'The points miss the translation by {noise_px:.2g} px where {sigma_px:.2g} px of noise '
        'was expected: the camera turned, or some matches are wrong.',
        'The two views are not related by pure translation.',
        'Translate the camera without turning it, and check the matches.'),
    'points_behind_camera': Phrase(
        'Some points come out at infinity or behind the camera: the camera moved too little, or '
        'their matches are wrong.',
        'The parallax of these points is no larger than the noise.',
        'Move the camera farther, and check the matches.'),
    'depths_uncertain': Phrase(
        'The depths are uncertain by {share:percent} %: the camera moved too little.',
        'The parallax is hardly larger than the noise.',
        'Move the camera farther between the views.'),
    'known_length_zero': Phrase(
        'The two points of the known length coincide.',
        'The scale of the model comes from the distance of these points.',
        'Name two different points.'),
    'corners_disagree': Phrase(
        'Only {corners} corner{corners:plural} of lines {corners:looks|look} alike in both '
        'images, and no four of them agree on a translation; pick the vertices by hand.',
        'The images show too few distinct corners, or the camera turned.',
        'Pick the vertices by hand: `selfcal model --vertices`.'),
    'no_connected_lines': Phrase(
        'No lines were found that connect the same corners in both images; pick the vertices '
        'by hand.',
        'The edges are too faint or broken.',
        'Pick the vertices by hand: `selfcal model --vertices`.'),
    'no_closed_faces': Phrase(
        'The {lines} lines that were found in both images close to no face. Pick the vertices by '
        'hand, or show the object before a plain background.',
        'Pictures on the object or things behind it break its lines.',
        'Pick the vertices by hand: `selfcal model --vertices`.'),
}
