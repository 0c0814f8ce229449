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
"""Findings: one shape, each kind with words, a place in the code and an entry in the documents."""

import ast
from functools import cache
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
import pickle
import re
from string import Formatter

import numpy as np
import pytest
from selfcal_ros.calibration.result import NotCalibrated
from selfcal_ros.calibration.uncertainty.experiment_design import best_motion, Suggestion
from selfcal_ros.calibration.uncertainty.focal_course import course_findings, FocalCourse
from selfcal_ros.findings.closed_forms import CLOSED_FORMS
from selfcal_ros.findings.finding import Finding, KINDS, sentences
from selfcal_ros.findings.mounting import MOUNTING
from selfcal_ros.findings.phrase import MOTIONS, put_in_words
from selfcal_ros.findings.refusals import REFUSALS
from selfcal_ros.findings.remarks import REMARKS
from selfcal_ros.geometry.no_estimate import NoEstimate
from test_support.syntax_trees import trees_in

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = ROOT / 'selfcal_ros'
MAX_WORDS = 25
#: Written by nobody: what reads files of other versions makes it.
FROM_FILES = {'note'}


@cache
def _trees():
    return {path: tree for path, tree in trees_in(PACKAGE).items()
            if PACKAGE / 'findings' not in path.parents}


def _made():
    """Yield the place of every finding that is made, its kind, and the names of its values."""
    for path, tree in _trees().items():
        for node in ast.walk(tree):
            if isinstance(node, ast.Call) and getattr(node.func, 'id', '') in ('Finding',
                                                                               'NoEstimate'):
                kind = node.args[0] if node.args else None
                yield (f'{path.relative_to(ROOT)}:{node.lineno}',
                       kind.value if isinstance(kind, ast.Constant) else None,
                       {keyword.arg for keyword in node.keywords}, len(node.args))


def test_what_was_found_in_one_of_several_cameras_says_in_which():
    found = Finding('positions_contradictory', positions=180).of_camera('left')
    assert found.sentence == ('left: 180 positions that contradict the epipolar geometry were '
                              'dropped.')
    assert Finding.from_dict(found.as_dict()) == found and found.values['positions'] == 180


def _fields(text):
    return {name for _, name, _, _ in Formatter().parse(text) if name}


def test_the_tables_share_no_kind():
    assert len(KINDS) == sum(map(len, (REFUSALS, MOUNTING, CLOSED_FORMS, REMARKS)))


def test_what_is_made_has_words_and_all_the_values_that_they_name():
    made = list(_made())
    assert len(made) > 80
    for place, kind, values, count in made:
        assert count == 1, f'{place}: a kind, and values by name'
        if kind is None:
            continue
        assert kind in KINDS, f'{place}: {kind} has no words'
        if None not in values:
            missing = _fields(KINDS[kind].sentence + KINDS[kind].advice) - values
            assert not missing, f'{place}: the words of {kind} also name {missing}'


def test_every_kind_is_made_somewhere():
    names = {node.value for tree in _trees().values() for node in ast.walk(tree)
             if isinstance(node, ast.Constant) and isinstance(node.value, str)}
    assert not set(KINDS) - FROM_FILES - names
    assert not set(MOTIONS) - names


def _sentences(text):
    return re.split(r'(?<=[.!?]) (?=[A-Z])', re.sub(r'\{\w+(:[^}]*)?\}', 'value', text))


@pytest.mark.parametrize('kind', sorted(KINDS))
def test_every_phrase_is_short_and_says_what_to_do(kind):
    phrase = KINDS[kind]
    assert phrase.means and phrase.advice
    for text in (phrase.sentence, phrase.means, phrase.advice):
        for sentence in _sentences(text):
            assert len(sentence.split()) <= MAX_WORDS, f'{len(sentence.split())}: {sentence}'
        assert text.endswith(('.', '}')), text


def test_the_page_of_troubleshooting_is_made_from_the_tables():
    spec = spec_from_file_location('make_troubleshooting', ROOT / 'docs/make_troubleshooting.py')
    module = module_from_spec(spec)
    spec.loader.exec_module(module)
    written = (ROOT / 'docs' / 'troubleshooting.md').read_text(encoding='utf-8')
    assert written == module.page(), 'run: python docs/make_troubleshooting.py'
    assert sorted(re.findall(r'^### `(\w+)`$', written, re.M)) == sorted(KINDS)


def _prose(tree):
    """Yield prose in the code, but for docstrings and for what is raised."""
    told = {id(part) for node in ast.walk(tree) if isinstance(node, ast.Raise)
            or isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)
            for part in ast.walk(node)}
    for node in ast.walk(tree):
        if isinstance(node, ast.Constant) and isinstance(node.value, str) \
                and id(node) not in told and len(re.findall(r'[a-z]+ ', node.value)) >= 5:
            yield node.lineno, node.value


@pytest.mark.parametrize('room', ['geometry', 'calibration', 'features'])
def test_no_refusal_or_remark_has_its_words_elsewhere(room):
    found = [f'{path.relative_to(ROOT)}:{line}: {text}' for path, tree in _trees().items()
             if PACKAGE / room in path.parents for line, text in _prose(tree)]
    assert not found


def test_a_not_calibrated_comes_from_a_refusal():
    """But for those that are read from a file."""
    direct = [path for path, tree in _trees().items() for node in ast.walk(tree)
              if isinstance(node, ast.Call) and getattr(node.func, 'id', '') == 'NotCalibrated']
    assert {path.name for path in direct} == {'result.py', 'result_json.py'} and len(direct) == 2


def test_a_kind_without_words_is_an_error():
    with pytest.raises(ValueError, match='give it words'):
        Finding('of_tomorrow')


def test_a_finding_survives_a_process_and_a_dict():
    found = NoEstimate('no_usable_view', why=NoEstimate('view_too_few', frame=3, points=2))
    assert not found
    assert found.reason == ('No view can be used: frame 3 has 2 points, where at least 4 of a '
                            'plane or 6 of a solid are needed.')
    again = pickle.loads(pickle.dumps(found))
    assert again == found and not again and again.reason == found.reason
    assert Finding.from_dict(found.as_dict()).sentence == found.sentence
    assert found != NoEstimate('no_usable_view', why=NoEstimate('view_on_line', frame=3))


def test_the_front_tells_kind_values_and_further_findings_apart():
    more = Finding('motion_suggestion', images=12, motion='s_20', sigma={'fx': 1.5, 'cx': 20.0})
    refusal = NoEstimate('no_rotation').saying(status={'fx': 'unobservable'}, further=(more,),
                                               motion='translation')
    result = NotCalibrated.of(refusal, frames=[1, 2], software='test')
    assert not result and result.kind == 'no_rotation' and result.values == {}
    assert (result.motion, result.frames, result.status) == ('translation', (1, 2),
                                                             {'fx': 'unobservable'})
    assert result.advice.endswith('12 more images in which you drive an S, 20 degrees to the left '
                                  'and to the right would bring fx to ± 1.5, cx to ± 20 (from '
                                  'the Fisher information).')
    assert str(result) == f'Not calibrated: {result.reason} {result.advice}'


def test_no_sigma_is_promised_of_a_camera_that_is_open():
    best = Suggestion('s_45', {'fx': 0.0084, 'fy': 0.0084}, 0.1)
    known, needed = (best_motion([best], ('fx', 'fy'), is_open)[0] for is_open in (False, True))
    assert '± 0.0084' in known.sentence
    assert needed.sentence.endswith('would determine fx and fy.') and '±' not in needed.sentence


@pytest.mark.parametrize('kind, values, said', [
    ('static_matches', {'matches': 1}, 'Up to 1 match a pair stays still in the image while'),
    ('static_matches', {'matches': 7}, 'Up to 7 matches a pair stay still in the image while'),
    ('still_tracks', {'tracks': 1, 'share': 0.02},
     '1 track (2 % of the positions) stands still in the image all the time while others move, '
     'and was set aside.'),
    ('positions_contradictory', {'positions': 1},
     '1 position that contradicts the epipolar geometry was dropped.'),
    ('positions_contradictory', {'positions': 77},
     '77 positions that contradict the epipolar geometry were dropped.'),
    ('body_poses_set_aside', {'count': 1, 'of': 22},
     '1 of 22 poses of the body contradicts the others and was set aside.'),
    ('window_few_points', {'points': 1}, 'Only 1 point is seen in several keyframes.')])
def test_a_single_thing_is_spoken_of_as_one(kind, values, said):
    assert put_in_words(KINDS[kind].sentence, values).startswith(said)


@pytest.mark.parametrize('text, values, said', [
    ('{a:percent} %', {'a': 0.354}, '35 %'),
    ('{n} group{n:plural}', {'n': 1}, '1 group'),
    ('{n} group{n:plural}', {'n': 2}, '2 groups'),
    ('{share:.1%} of it', {'share': 0.0184}, '1.8 % of it'),
    ('{share:.0%} of it', {'share': None}, 'unknown of it'),
    ('{n} {n:match|matches}', {'n': 1}, '1 match'),
    ('{n} {n:match|matches}', {'n': 2}, '2 matches'),
    ('{n} {n:match|matches}', {'n': 0}, '0 matches'),
    ('{n:number}', {'n': 3}, 'three'),
    ('{r:times} times', {'r': 1.02}, '1.02 times'),
    ('{r:times} times', {'r': 1.05}, '1.1 times'),
    ('{r:times} times', {'r': 2.44}, '2.4 times'),
    ('{a}', {'a': ('fx', 'aspect_ratio')}, 'fx, aspect ratio'),
    ('{a:and}', {'a': ('skew', 'aspect_ratio')}, 'skew and aspect ratio'),
    ('about {a:axes}', {'a': ('x', 'y')}, 'about the x axis and about the y axis'),
    ('turn{a:or_state}', {'a': ()}, 'turn'),
    ('turn{a:or_state}', {'a': ('skew', 'aspect ratio')},
     'turn, or state the skew or the aspect ratio'),
    ('{f:frames}', {'f': (4,)}, 'frame 4'),
    ('{f:frames}', {'f': (1, 2, 3, 4, 5, 6)}, 'frames 1, 2, 3, 4, 5 and others'),
    ('{x:later}', {'x': {'share': -0.012, 'interval_s': None}},
     '1.2 % of the time between two instants earlier'),
    ('{x:later}', {'x': {'share': 0.012, 'interval_s': 0.25}}, '3 ms later'),
    ('{x:measured}', {'x': {'value': 2.0, 'sigma': 0.012}}, '2.000 ± 0.012'),
    ('{x:changes}', {'x': ({'name': 'cx', 'value': 2.0, 'sigma': 0.5, 'unit': 'px'},)},
     'cx +2.00 ± 0.50 px'),
    ('{x:.2g}', {'x': None}, 'unknown')])
def test_values_are_put_into_words(text, values, said):
    assert put_in_words(text, values) == said


def test_a_focal_length_that_shrinks_is_not_said_to_grow():
    course = FocalCourse(np.arange(3), np.array([520.0, 517.0, 514.0]), np.ones(3), True)
    said, = sentences(course_findings(course))
    assert 'from 520.00 to 514.00 px' in said and 'grew' not in said
