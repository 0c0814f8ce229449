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
The words of every refusal: why there is no calibration, and what would help.

The advice is said after the sentence. The closed forms refuse, too (`closed_forms`); where a
calibration rests on one of them alone, their words are the refusal's.
"""

from __future__ import annotations

from selfcal_ros.findings.phrase import Phrase

REFUSALS: dict[str, Phrase] = {
    # the tracks
    'too_few_images_share_points': Phrase(
        'Fewer than two images share tracked points.',
        'Nothing relates one image to another. The tracks may be lost between the images, or '
        'there is one image only.',
        'Check that the images overlap and show texture.'),
    'points_on_a_line': Phrase(
        'The points of an image lie on a line, to within {width_px:.2g} px.',
        'One line in every image says nothing of how the images are related.',
        'Track points all over the images.'),
    'equations_singular': Phrase(
        'The equations of these points have no solution.',
        'A system of equations turned out singular. Often points coincide, lie far off the image, '
        'or are the same in image after image.',
        'Track points all over the images, and leave out what lies off them. If nothing of that '
        'holds, report it with the tracks.'),
    'no_epipolar_geometry': Phrase(
        'No two images share enough points with a consistent epipolar geometry (at least {least} '
        'are needed, and {least_doubtful} where some disagree).',
        'The matches of every pair are too few, or they contradict each other.',
        'Check that the images overlap and show texture.'),
    'nothing_moves': Phrase(
        'Nothing moves in the {images} images: they all show the same from one place.',
        'Nearly every point stays where it is. One view does not determine a camera.',
        'Move and turn the camera between the images.'),
    'too_few_images': Phrase(
        'Only {images} image{images:plural} {images:shares|share} points; self-calibration needs '
        'at least three.',
        'Two images do not determine the internal parameters of a camera.',
        'Record a longer sequence with turns.'),
    'too_few_observations': Phrase(
        '{points} point{points:plural} in {images} image{images:plural} {points:leaves|leave} '
        '{freedom} degree{freedom:plural} of freedom; the estimate '
        'could not be checked.',
        'The unknowns take up nearly all observations. Errors would not show in the residuals.',
        'More points or more images are needed.'),
    'too_many_outliers': Phrase(
        '{rejected:percent} % of the observations contradict the rest: what remains may be '
        'chosen to fit.',
        'More than a third of the observations was rejected. Where the focal length varies it '
        'was a fifth, most of it on tracks that contradict as wholes. The rest then proves '
        'nothing.',
        'The scene must stand still and be distinct: repeated patterns are easily taken for one '
        'another.'),
    'tracks_unexplained': Phrase(
        'No camera and no such motion explain the tracks: the best leaves {left_px:.2g} px, '
        'where pairs of images agree to {noise_px:.2g} px.',
        'The pairs of images are consistent, but no camera with one path is. Often things in the '
        'scene move.',
        'The scene must stand still, and most of what is seen must belong to it.'),
    'focal_not_constant': Phrase(
        'The images contradict a constant focal length.',
        'Zoom, autofocus or warm-up changes the focal length; the contradiction is beyond four '
        'sigmas.',
        'Lock zoom and focus, or let the focal length vary (--focal varying).'),
    'no_start': Phrase(
        'No camera and no such motion explain the tracks: no start stands, where pairs of images '
        'agree to {noise_px:.2g} px.',
        'Every supposed camera puts points behind the camera or leaves the adjustment without a '
        'solution.',
        'The scene must stand still, and most of what is seen must belong to it.'),
    # the motion
    'no_parallax': Phrase(
        'One homography explains every pair of images to within the noise ({parallax_ratio:.1f} '
        'times it): the camera only rotated, or all points lie on one plane.',
        'Without parallax the images say nothing of depth. The method from motion needs it.',
        'Self-calibration from motion needs a camera that also moves, before a scene with depth; '
        'or say --motion rotation, if it only rotated.'),
    'no_motion': Phrase(
        'The camera did not turn, nor did it move.',
        'All images are alike to within the noise.',
        'Turn it, about two axes.'),
    'no_rotation': Phrase(
        'The camera did not rotate measurably; self-calibration needs rotation.',
        'Pure translation says nothing of the internal parameters, however precise the images '
        'are.',
        'Turn the camera by 20 degrees or more: a vehicle in curves to the left and to the '
        'right, an arm about two axes.'),
    'rotation_too_small': Phrase(
        'The camera did not rotate enough ({turned_deg:.1f} degrees in all) to determine '
        '{missing}.',
        'The sigmas of these parameters exceed the limits beyond which a parameter counts as '
        'unobservable.',
        'Turn the camera by 20 degrees or more: a vehicle in curves to the left and to the '
        'right, an arm about two axes.'),
    'not_planar': Phrase(
        'The motion is not planar: views are tilted out of the plane by {tilt_deg:.0f} degrees '
        '(root mean square).',
        'The camera rolled or pitched, or its height changed. Planar motion was asked for.',
        'Use a stretch of the recording on even ground, or say that the motion is general.'),
    'fact_missing': Phrase(
        'Planar motion alone leaves one parameter of the camera open ({missing} unobservable).',
        'All rotations share one axis. One direction of the parameters stays open, whatever the '
        'images are (thesis 5.2).',
        'State one fact: the aspect ratio (square pixels: 1), the skew or the principal point.'),
    'horizon_level': Phrase(
        'The horizon is level to {roll_deg:.1f} degrees, where zero skew alone cannot determine '
        'the camera ({missing} unobservable; thesis 5.2.3).',
        'With a level horizon all members of the family of cameras have the same skew.',
        'State the aspect ratio (square pixels: 1) or the principal point, or mount the camera '
        'with a roll of 20 degrees or more.'),
    'flat_turntable': Phrase(
        'What turns is one flat disc, about the axis that is perpendicular to it: {missing} stay '
        'open.',
        'A plane that turns in itself shows its circular points, and nothing else. These are two '
        'numbers, where a camera with square pixels has three.',
        'State square pixels and the principal point as facts, or put things of some height on '
        'the disc.'),
    'circle_undetermined': Phrase(
        'All views turn about one axis ({turned_deg:.0f} degrees in all), which leaves {missing} '
        'open.',
        'In circular motion the principal point is free along the image of the axis (thesis 5.3). '
        'So is the focal length where the camera looks straight at the axis.',
        'State square pixels and the principal point as facts. Or turn the thing about a second '
        'axis, too: tilt it, or move the camera off the circle.'),
    'parameters_undetermined': Phrase(
        'The images do not determine {missing}: the camera turned by {turned_deg:.0f} degrees in '
        'all ({path} motion).',
        'The sigmas of these parameters exceed the limits beyond which a parameter counts as '
        'unobservable.',
        'Turn more, left and right, near structure at several distances; or state the principal '
        'point or a simpler distortion model as a fact.'),
    'frames_turned': Phrase(
        'The frames that were said to be related by translation turned by {turned_deg:.2g} '
        'degrees.',
        'The images contradict the statement that these frames have one orientation.',
        'Name those that kept their orientation, or leave it to the images to find them.'),
    'too_few_stated_frames': Phrase(
        'Fewer than two of the frames that were said to be translated share points with the '
        'rest.',
        'The frames named are not in the tracks, or nothing in them was followed.',
        'Name at least two frames that see the same scene.'),
    'no_translated_pair': Phrase(
        'No two views are related by pure translation. Of {pairs} pairs, frames {first} and '
        '{second} come nearest, where F = [e]x is rejected with {statistic:.3g} against '
        '{limit:.3g}.',
        'The camera turned between all views. The affine chain (thesis, chapter 4) starts from '
        'views of one orientation.',
        'Move without turning between two or more images, then turn about two axes; or say '
        '--motion general.'),
    'moved_not_rotated': Phrase(
        'A camera that only rotates leaves {left_px:.2g} px where the epipolar geometry leaves '
        '{noise_px:.2g} px: the camera also moved.',
        'The images show parallax. A rotation about the optical centre explains none.',
        'Calibrate with --motion auto, or rotate the camera about its optical centre before '
        'distant structure.'),
    'only_a_hint': Phrase(
        'The camera turned by {turned_deg:.1f} degrees in all, which suggests a focal length of '
        '{focal_px:.0f} ± {sigma_px:.0f} px.',
        'So small a turn shows the focal length by tiny differences. Drift of the tracks, or a '
        'path that is not quite as supposed, makes as much. No camera file is written.',
        'Turn the camera by 20 degrees or more, or walk further round the scene.'),
    'centre_outside': Phrase(
        'The images suggest a focal length of {focal_px:.0f} ± {sigma_px:.0f} px, with a '
        'principal point far from the middle of the image, at {cx:.0f}, {cy:.0f}.',
        'Hardly a camera has such a principal point. What is supposed of noise and path weighs '
        'more here than the images do. No camera file is written.',
        'Record more views, and turn the camera by 20 degrees or more; of a cropped image, state '
        'the principal point.'),
    'focal_too_short': Phrase(
        'The best explanation of the images has a focal length of {focal_px:.2g} px in images of '
        '{side_px} px: no lens is so wide.',
        'Such a camera bends images at will, and explains what moves, drifts, or is read row by '
        'row. It is no calibration.',
        'Record a path that turns by 20 degrees or more before a scene of some depth; mask what '
        'moves.'),
    'points_behind': Phrase(
        'The images do not determine the camera, which moved little beside its rotations: their '
        'best explanation puts {share:percent} % of the points behind it.',
        'Beside large rotations a small translation is nearly confounded with the focal length '
        'and the principal point.',
        'Move the camera further between the images, or turn it about its optical centre.'),
    'unlike_rotations': Phrase(
        'The images do not determine the camera, which moved little beside its rotations: '
        'fx = {focal_px:.0f} with a path, {turned_px:.0f} without one, explain them alike.',
        'Beside large rotations a small translation is nearly confounded with the focal length '
        'and the principal point. A scene inside out then explains the images as well.',
        'Move the camera further between the images, or turn it about its optical centre.'),
    'rotations_leave_open': Phrase(
        'The rotations do not determine {missing}; turn the camera further and about more than '
        'one axis.',
        'The sigmas of these parameters exceed the limits beyond which a parameter counts as '
        'unobservable.',
        'State a fact that is known of the camera, if it cannot turn further.'),
    'images_slide': Phrase(
        'The images slide and turn in themselves, as those of a camera that looks straight at a '
        'plane: the focal length stays open.',
        'A camera that looks straight down at a floor sees the same whatever its focal length is. '
        'Only perspective tells it from a turn behind a very long lens, and none is seen.',
        'Tilt the camera by 20 degrees or more, or let it see things of different heights.'),
    'no_homography_pair': Phrase(
        'No two images share {needed} points that a homography maps.',
        'The images of a rotating camera are related by homographies. No pair of these is.',
        'Check that the images overlap and show texture.'),
    'no_such_camera': Phrase(
        'Only a focal length of {focal_px:.3g} px with a skew of {skew_px:.3g} px explains the '
        'images, which is no camera.',
        'The rotations are too small, or the tracks are wrong.',
        'Turn the camera further, about two axes, before a scene that stands still.'),
    'objects_insufficient': Phrase(
        'With every object taken for an image: {why:clause}.',
        'Equal objects in one image act as images of one object. They do not suffice for the '
        'reason given.',
        'Give three or more equal objects with depth, turned against each other by 20 degrees or '
        'more, each large in the image. State which of them stand parallel, if some do '
        '(--parallel-objects).'),
    # the lens
    'start_distortion_not_invertible': Phrase(
        'The distortion of the best start cannot be undone over the whole image.',
        'The supposed distortion folds the image. Points there have no direction.',
        'State a simpler distortion model.'),
    'distortion_not_invertible': Phrase(
        'The distortion found ({model}) cannot be undone over the whole image.',
        'The estimated distortion folds the image. Points there have no direction.',
        'State a simpler distortion model.'),
    'smooth_misfit': Phrase(
        'The images disagree with the camera by {rms_px:.2g} px, smoothly over the image and '
        'beyond the distortion that was estimated. What is found may be wrong by more than its '
        'sigmas.',
        'The residuals are alike in each region of the image. No lens deviates that much from '
        'its model.',
        'The scene may be nearly one plane, move, or repeat itself; or the lens or the shutter is '
        'not as stated (--lens auto, --shutter auto).'),
    # facts
    'fact_contradicted': Phrase(
        'The images contradict the stated {fact} by {sigmas:.0f} sigmas: they prefer '
        '{preferred:preferred}.',
        'Released, the fact comes out elsewhere, beyond chance, and the camera with it. Either '
        'the fact is wrong, or the tracks are. Of fewer than six images, and before a board, it '
        'may be a rolling shutter, which is not asked for then.',
        'Release it (--aspect-ratio free, --skew free, --lens auto, --shutter auto, no '
        '--principal-point), or state it with a sigma; where the fact is certain, say '
        '--trust-facts.'),
    'two_cameras': Phrase(
        'The images are of two cameras: those of {second:frames} differ from those of '
        '{first:frames}.',
        'Two values of focal length and principal point, one a group of images, explain nearly '
        'all that the images differ by. The frames are all in the result file.',
        'Calibrate the images of each camera by themselves; check that none was cropped, scaled '
        'or zoomed.'),
    'images_mirrored': Phrase(
        'Some images are mirror images of what the others are: those of {mirrored:frames}, or '
        'all others.',
        'The scene turns the other way round in them. A driver or a program flips images, or a '
        'mirror is in the way.',
        'Mirror them back, or leave them out.'),
    # known points
    'object_without_extent': Phrase(
        'The object has no extent: all its points are one.',
        'The file of object points holds one place only.',
        'Check the file of object points.'),
    'no_common_numbers': Phrase(
        'None of the observed points belongs to the object: the point numbers of the two files '
        'do not match.',
        'The identities of the tracks and of the object points have nothing in common.',
        'Number the points alike in both.'),
    'no_usable_view': Phrase(
        'No view can be used: {why:clause}.',
        'Every view shows too few points, or points in a degenerate position.',
        'Show at least 6 points of a solid or 4 of a plane in a view.'),
    'too_few_points': Phrase(
        'Too few points: {coordinates} coordinates were measured, and there are {unknowns} '
        'unknowns.',
        'Every view adds six unknowns, and every point seen two equations.',
        'Give more points or views, or state what is known of the camera.'),
    'no_fit_to_points': Phrase(
        'The adjustment found no camera that fits the points.',
        'The adjustment ended without a finite solution, or outliers left too few points.',
        'Give more points or views, or state what is known of the camera.'),
    'object_mirrored': Phrase(
        'The images show the mirror image of the object: its coordinates are left-handed.',
        'A camera cannot see the object with these coordinates.',
        'Change the sign of one coordinate of every object point.'),
    'object_misfit': Phrase(
        'The observed points do not fit the object: {left_px:.3g} px remain where {limit_px:.2g} '
        'px could be noise.',
        'Points are numbered wrongly, the measures are wrong, or the object bends.',
        'Check that both files number the points alike, the numbers of columns and rows, and '
        'that the object is rigid.'),
    'one_flat_image': Phrase(
        'All points of the only image lie in one plane, which leaves {missing} open.',
        'One image of a plane gives two equations for the parameters of the camera.',
        'Add views of the board under other tilts, use a solid object, or state the principal '
        'point and the aspect ratio.'),
    'views_alike': Phrase(
        'The {views} views of the plane are too much alike; they leave {missing} open.',
        'Every view of a plane gives two equations. Those of parallel planes are the same.',
        'Tilt the board by 20 to 45 degrees about different axes between the views.'),
    'object_leaves_open': Phrase(
        'The points of the object leave {missing} open.',
        'The sigmas of these parameters exceed the limits beyond which a parameter counts as '
        'unobservable.',
        'Show the object larger, nearer, or in more views, or state what is known of the camera.'),
    # edges of a tracked object
    'object_not_followed': Phrase(
        'The object could not be followed: {why}.',
        'The tracker lost the object before enough images were seen.',
        'Check the start pose with `selfcal track --overlay`, and that the object is seen '
        'sharply.'),
    'edges_not_measured': Phrase(
        'The edges of the object could not be measured.',
        'No image shows enough edges near where the model has them.',
        'Show it larger and sharper.'),
    'too_few_edge_images': Phrase(
        'The object was followed in fewer than two images with enough edges.',
        'A single image leaves the camera open.',
        'Show it larger and sharper, with at least three of its faces or circles.'),
    'no_fit_to_edges': Phrase(
        'The adjustment found no camera that fits the edges.',
        'The adjustment ended without a finite solution, or outliers left too few edges.',
        'Check the model, its unit (metres) and the start pose.'),
    'edges_misfit': Phrase(
        'The edges lie {left_px:.2g} px from the model: that is more than noise.',
        'Other edges than those of the model were measured, or the model is not the object.',
        'Check the proportions of the model, that the object is rigid, and with `selfcal track '
        '--overlay` that its own edges are followed. A better camera to begin with (--camera) '
        'helps.'),
    'edges_leave_open': Phrase(
        'What was seen of the object leaves {missing} open.',
        'The sigmas of these parameters exceed the limits beyond which a parameter counts as '
        'unobservable.',
        'Show the object nearer, in all parts of the image and under other angles. Or state the '
        'principal point (--principal-point, with its sigma) or the aspect ratio.'),
    'focal_length_changes': Phrase(
        'The focal length changes: {first_px:.0f} px in the first half of the images, '
        '{second_px:.0f} px in the second.',
        'The lens zoomed or focused. The calibration supposes one focal length.',
        'Track with --camera-model zoom: it gives the focal length of every image.'),
    # the nodes
    'session_reset': Phrase(
        'The session was reset: {why}.',
        'What was collected is void. The node starts anew.',
        'Keep moving.'),
    'estimate_failed': Phrase(
        'The estimate failed ({error}); please report the lines on standard error.',
        'A fault of the program. The node lives on.',
        'The next estimate may succeed.'),
    'process_ended': Phrase(
        'The process of the estimate ended unexpectedly (out of memory?).',
        'The operating system ended the process, or it crashed.',
        'The next estimate starts another one.'),
    # cameras that move together
    'rig_cameras_refused': Phrase(
        'No camera of the rig can be calibrated by itself. Of {camera}: {why}.',
        'The rig starts from at least one camera whose images determine it.',
        'Drive curves both ways, or state what is known of the cameras.'),
    'rig_path_unknown': Phrase(
        'The images of {camera} show a camera that only turns, so that nothing tells how far the '
        'cameras are apart.',
        'The poses of cameras to each other follow from ways that they go together.',
        'Move the rig along, in curves, while it records.'),
    'rig_camera_refused': Phrase(
        'The camera {camera} cannot be placed in the rig: {why}.',
        'A camera that cannot be calibrated by itself needs points that another camera sees, '
        'too.',
        'Drive curves both ways, or let it see the same things as another camera.'),
    'rig_not_simultaneous': Phrase(
        'Too few images of {camera} are of the same instants as those of another camera: '
        '{instants}, and {least} are needed.',
        'Cameras of a rig are compared where their images are of one instant.',
        'Trigger the cameras together, or check their stamps.'),
    'rig_not_rigid': Phrase(
        'The cameras do not move as one rigid body: together they leave {left_px:.2g} px where '
        'each alone leaves {noise_px:.2g} px, and {rejected:percent} % contradict.',
        'A pose between two cameras changed, or their images are not of the same instants.',
        'Check the mounts, and that equal frames are of one instant.'),
    'rig_clocks_apart': Phrase(
        'The images of {camera} were taken {apart:later} than those of {first}. Together the '
        'cameras leave {left_px:.2g} px where each alone leaves {noise_px:.2g} px.',
        'A camera that is late sees the rig where it is later, and no rigid rig does that.',
        'Trigger the cameras together, or correct their stamps.'),
    'rig_knocked': Phrase(
        'The pose of {camera} to {first} changed before frame {frame}. Together the cameras '
        'leave {left_px:.2g} px where each alone leaves {noise_px:.2g} px.',
        'One pose up to some instant and another from then on explains the images.',
        'Check the mounts, and calibrate from the images before or after it.'),
    'rig_lens_open': Phrase(
        'The motion leaves {missing:and} of the camera {camera} open.',
        'Cameras side by side that move along one line, or turn about one axis, do not show '
        'their focal lengths.',
        'Drive curves both ways, or state square pixels.'),
}
