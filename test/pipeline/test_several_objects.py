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
"""Several objects in the same images: each is followed as if it were alone."""

from functools import lru_cache

import cv2
import numpy as np
import pytest

from selfcal_ros.cli.main import main
from selfcal_ros.errors import ArgumentError
from selfcal_ros.pipeline.several_objects import object_names, parted_starts, several
from selfcal_ros.pipeline.sources import open_source
from selfcal_ros.pipeline.tracking_run import Target, track_objects
from selfcal_ros.report.camera_yaml import write_camera_yaml
from selfcal_ros.report.poses_csv import read_poses
from selfcal_ros.rorapid.model import write_model
from selfcal_ros.synthetic.objects import perturbed, pose_errors
from selfcal_ros.synthetic.several_objects import objects_beside

SHAPES, VIEWS = ('cube', 'l_block', 'step_block'), 8


@lru_cache(maxsize=None)
def scene():
    made = objects_beside(SHAPES, VIEWS, supersampling=2, seed=9)
    return made.objects, made.frames()


@pytest.fixture
def folder(tmp_path):
    folder = tmp_path / 'images'
    folder.mkdir()
    for k, image in enumerate(scene()[1]):
        cv2.imwrite(str(folder / f'{k:03d}.png'), image)
    return folder


def guesses():
    return [perturbed(one.rotations[0], one.translations[0], np.random.default_rng(k), 0.03, 0.002)
            for k, one in enumerate(scene()[0])]


def worst(poses, one):
    angle, share = pose_errors(poses['rotation'], poses['translation'], one.rotations,
                               one.translations)
    return np.rad2deg(np.nanmax(angle)), np.nanmax(share)


@pytest.mark.long
def test_each_of_three_is_followed_as_if_it_were_alone(folder):
    made, _ = scene()
    targets = [Target(one.model, start) for one, start in zip(made, guesses())]
    together, alone = [], []
    with open_source(folder) as source:
        runs = track_objects(source, targets, made[0].camera,
                             listeners=[lambda _, tracked: together.append(tracked)])
        for target in targets:
            track_objects(source, [target], made[0].camera,
                          listeners=[lambda _, tracked: alone.append(tracked[0])])
    assert all(run.followed and run.images == VIEWS for run in runs)
    for k, one in enumerate(made):
        for view in range(VIEWS):
            frame = together[view][k]
            # the sums of several are taken in another order
            assert np.allclose(frame.rotation, alone[k * VIEWS + view].rotation, 0, 1e-8)
            angle, share = pose_errors(frame.rotation, frame.translation, one.rotations[view],
                                       one.translations[view])
            assert np.rad2deg(angle) < 0.8 and share < 0.01


@pytest.mark.long
def test_the_command_line_writes_a_table_for_each_and_one_video(folder, tmp_path, capsys):
    made, _ = scene()
    write_camera_yaml(tmp_path / 'camera.yaml', made[0].camera, 'camera')
    models = ','.join(str(write_model(one.model, tmp_path / f'{shape}.yaml'))
                      for one, shape in zip(made, SHAPES))
    starts = '; '.join(' '.join(f'{x:.6f}' for x in (*t, *cv2.Rodrigues(R)[0].ravel()))
                       for R, t in guesses())
    command = ['track', str(folder), '--model', models, '--camera', str(tmp_path / 'camera.yaml'),
               '--init', starts, '--output', str(tmp_path / 'poses.csv'),
               '--overlay', str(tmp_path / 'overlay.avi')]
    assert main(command) == 0
    told = capsys.readouterr().out
    for shape, one in zip(SHAPES, made):
        assert f'{shape}: Tracked in {VIEWS} of {VIEWS} images' in told
        angle, share = worst(read_poses(tmp_path / f'poses_{shape}.csv'), one)
        assert angle < 0.8 and share < 0.01
    assert not (tmp_path / 'poses.csv').exists()
    assert int(cv2.VideoCapture(str(tmp_path / 'overlay.avi')).get(
        cv2.CAP_PROP_FRAME_COUNT)) == VIEWS
    command[command.index('--init') + 1] = starts.partition(';')[0]
    assert main(command) == 2
    assert '--init has 1 pose for 3 objects;' in capsys.readouterr().err
    command[command.index('--init') + 1] = starts
    assert main([*command, '--clicks', '1', '2']) == 2
    assert '--clicks are of one object' in capsys.readouterr().err


@pytest.mark.parametrize('paths, names', (
    (['a/cube.cao', 'b/cube.yaml', 'cube.obj'], ['cube', 'cube_2', 'cube_3']),
    (['my part-7.stl', '7.ply', 'ü.obj'], ['my_part_7', 'object_7', 'object'])))
def test_names_are_those_of_topics_and_no_two_alike(paths, names):
    assert object_names(paths) == names


def test_lists_are_parted_and_a_file_with_a_comma_is_one(tmp_path):
    odd = tmp_path / 'a,b.cao'
    odd.touch()
    assert several(str(odd)) == [str(odd)] and several('a.cao, b.cao') == ['a.cao', 'b.cao']
    with pytest.raises(ArgumentError, match='empty place'):
        several('a.cao,,b.cao')
    assert parted_starts('1; 2 ;', 3) == ['1', '2', ''] and parted_starts(' a;b ', 1) == ['a;b']
    with pytest.raises(ArgumentError, match='2 poses for 3 objects'):
        parted_starts('1;2', 3)


@pytest.mark.long
def test_objects_are_sought_where_no_start_is_known(folder, tmp_path, capsys):
    made, _ = scene()
    write_camera_yaml(tmp_path / 'camera.yaml', made[0].camera, 'camera')
    model = write_model(made[1].model, tmp_path / 'bracket.yaml')
    command = ['track', str(folder), '--model', str(model), '--camera',
               str(tmp_path / 'camera.yaml'), '--output', str(tmp_path / 'poses.csv'),
               '--init', 'auto']
    main(command)
    poses = read_poses(tmp_path / 'poses.csv')
    angle, _ = pose_errors(poses['rotation'], poses['translation'], made[1].rotations,
                           made[1].translations)
    assert not (np.rad2deg(angle[np.isfinite(poses['focal_px'])]) > 2).any()
    capsys.readouterr()
    assert main([*command, '--method', 'rapid']) == 2
    assert '--method modern' in capsys.readouterr().err
    assert main(command[:-2]) == 2
    assert '--init auto' in capsys.readouterr().err
