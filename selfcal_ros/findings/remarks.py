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
The words of every remark: what a user should know of a result or of the tracks behind it.

A remark is one sentence. Its advice stands in docs/troubleshooting.md only.
"""

from __future__ import annotations

from selfcal_ros.findings.phrase import Phrase

REMARKS: dict[str, Phrase] = {
    'note': Phrase(
        '{text}',
        'A sentence from an older result file, or from outside of the package.',
        'Read it.'),
    'path_torn': Phrase(
        'The path may be two parts of different scale, at frame {frame}: {kept_percent:.0f} '
        '% of the tracks that pass it are explained.',
        'Both parts agree in the camera, so that it stands. The path, the structure, and where '
        'the camera sits on a robot may be wrong.',
        'Record slower there, so that more of the scene stays in view; or leave one part out.'),
    # errors that are shared
    'errors_within_track': Phrase(
        'Errors are shared within a track, as when its patch drifts: sigmas are {ratio:times} '
        'times those of independent errors for it.',
        'Errors that observations share do not average out. The sigmas allow for it.',
        'Sharper images and distinct corners drift less.'),
    'errors_within_region': Phrase(
        'Errors are shared within a region of the image, as with a lens unlike its distortion '
        'model: sigmas are {ratio:times} times as wide.',
        'Errors that observations share do not average out. The sigmas allow for it.',
        'Try a richer distortion model.'),
    'errors_within_segment': Phrase(
        'Errors are shared within a segment of images, as with jolts, moving objects or a '
        'rolling shutter: sigmas are {ratio:times} times as wide.',
        'Errors that observations share do not average out. The sigmas allow for it.',
        'Record a calmer drive, or a scene where nothing moves.'),
    'points_ahead_counted': Phrase(
        'The images alone would give fx = {images_fx:measured}, with {share:.0%} of the points '
        'behind the camera; that all lie before it counts.',
        'The camera moved little beside its rotations. A longer focal length explains its images '
        'about as well, with all points farther away, beyond infinity at last.',
        'Move the camera by more beside its rotations, before near objects.'),
    'errors_at_object_points': Phrase(
        'Errors are shared at the same points of the object in every view, as when its '
        'coordinates are wrong: sigmas are {ratio:times} times as wide.',
        'Errors that observations share do not average out. The sigmas allow for it.',
        'Measure the object anew, or use a flatter board.'),
    'errors_within_edge': Phrase(
        'Errors are shared by the edgels of one edge, as when the model is wrong or light moves '
        'it: sigmas are {ratio:times} times as wide.',
        'Errors that observations share do not average out. The sigmas allow for it.',
        'Check the proportions of the model; light the object evenly.'),
    'lens_deviates': Phrase(
        'The lens deviates from the distortion model by {rms_px:.2g} px (root mean square over '
        'the observations); the calibration and its sigmas allow for it.',
        'The residuals change smoothly over the image. A field of corrections was estimated with '
        'the camera.',
        'Try a richer distortion model.'),
    'lens_may_be_prism': Phrase(
        'The lens is decentred by {decentring:.1e}, more than most. Images hardly tell that from '
        'a thin prism, and the sigmas allow for one.',
        'p1 and p2 are far from zero, and certain. A tilted sensor or lens element may act as a '
        'prism, which the lens models of ROS lack; the principal point takes part of it.',
        'Nothing; a calibration of single rays (a board, many views) tells more.'),
    'fisheye_decentred': Phrase(
        'The fisheye is decentred by {decentring:.1e}, for which its model has no coefficients. '
        'The sigmas allow for it.',
        'Its lens elements are not on one axis. ROS has no such coefficients beside k1 to k4; '
        'the principal point takes part of it.',
        'Nothing; near the rim the image may be off by a pixel.'),
    'regions_beyond_lens': Phrase(
        'Beyond this deviation of the lens, errors shared within regions of the image make the '
        'sigmas {ratio:times} times as wide.',
        'Errors that observations share do not average out. The sigmas allow for it.',
        'Try a richer distortion model.'),
    # the focal length
    'focal_drifts': Phrase(
        'The focal length changed steadily from {first_px:.2f} to {last_px:.2f} px '
        '({fraction:.2%}): fx is its mean, and every image has its own.',
        'The images contradict a constant focal length beyond four sigmas. Cameras that warm up '
        'drift so.',
        'Record after the camera has warmed up, with the focus locked; or take the focal length '
        'of each image.'),
    'focal_varies': Phrase(
        'The focal length varied between {lowest_px:.2f} and {highest_px:.2f} px '
        '({fraction:.2%}): fx is its mean, and every image has its own.',
        'The images contradict a constant focal length beyond four sigmas. Zoom and autofocus '
        'do that.',
        'Lock zoom and focus where one calibration is to hold; or take the focal length of each '
        'image.'),
    # the motion
    'lever_not_excluded': Phrase(
        'The camera may turn about a point beside it, {share:.2%} of the depth away. The sigmas '
        'allow for it.',
        'Such a turn looks like one about the camera itself, with another focal length. The '
        'points are too alike in depth, or too few, to tell the two apart.',
        'Record something near as well, turn farther, or move the camera. Of a head that is known '
        'to be exact say --motion rotation --trust-facts.'),
    'not_exactly_rotation': Phrase(
        'The camera turned about a point beside it, which was estimated too.',
        'The images contradict a rotation about the centre of the camera beyond four sigmas. A '
        'pan-tilt head has such a lever, and so has a wrist.',
        'Nothing; say --trust-facts only of a head that is known to be exact.'),
    'circular_motion': Phrase(
        'The camera circles one axis; the calibration rests on square pixels.',
        'Circular motion leaves two directions of the parameters open. Facts close them.',
        'Leave the circle, for example in an S.'),
    'not_exactly_planar': Phrase(
        'The motion is not exactly planar: {tilt_deg:.2f} degrees out of the plane (root mean '
        'square), which was estimated too.',
        'The vehicle rolls and pitches a little. Each view has a tilt of its own.',
        'Nothing; drive on even ground for smaller sigmas.'),
    'frames_turned_estimated': Phrase(
        'The frames that were said to be related by translation turned by up to {turned_deg:.2g} '
        'degrees, which was estimated too.',
        'The images contradict the statement, by less than would matter.',
        'Nothing; state it only of frames that kept their orientation.'),
    'frames_said_translated': Phrase(
        'Frames {frames} were said to be translated.',
        'The calibration rests on this statement.',
        'Nothing.'),
    'frames_said_absent': Phrase(
        'Of the frames that were said to be translated, {absent:frames} had no part.',
        'They are not among the images that are used, or there are no such images.',
        'Check their numbers, which begin with 0; take more images with --max-keyframes.'),
    'objects_as_views': Phrase(
        'Every object counts as a view: the path is where the camera would stand before one '
        'object.',
        'The calibration rests on the objects being equal.',
        'Nothing.'),
    'translation_groups': Phrase(
        '{groups} group{groups:plural} of translated views ({sizes} of {views} views).',
        'The views of a group have one orientation. The closed form starts from the first group.',
        'Nothing.'),
    'tracks_moving': Phrase(
        '{share:percent} % of the tracks move by themselves: they belong to {bodies:number} '
        'moving thing{bodies:plural} and have no part in the calibration.',
        'Tracks that the still scene does not explain fit a rigid motion of their own. They are '
        'labelled, and no outliers.',
        'Nothing; where most of the image moves, record another scene.'),
    'tracks_jump': Phrase(
        '{share:percent} % of the tracks jump from one point of the scene to another, as on a '
        'repeated pattern; both parts are used.',
        'Such a track is two points that stand still. Tiles, racks and bricks look alike.',
        'Nothing; where many jump, avoid the pattern or track in smaller steps.'),
    'tracks_unexplained_whole': Phrase(
        '{share:percent} % of the tracks contradict the still scene as a whole and fit no other '
        'rigid motion; they were left out.',
        'They may be people, leaves, shadows, reflections, or wrong matches.',
        'Record a scene where less moves.'),
    'motion_suggestion': Phrase(
        '{images} more images in which you {motion:motion} would bring {sigma:sigmas} (from the '
        'Fisher information).',
        'The motion was simulated with this camera, this noise and these depths.',
        'Drive or turn so, and calibrate from all images.'),
    'motion_needed': Phrase(
        '{images} more images in which you {motion:motion} would determine {names:and}.',
        'The motion was simulated with this noise and these depths. How well it would do is not '
        'said: the camera is not known yet.',
        'Drive or turn so, and calibrate from all images.'),
    'pairs_degenerate': Phrase(
        '{left_out} of {pairs} image pairs were degenerate and left out.',
        'Pairs without parallax or rotation say nothing of the fixed points.',
        'Nothing.'),
    'camera_changed': Phrase(
        'The camera has changed: {changes:changes}.',
        'The newest keyframes contradict the calibration in force. The rate of false alarms is '
        'stated.',
        'Calibrate anew with the service `calibrate`, or look for what moved the lens.'),
    # the shutter
    'rolling_shutter': Phrase(
        'The {lines} are read one after the other, the whole image in {readout_ms:measured} ms; '
        'this was estimated too.',
        'A rolling shutter. The camera moves on while an image is read, which bends it. Negative: '
        'the lowest row, or the rightmost column, is read first. Columns are read where the image '
        'was turned upright since. See [Rolling shutter](shutter.md).',
        'Nothing; give the line delay to whatever uses the images of the moving camera.'),
    'rolling_shutter_unstamped': Phrase(
        'The {lines} are read one after the other, the whole image in {readout:measured} '
        'intervals between frames; this was estimated too.',
        'A rolling shutter, and frames without stamps: what the interval is in seconds is not '
        'known. See [Rolling shutter](shutter.md).',
        'Multiply by the time between frames.'),
    'rolling_shutter_stated': Phrase(
        'The {lines} are read one after the other, {line_delay_us:.3g} µs apart, as stated.',
        'The statement was taken for exact. See [Rolling shutter](shutter.md).',
        'Nothing.'),
    'rolling_shutter_suspected': Phrase(
        'The images look as if lines were read one after the other, but the views are too far '
        'apart in time to estimate it.',
        'A rolling shutter would explain the residuals. How fast the camera moved at each view '
        'does not follow from views so far apart.',
        'Give more images a second, or the whole video; or move slowly.'),
    'object_moves_in_rows': Phrase(
        'The object moved while each image was read, by {shift_px:.2g} px (root mean square): the '
        '{lines} are read one after the other.',
        'A rolling shutter bends what moves. The motion of every view is estimated, and the '
        'sigmas allow for it.',
        'Hold object and camera still for each image: the sigmas become smaller.'),
    'rows_by_view': Phrase(
        'Lines were read one after the other, and every view moved meanwhile in its own way, some '
        '{share:.1%} of its motion to the next view.',
        'A rolling shutter explains the residuals. Views so far apart in time do not tell how the '
        'camera moved while one was read. The sigmas allow for any such motion.',
        'Give more images a second, or the whole video; or move slowly.'),
    'images_shifted': Phrase(
        'Every image was shifted by itself, by {shift_px:.2g} px (root mean square), as by a '
        'stabiliser.',
        'The principal point differs from image to image. What is given is the mean, and its '
        'sigma holds what one image is off by.',
        'Switch the stabilisation off, and record again. See [Stabilised '
        'cameras](stabilised.md).'),
    'line_delay_open': Phrase(
        'The images do not determine how fast the {lines} are read: the whole image in '
        '{readout:measured} intervals between frames.',
        'The camera moved too slowly, or so that a rolling shutter looks like another camera.',
        'Turn faster, and turn the camera by 90 degrees about its axis for a part of the images.'),
    # what the uncertainty means
    'parameters_unobservable': Phrase(
        'The data do not determine {missing}: state it as a fact, or record a motion that shows '
        'it.',
        'The sigmas of these parameters exceed the limits beyond which a parameter counts as '
        'unobservable.',
        'State the parameter as a fact, or record a motion that shows it.'),
    'coefficients_open': Phrase(
        'The images do not tell {missing:and} apart from the other coefficients of the lens.',
        'Several sets of coefficients bend the image alike. What they do together is known where '
        'the images reach, and its covariance is in the result.',
        'Nothing, where all coefficients are used together. Else name a lens with fewer '
        '(--lens).'),
    'field_of_view': Phrase(
        'The horizontal field of view is {angle_deg:measured} degrees.',
        'It follows from the camera and its covariance.',
        'Nothing.'),
    'central_angle': Phrase(
        'An angle of {angle_deg:.3g} degrees measured across the middle of the image is good to ± '
        '{sigma_deg:.2g} degrees.',
        'It follows from the covariance of the camera.',
        'Nothing.'),
    'typical_measurements': Phrase(
        'In the structure, two typical lengths (between the tracks {first:and}, {second:and}) '
        'have the ratio {ratio:measured}. An angle of {angle_deg:.3g} degrees (at track {at}) is '
        'good to ± {sigma_deg:.2g} degrees.',
        'It follows from the covariance of the camera, the path and the points together.',
        'Nothing.'),
    # facts
    'fact_decides': Phrase(
        'Without the stated {fact}, the images would not determine {lost}.',
        'These parameters rest on the fact. If it is wrong, they are.',
        'Check the fact, or move so that the images tell.'),
    'fact_narrows': Phrase(
        'Without the stated {fact}, the sigma of {name} would be {factor:.2g} times as large.',
        'Most of what is known of the parameter comes from the fact.',
        'Check the fact.'),
    'fact_contradicted_too': Phrase(
        'The images contradict the stated {fact}, too: they prefer {preferred:preferred}.',
        'Released, the fact comes out elsewhere, beyond chance.',
        'Check the fact.'),
    'fact_doubtful': Phrase(
        'The images contradict the stated {fact}: they prefer {preferred:preferred}. The sigmas '
        'allow for the difference.',
        'Released, the fact comes out elsewhere, beyond chance, but the camera moves little.',
        'Check the fact, or state it with a sigma.'),
    'fact_unsure': Phrase(
        'The images lean a little from the stated {fact}: they prefer {preferred:preferred}. That '
        'may be chance, and the sigmas allow for it.',
        'Where the fact is right, chance makes such a difference in 3 of 100 calibrations.',
        'Check the fact, or state it with a sigma.'),
    'fact_unchecked': Phrase(
        'The camera rests on the stated {fact}, and the images cannot check it. An error of '
        '{error:.2g} in {unknown} would not show, and move {name} by {change:.2g} px, '
        '{sigmas:.0f} of its sigmas. The sigmas hold only if the fact is exact; stated with a '
        'sigma, it goes into them.',
        'The motion leaves the fact open. Most sensors have square pixels within 0.001, but '
        'images that were resized or rectified need not.',
        'State the fact with a sigma, or move so that the images tell.'),
    'fact_open': Phrase(
        'The images leave the stated {fact} open: an error of {error:.2g} px in {unknown} would '
        'not show. The sigmas hold only if the fact is exact.',
        'The motion does not show it. Most sensors have no skew, but a principal point is rarely '
        'known so well.',
        'If the fact is not certain, state it with a sigma.'),
    'images_rectified': Phrase(
        'No point is distorted by more than {share:.2%}, so the images seem to be rectified. '
        'Rectified pixels are often not square, by some percent, and the images cannot check it.',
        'One of 24 measured lenses distorts so little. What OpenCV rectifies without black '
        'borders is stretched.',
        'Calibrate from the raw images; or state fy / fx of P of their CameraInfo as '
        '--aspect-ratio.'),
    'fact_trusted': Phrase(
        'The images contradict the stated {fact}: they prefer {preferred:preferred}. It was '
        'declared exact, and the calibration keeps to it.',
        'Released, the fact comes out elsewhere, beyond chance.',
        'Check the fact.'),
    'other_camera_left_out': Phrase(
        'The images are of two cameras: the calibration is that of {used:frames}, and '
        '{left_out:frames} were left out.',
        'Two values of focal length and principal point, one a group of images, explain nearly '
        'all that the images differ by. The frames are all in the result file.',
        'Calibrate the images of each camera by themselves; check that none was cropped, scaled '
        'or zoomed.'),
    'turning_left_out': Phrase(
        'Frames in which the camera turns on the spot were left out: {left_out:frames}.',
        'Such frames show hardly any depth, and an estimate with them is off by more than its '
        'sigmas say, or fails.',
        'Nothing is wrong with the result. Move while you turn, if you record again.'),
    'views_unconnected': Phrase(
        'The result rests on {used} of {views} views: the others share too few tracks with them.',
        'Views are joined by tracks that several of them see. Those that too few tracks join with '
        'the largest group are not used.',
        'Record with more overlap, or more images a second.'),
    # known objects
    'points_of_no_object': Phrase(
        '{count} observation{count:plural} of points that the object does not have '
        '{count:was|were} left out.',
        'The tracks have point numbers that are not in the file of object points.',
        'Check the file of object points.'),
    'views_left_out': Phrase(
        '{count} view{count:plural} {count:was|were} left out: {why:clause}.',
        'These views show too few points. The reason of the first is given.',
        'Show more of the object in these views.'),
    'board_bent': Phrase(
        'The board is not flat: it bends by {bend_mm:measured} mm, which is estimated with the '
        'camera.',
        'The images contradict a flat board. Its bend is a surface of second degree; the unit of '
        'the object is taken for a metre. Supposed flat, a board that bends by a fifth of a '
        'percent of its length moves the focal length by as much.',
        'Nothing is wrong with the result. A stiffer board gives smaller sigmas.'),
    'board_flat': Phrase(
        'The images show no bend of the board: {limit_mm:.2g} mm would have shown.',
        'The board was free to bend in the estimate, and is flat as far as the images tell.',
        'Nothing.'),
    'board_print_off': Phrase(
        'The pattern of the board is longer along than across by {stretch_percent:measured} %, '
        'and leans by {lean_deg:measured} degrees, which was estimated too.',
        'Printers feed paper by their own measure, and screens have pixels that are not square. '
        'Supposed exact, such a pattern moves the camera.',
        'Nothing is wrong with the result. Measure the pattern both ways, and state its points.'),
    'object_misfits_frames': Phrase(
        'The object does not fit what was seen of it in {frames:frames}, left out.',
        'After the adjustment too few points of these views agree with the rest.',
        'Look at these images: the object may have moved, or points were confused.'),
    'object_seen': Phrase(
        'The object was found anew in {views} of {images} images.',
        'In the others it was not found, or had not moved.',
        'Nothing.'),
    'object_not_found': Phrase(
        'It was not found in {count} image{count:plural}: {names:names}.',
        'The object is cut off, blurred, overexposed, too small or too oblique there, or is not '
        'in the image. The result file names all of these images.',
        'Look at these images. Where the object shows whole, more light and a steadier hand '
        'help.'),
    'stated_centre_outside': Phrase(
        'The stated principal point ({cx:g}, {cy:g}) lies outside of the images of '
        '{width}x{height}: they may be of another size than it is of.',
        'Only a window of a larger sensor has its principal point outside.',
        'State it in pixels of these images, or leave it open.'),
    'frames_differ': Phrase(
        'The images name different frames, such as {first!r} and {second!r}: two cameras on one '
        'topic are no single one.',
        'Every message names the frame of its camera. Two publishers may use one topic.',
        'Remap one of the cameras to a topic of its own; nothing, where a driver was renamed.'),
    'stamps_disordered': Phrase(
        '{count} image{count:plural} {count:has|have} no later stamp than the one before: what '
        'needs time, as the poses of a robot do, may be wrong.',
        'Recordings that were joined, a clock that was set, or a driver that stamps nothing.',
        'Split the recording where the stamps jump back, or mend the driver.'),
    'one_coding_taken': Phrase(
        'The images are those of {taken}: {other} holds the same ones in another coding.',
        'The raw images are taken, unless many of them are missing.',
        'Nothing; or name the topic with `--topic`.'),
    'compressed_taken': Phrase(
        'The images are those of {taken}: {asked} itself was not recorded.',
        'They are the same images, with the losses of JPEG where that is their coding.',
        'Nothing.'),
    'images_damaged': Phrase(
        'Damaged and left out: {count} image{count:plural}, the first is {first}. {why}.',
        'A truncated image decodes with a grey rest, in which wrong points would be found.',
        'Nothing, if they are few. If they are many, look at the disk and the transport.'),
    'video_ends_early': Phrase(
        'The video ends after {frames} of {announced} frames: what follows cannot be decoded.',
        'It was cut off or is damaged; its header tells of all frames.',
        'Copy it anew, or record again: the rest would make the camera surer.'),
    'images_interlaced': Phrase(
        'Interlaced: {count} image{count:plural}. Their odd rows are of another instant, and only '
        'the even ones were used.',
        'An analogue camera sends odd and even rows one after the other, and the camera moved '
        'between them.',
        'Nothing. A camera with a progressive scan tells more in so many images.'),
    'images_turned': Phrase(
        'Programs turn {count} image{count:plural} by a flag, which is not applied here: the '
        'camera is that of the images as stored, {width} x {height}.',
        'Phones write upright images as the sensor has them, with a flag (in photographs the '
        'orientation of EXIF). One calibration then holds however the phone is held.',
        'Read images without the flag, too: with OpenCV cv2.IMREAD_IGNORE_ORIENTATION, of videos '
        'cv2.CAP_PROP_ORIENTATION_AUTO = 0. Or turn the files for good, and calibrate those.'),
    'image_size_not_stated': Phrase(
        'The size of the images is not stated, so the smallest that holds all points is taken: '
        'state it with --image-size.',
        'A table of tracks does not tell the size, and drivers refuse a calibration of another '
        'one.',
        'Give --image-size W H.'),
    'points_outside': Phrase(
        '{share:percent} % of the points lie outside of images of {width} x {height}: their size '
        'may be stated wrongly.',
        'A table of tracks does not tell the size, and sigmas are too small with a wrong one.',
        'Check --image-size; x and y count from the middle of the top left pixel.'),
    'image_size_doubtful': Phrase(
        'No point lies beyond x = {right:.0f} and y = {bottom:.0f} of images of {width} x '
        '{height}: their size may be stated wrongly.',
        'A table of tracks does not tell the size. Points fill most of an image, and drivers '
        'refuse a calibration of another size.',
        'Check --image-size.'),
    'views_used': Phrase(
        '{views} of these views were used.',
        'More would cost time and tell little.',
        'Nothing.'),
    'object_followed': Phrase(
        'The object was followed in {tracked} of {images} images; its edges were measured in '
        '{measured} of them.',
        'Images in which the tracker was unsure are not used.',
        'Nothing.'),
    # features
    'image_circle': Phrase(
        'The image is a circle of radius {radius_px:.0f} px about ({x_px:.0f}, {y_px:.0f}); what '
        'lies beyond is not used.',
        'A fisheye lens draws a circle. Nothing beyond its rim belongs to the scene.',
        'Nothing; a mask of your own narrows it further.'),
    'few_images': Phrase(
        '{images} images only: matched as photographs.',
        'With so few images corners are not followed from one to the next.',
        'Nothing.'),
    'mode_chosen': Phrase(
        'Corners followed between the first frames: {followed:percent} %, moving by {step:.1%} '
        'of the image diagonal: {mode} mode.',
        'Video mode follows corners from frame to frame. Wide mode matches descriptors.',
        'Name the other mode if the choice is wrong.'),
    'frames_far_apart': Phrase(
        'Hardly any corners could be followed between the first frames: matched as photographs.',
        'Wide mode matches descriptors. Images of a video that are out of order look like this, '
        'too.',
        'Nothing if they are photographs; else name the files in their order.'),
    'frames_thinned': Phrase(
        '{frames} of the frames were used, evenly spaced.',
        'More images than are needed were given.',
        'Nothing.'),
    'positions_surplus': Phrase(
        '{used} of {positions} positions were used, about as many in every image.',
        'More positions would not tell the camera better than its lens follows the model. They '
        'would take time and memory.',
        'Nothing.'),
    'division_model': Phrase(
        'Matches were verified along curved epipolar lines, for a lens bend of '
        '{distortion:.2g}.',
        'The lens bends epipolar lines visibly. Matches were verified with a rough model of it, '
        'the division model; the bend is its coefficient.',
        'Nothing.'),
    'static_matches': Phrase(
        'Up to {matches} {matches:match|matches} a pair {matches:stays|stay} still in the image '
        'while the scene moves (dirt, the robot), without a vote on the geometry.',
        'What moves with the camera says nothing of the scene. Neither does the background of a '
        'turntable.',
        'Clean the lens, or keep the robot out of the image.'),
    'still_tracks': Phrase(
        '{tracks} track{tracks:plural} ({share:percent} % of the positions) {tracks:stands|stand} '
        'still in the image all the time while others move, and {tracks:was|were} set aside.',
        "They move with the camera, as a robot's body or a reflection does. Or a fixed camera "
        'sees them beside a thing that moves. Either way they say nothing of the motion that '
        'calibrates.',
        'Nothing; a mask cuts such parts out exactly.'),
    'fixed_camera': Phrase(
        '{tracks} track{tracks:plural} ({share:percent} % of the positions) stood still all over: '
        'the camera was taken as fixed, and calibrated from what moves before it.',
        'A camera that moves sees no point of a still scene stay where it is all the time. What '
        'moves as one rigid body before a fixed camera calibrates it as well.',
        'Let the thing that moves fill more of the image. If the camera did move, mask what moves '
        'with it.'),
    'fixed_camera_features': Phrase(
        '{features} feature{features:plural} an image ({share:percent} %) stood still all the '
        'time: the camera '
        'was taken as fixed, and calibrated from what moves before it.',
        'Photographs by a camera that moves show no point of a still scene at the same place. '
        'What moves as one rigid body before a fixed camera calibrates it as well.',
        'Let the thing that moves fill more of the image. If the camera did move, mask what moves '
        'with it.'),
    'too_fast_to_follow': Phrase(
        'The camera stood, and what moves before it moves too fast to be followed: matched as '
        'photographs.',
        'Most of the image stands still, and so looks like a video. The rest does not.',
        'Nothing; smaller steps give more points.'),
    'static_tracks': Phrase(
        'Dropped: {tracks} track{tracks:plural} that stood still in the image while the scene '
        "moved (dirt, the robot's body).",
        'What moves with the camera says nothing of the scene. Neither does the background of a '
        'turntable.',
        'Clean the lens, or keep the robot out of the image.'),
    'static_region': Phrase(
        'The image stands still in x {left_px:.0f} to {right_px:.0f}, y {top_px:.0f} to '
        "{bottom_px:.0f}, as a robot's body does; {positions} position{positions:plural} in it "
        '{positions:was|were} dropped.',
        'Most tracks there stay where they are, or shake about a place. A body that shines, or '
        'slides along the scene, would mislead.',
        'Nothing; a mask cuts the part out exactly.'),
    'tracks_contradictory': Phrase(
        'Dropped as contradictory: {tracks} track{tracks:plural}.',
        'Chains of matches came back to the same image at another place.',
        'Nothing; many of them mean a repeated pattern.'),
    'positions_unregistered': Phrase(
        '{dropped} of {positions} positions could not be registered to sub-pixel accuracy and '
        '{dropped:was|were} dropped.',
        'The patches look too different, or blurred.',
        'Nothing; sharper images lose fewer.'),
    'positions_contradictory': Phrase(
        '{positions} position{positions:plural} that {positions:contradicts|contradict} the '
        'epipolar geometry {positions:was|were} dropped.',
        'They are wrong matches, or things that move.',
        'Nothing; many of them mean that the scene moves.'),
    'keyframes_chosen': Phrase(
        '{keyframes} keyframes chosen by parallax out of {frames} frames.',
        'Neighbouring frames of a video tell the same.',
        'Nothing.'),
    # long recordings
    'segments_followed': Phrase(
        'Of {images} images, {followed} in {count} segment{count:plural} were followed, which '
        'say most of the camera: {when}.',
        'A long recording is looked through first: turns, parallax and coverage decide. See '
        '[long recordings](how-to/long-recordings.md).',
        'Nothing; `--every 1` follows every image, `--start` and `--duration` choose by hand.'),
    'segments_joint': Phrase(
        'Camera and sigmas are of {segments} segments together, which scatter by {scatter:.1f} of '
        'their sigmas; path and structure are of that at {start_s:.0f} s.',
        'Every segment was calibrated by itself, and weighted by its information.',
        'Nothing.'),
    # many recordings
    'recordings_asked_again': Phrase(
        '{again} of {recordings} recordings chose another distortion model than {model}; for the '
        'joint estimate they were calibrated with that one.',
        'Calibrations with different distortion models cannot be combined.',
        'State the distortion model.'),
    'recordings_alike': Phrase(
        '{copy} holds the same as {of}, and counts once.',
        'Their results are equal to the last digit. Counted twice, they would halve the variance.',
        'Give each recording once.'),
    # cameras that move together
    'rig_metres_differ': Phrase(
        'A metre by the stated baseline is {scale:measured} m by the robot.',
        'One of them is wrong. The rig is in metres of the baseline, the mount in those of the '
        'robot.',
        'Measure the baseline again, from lens to lens, or leave it out: the robot gives it.'),
    'rig_overlap': Phrase(
        '{points} scene points were seen by more than one camera.',
        'What two cameras see at once ties them to each other.',
        'Nothing; the more such points, the better.'),
    'rig_no_overlap': Phrase(
        'No scene point was seen by two cameras: how they sit to each other follows from their '
        'paths.',
        'Each camera tells how the rig moved. The poses that make all tell the same are found.',
        'Drive curves both ways, and over a ramp if the height between the cameras matters.'),
    'rig_height_open': Phrase(
        'How high the camera {camera} sits over the others is open, and with it its {names:and}. '
        'Motion over a ramp, or things that two cameras see at once, would show it.',
        'Motion in a plane looks alike however high a camera rides.',
        'Drive over a ramp, tilt the rig, or let two cameras see the same things.'),
    'rig_circle_open': Phrase(
        'Where on its circle the camera {camera} rides is open, and with it its {names:and}. '
        'Curves of different radius with straight stretches between them would show it.',
        'On one circle a camera sees the same from everywhere.',
        'Drive curves of different radius, or let two cameras see the same things.'),
    'rig_pose_open': Phrase(
        'Of the pose of the camera {camera} the motion leaves open: {names:and}. Turns about two '
        'different axes, with ways between them, would show it.',
        'Where the rig hardly turns, a camera may sit anywhere on it.',
        'Turn the rig about two axes while it moves, or let two cameras see the same things.'),
    'rig_clocks_differ': Phrase(
        'The images of {camera} were taken {apart:later} than those of {first}; the sigmas allow '
        'for it.',
        'A camera that is late sees the rig where it is later.',
        'Trigger the cameras together, or correct their stamps.'),
    'images_halved': Phrase(
        'Each image was taken for two, its {first} and its {second} half.',
        'Stereo cameras put both views beside each other into one image.',
        'Nothing; of images of one camera give the topic or the folder of each camera.'),
    'rig_own_clock': Phrase(
        'The camera {camera} is not triggered with {first}: their images are {apart_ms:.3g} ms '
        'apart (median). Positions were moved along their tracks to the instants of {first}.',
        'Between the images of a video a track moves smoothly.',
        'Nothing, where the stamps of both cameras are right; else trigger them together.'),
    'rig_pose_changed': Phrase(
        'The pose of {camera} to {first} changed before frame {frame}. What is given lies between '
        'both poses, and the sigmas allow for either.',
        'A mount was knocked or bends; errors that the images share may look alike.',
        'Check the mounts, and calibrate from the images before or after it.'),
    'rig_baseline_exact': Phrase(
        'The baseline is taken as exactly {baseline_m:g} m. Sigmas of places hold no error of it: '
        'state how well it was measured, as in --baseline {baseline_m:g}:0.001.',
        'A length without a sigma is held as it is.',
        'State a sigma beside the length.'),
    'rig_baseline_of_no_use': Phrase(
        'The stated baseline gives no scale: the motion leaves open how far {camera} is from the '
        'first camera.',
        'A length gives the scale where the images know it as a share of the path.',
        'Record curves both ways, or let both cameras see the same things.'),
}
