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
"""The words of why it is not known where the camera sits on the robot."""

from __future__ import annotations

from selfcal_ros.findings.phrase import Phrase

MOUNTING: dict[str, Phrase] = {
    'gyro_without_poses': Phrase(
        'The turns of the camera come without their instants or their covariance.',
        'A gyro is compared with turns between images. It needs a stamp of every image, and how '
        'well each turn is known.',
        'Give a bag, or images with time stamps, of a camera that moves before an unknown scene.'),
    'gyro_covers_too_little': Phrase(
        'The gyro covers {intervals} of the intervals between images; at least {least} are '
        'needed.',
        'It was recorded at another time than the images, or with long gaps.',
        'Record images and gyro together, by clocks that differ by less than half a second.'),
    'gyro_contradicts': Phrase(
        'The gyro contradicts the turns of the camera: {dropped} of {intervals} intervals '
        '{dropped:was|were} set aside, and the rest differ by {density_deg:.2g}° in a second.',
        'It is on another body, its axes are left-handed, or its clock is not that of the images.',
        'Check the topic of the gyro, its axes, and that it reports radians a second.'),
    'gyro_leaves_an_axis_open': Phrase(
        'The camera turned about one axis only: how it is turned against the gyro about that '
        'axis is not known (± {sigma_deg:.2g}°).',
        'Turns about one axis look alike to a camera that is turned about that axis.',
        'Turn about a second axis, too.'),
    'gyro_tells_no_place': Phrase(
        'A gyro measures no place and no length.',
        'It measures turns only.',
        'Give poses of the body: odometry, an arm, or motion capture.'),
    'gyro_turns_evenly': Phrase(
        'The turns are too even to tell the offset of the clocks.',
        'While a body turns at a steady rate, a later instant looks like an earlier one.',
        'Turn to and fro, so that the rate of turning changes.'),
    # from poses of the body
    'too_few_body_poses': Phrase(
        'Of {images} images, {found} {found:has|have} a pose of the body; a mount needs {needed}.',
        'The poses end before the images begin, or leave gaps where images were taken.',
        'Record poses and images over the same time, by clocks that agree to half a second.'),
    'too_few_images_for_mount': Phrase(
        '{found} {found:image has|images have} a pose of the body so far; a mount needs {needed}.',
        'Nearly all images have a pose, but they are few. A drive that has only begun fits '
        'several mounts.',
        'Move on, or use more images.'),
    'body_stood_still': Phrase(
        'The poses of {body} say that the robot stood still.',
        'Images of a moving camera say nothing of a body that does not move with it.',
        'Check that these are the frames of the robot that carries the camera.'),
    'body_turns_otherwise': Phrase(
        'Between images the body turned by {body_deg:.2g} degrees and the camera by '
        '{camera_deg:.2g}, differing by {apart_deg:.2g} (medians).',
        'A camera that is fixed to the body turns by the same angle. The frames, the units of '
        'angles or the clocks may be wrong.',
        'Check the names of the frames, that angles are in radians, and the stamps. Poses by '
        'image must be those of the image.'),
    'body_poses_wrong': Phrase(
        '{share:percent} % of the poses of the body contradict the others.',
        'A few wrong poses are set aside. So many leave open which are right.',
        'Check the names of the frames, the clocks, the unit (--robot-unit) and --robot-sigma, or '
        'record anew.'),
    'robot_sigma_too_small': Phrase(
        '{share:percent} % of the poses of the body contradict the others by the stated sigma '
        '{stated:and}; the images suggest {shown:and}.',
        'With errors of that size the poses agree with each other and with the images.',
        'State a larger --robot-sigma, or none: then the misfits tell it.'),
    'body_poses_unusable': Phrase(
        'The poses of the robot cannot be used: {why}',
        'The calibration stands without them.',
        'Correct what publishes the poses, or the names of the frames.'),
    'floor_not_seen': Phrase(
        'No floor is seen that would tell the height of the camera: {points} point{points:plural} '
        'below it {points:lies|lie} in one level plane.',
        'A floor is a thin level layer of many points below the camera.',
        'Look lower, at a floor with texture, or state the height.'),
    'floor_on_torn_path': Phrase(
        'The path may be two parts of different scale, at frame {frame}, so that the floor tells '
        'no height.',
        'The metre of one part would be taken for that of the other.',
        'Record slower there, so that more of the scene stays in view, or state the height.'),
    'floor_not_lowest': Phrase(
        'The fullest plane below the camera, at {depth:.2f} m, is not the floor: {points} '
        'point{points:plural} {points:lies|lie} below it.',
        'It may be a shelf, a table, or the roof of something low.',
        'Drive where the floor fills more of the image, or state the height.'),
    'floor_too_narrow': Phrase(
        'The plane at {depth:.2f} m below the camera is too narrow to be told from an edge.',
        'Points along a line lie in many planes.',
        'Drive where more of the floor is in view, or state the height.'),
    'floor_not_driven_over': Phrase(
        'The robot did not drive over the plane that is seen {depth:.2f} m below the camera.',
        'Only what the robot drives over is sure to be its floor. It may be a shelf.',
        'Drive farther ahead, so that the camera passes over what it saw, or state the height.'),
    'floor_not_level': Phrase(
        'The plane below the camera is tilted by {degrees:.1f} degrees against the motion.',
        'A robot drives along its floor. A ramp ahead is another plane.',
        'Drive on a level floor, or state the height.'),
    'mount_facts_wrong': Phrase(
        'No mount has the stated {facts:and} and explains the poses of the body.',
        'What is stated without a sigma is held, wherever the images and the poses lead.',
        'Leave the facts out and look where they come out, or state them with a sigma.'),
    'mount_singular': Phrase(
        'The equations of the mount have no solution with these {count} poses of the body.',
        'A system of equations turned out singular, and which part is to blame is not known.',
        'Check the poses and what is stated of the mount. Record larger and more varied turns.'),
    'mount_fact_contradicted': Phrase(
        'Images and poses contradict the stated {fact} of the mount by {sigmas:.0f} sigmas: '
        'they prefer {preferred:preferred} {unit}.',
        'Without the fact it comes out elsewhere, beyond chance, and the mount with it.',
        'Leave the fact out, or state it with a sigma that holds what it may be off by.'),
    'metres_differ': Phrase(
        'A metre of the poses is {ratio:.4g} m of the known object: one of them is wrong.',
        'The camera moved by more or less before the object than the poses say. Where it sits '
        'would be off by far more than its sigmas.',
        'Measure the object again (the side of a square, not the board); where the poses are '
        'known to be off, state --mount-fact scale=VALUE:SIGMA.'),
    'no_mount_fits': Phrase(
        'No mount of the camera explains the {count} poses of the body.',
        'The closed forms find no place, turn and positive scale.',
        'Check that the poses are those of the body in a fixed frame, and not the inverse.'),
    'body_poses_inverse': Phrase(
        'The {count} poses of the body contradict the images, and their inverse does not.',
        'A pose takes points of the body to a fixed frame. These take points of that frame to the '
        'body, as a view matrix does.',
        'Invert each pose, or swap the two frames that it leads from and to.'),
    'body_quaternions_permuted': Phrase(
        'The {count} poses of the body contradict the images. Their quaternions seem to be in the '
        'order {truly}, under the names {named}.',
        'In that order the turns of body and camera agree. Programs differ in where they put w.',
        'Put the columns in the order of their names.'),
    'body_angles_as_vectors': Phrase(
        'The {count} poses of the body contradict the images. Their rotation vectors rx,ry,rz '
        'seem to be roll, pitch and yaw.',
        'Taken as such angles, the turns of body and camera agree.',
        'Convert roll, pitch and yaw to quaternions qw,qx,qy,qz.'),
    'body_clocks_apart': Phrase(
        'Body and camera turn alike where their clocks differ by {offset_s:.2f} s, and an offset '
        'is looked for over half a second.',
        'The poses were stamped by another clock than the images. A far offset is named, and not '
        'taken, since an even motion repeats itself.',
        'Set the clocks, or state the offset, camera minus robot: --mount-fact '
        'time_offset={offset_s:.2f}:0.2 (mount_facts of the nodes).'),
    'body_poses_shifted': Phrase(
        'The {count} poses of the body contradict the images. They seem to be those of the image '
        '{which}.',
        'Moved by one image, body and camera agree. A robot may report where it was, or a list '
        'may begin one image late.',
        'Pair each pose with its own image, and record it while the robot stands.'),
    'body_positions_mirrored': Phrase(
        'The turns of the {count} poses of the body agree with the images, and the positions do '
        'not: {how}.',
        'With that undone, they agree. A left-handed frame, or columns in another order, do this.',
        'Correct the positions, in right-handed axes like those of the turns.'),
    'body_only_turned': Phrase(
        'The body turned as the camera did, but it moved by no more than its poses err '
        '({moved_mm:.2g} mm, median).',
        'A body that turns about its own origin shows no scale, so that the place is open.',
        'Move the body while it turns.'),
    # while it is watched
    'mount_changed': Phrase(
        'The camera is turned on its robot: {changes:changes}.',
        'The newest keyframes and poses of the body contradict the mount in force. Roll, pitch '
        'and yaw are turns about the axes of the body: forward, left and up. The rate of false '
        'alarms is stated.',
        'Fasten the camera, and calibrate anew with the service `calibrate`.'),
    'window_without_body': Phrase(
        'Only {poses} of its keyframes have a pose of the body.',
        'The poses come late, leave gaps, or have another clock.',
        'Nothing, if it happens rarely; else look at the topic of the poses.'),
    'window_body_otherwise': Phrase(
        'The body moved otherwise than the camera ({share:percent} % of the steps).',
        'Wheels slip, or the clock of the poses has jumped.',
        'Nothing, if it happens rarely; else look at the topic of the poses.'),
    # what a mount lacks
    'height_open': Phrase(
        'Turns about the vertical alone leave the height of the camera open.',
        'On a level floor the camera moves alike, however high it sits.',
        'State the height with its sigma, or tilt the body.'),
    'place_open_in_plane': Phrase(
        'The robot must turn while it drives to show where the camera sits.',
        'On a straight way every point of the robot moves alike.',
        'Drive curves of a few tens of degrees to both sides, or turn on the spot.'),
    'place_open': Phrase(
        'The body must turn about two axes that are not parallel to show where the camera sits.',
        'What lies along the one axis of rotation moves alike.',
        'Tilt the body about a second axis, by 20 degrees or more.'),
    'angles_open_in_plane': Phrase(
        'The robot must drive straight parts and curves to show how the camera looks.',
        'Straight parts show pitch and yaw; the axis of the curves shows pitch and roll.',
        'Drive on, straight and in curves.'),
    'angles_open': Phrase(
        'The body must turn about two axes that are not parallel, or move along two directions.',
        'A single axis or direction leaves the angle about it open.',
        'Turn about a second axis, by 20 degrees or more.'),
    'turn_within_errors': Phrase(
        'The poses err by as much as the robot turned, so that up and down look alike.',
        'The sense of the turns tells which side of the way is up. Straight parts show the rest.',
        'Drive curves of a few tens of degrees, or state the roll with its sigma.'),
    'open_on_a_circle': Phrase(
        'The robot must drive straight parts, or curves of another radius: one circle leaves this '
        'open.',
        'On one circle the place along it, the yaw, the scale and the clock make up for each '
        'other.',
        'Drive an S: curves to both sides, with a straight part between.'),
    'metric_scale_open': Phrase(
        'The body must move farther than its poses err to show the scale.',
        'Images know no metre. The way of the body gives it.',
        'Move farther, or give better poses.'),
    'time_offset_open': Phrase(
        'The body must turn or change its speed while images are taken to show the offset of '
        'the clocks.',
        'A pose that hardly changes is the same a moment later.',
        'Record quicker motion, or state the offset.'),
    # what to know of a mount
    'body_poses_set_aside': Phrase(
        '{count} of {of} poses of the body {count:contradicts|contradict} the others and '
        '{count:was|were} set aside.',
        'Wheels slip, and a pose may be of another moment. The estimate goes without them.',
        'Nothing; many of them mean wrong stamps or frames.'),
    'poses_pull_camera': Phrase(
        'The poses of the body would change the camera by more than three sigmas. It stays as the '
        'images have it, and the mount may be off by more than its sigmas.',
        'Poses that err in common do that: an arm whose joints have offsets, a path that was '
        'smoothed. Images that mislead do it, too.',
        'Calibrate the arm, or take poses from another source. Compare the camera with that of '
        'another recording.'),
    'body_poses_partly': Phrase(
        '{found} of {images} images have a pose of the body, and the mount rests on these.',
        'The poses stop midway, begin late, or leave gaps.',
        'Look whether what publishes the poses stopped, and record them as long as the images.'),
    'odometry_begun_anew': Phrase(
        'The odometry jumps {count} {count:time|times}, and what lies between jumps was joined.',
        'It began anew, or its frame was moved. The way on each side is as it was, and across a '
        'jump the robot is taken to go on as just before.',
        'Nothing, where it was reset; else look at what publishes it.'),
    'body_places_late': Phrase(
        'Places of the body are {late_ms:.1f} ms behind its turns (sigma {sigma_ms:.1f} ms).',
        'A filter delays what it smooths, and a gyro is quicker than cameras or wheels. The '
        'estimate allows for it. The offset of the clocks is that of the turns, and its sigma '
        'covers both.',
        'Stamp places and turns alike, or take poses before they are smoothed.'),
    'metres_differ_a_little': Phrase(
        'A metre of the known object is {scale:measured} m of the poses.',
        'One of them is a little off. The place of the camera is in metres of the object, and its '
        'sigmas hold the difference.',
        'Measure the object again, or state the scale of the poses.'),
    'mount_far_off': Phrase(
        'The camera would sit {distance_m:.3g} m from {body}, which is far for a robot.',
        'Images do not tell metres from millimetres: lengths are as the poses state them.',
        'If positions are in millimetres, state --robot-unit 0.001 (robot_unit of the nodes).'),
    'mount_upside_down': Phrase(
        'By these poses the camera hangs upside down on {body} (roll {roll_deg:.0f}°). If it '
        'stands upright, they are mirrored or inverse: turns to the left must be positive.',
        'Odometry that counts turns clockwise, y to the right, or inverse poses make an upright '
        'camera look like that.',
        'If the camera stands upright, correct the odometry: x forward, y to the left, turns '
        'counter-clockwise.'),
    'metre_of_odometry': Phrase(
        'Lengths are in metres of the odometry: the scale of its wheels is taken as it is.',
        'Nothing else here knows the metre. Wheels wear, and tyres are softer or harder.',
        'State the known scale of the odometry with a sigma.'),
}
