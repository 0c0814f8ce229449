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
"""Parameters: one table, bounded, read-only where said, and a wrong value is a sentence."""

from dataclasses import fields, FrozenInstanceError
import signal
import sys

import pytest
from rclpy.node import Node
from rclpy.parameter import Parameter

from selfcal_ros.errors import ArgumentError
from selfcal_ros.nodes.entry_point import run_nodes
from selfcal_ros.nodes.interfaces import INTERFACES
from selfcal_ros.nodes.parameter_declaration import declare, follow
from selfcal_ros.nodes.parameters import (BagPlayerParameters, FeatureTrackerParameters,
                                          RorapidTrackerParameters)
from selfcal_ros.nodes.parameters_table import PARAMETERS, parameters_table


@pytest.mark.parametrize('name', sorted(PARAMETERS))
def test_defaults_are_declared_described_and_read_only_where_the_table_says_so(graph, name):
    table = PARAMETERS[name]
    node = graph().add(Node('some_node'))
    values = declare(node, table)
    assert values == table()
    with pytest.raises(FrozenInstanceError):
        values.anything = 1
    rows = {row.split('`')[1]: row.split(' | ') for row in
            parameters_table(name).splitlines()[2:]}
    assert list(rows) == [entry.name for entry in fields(table)]
    for entry in fields(table):
        descriptor = node.describe_parameter(entry.name)
        assert descriptor.description
        result = node.set_parameters([Parameter(entry.name, value=entry.default)])[0]
        assert result.successful != descriptor.read_only
        assert rows[entry.name][3] == ('no' if descriptor.read_only else 'yes')


def test_changes_are_whole_checked_and_told(graph):
    node = graph().add(Node('some_node'))
    node.parameters = declare(node, RorapidTrackerParameters)
    told = []

    def check(new):
        if new.search_least_px > new.search_most_px:
            raise ArgumentError('search_least_px must not exceed search_most_px.')

    follow(node, check, lambda new, old: told.append((new, old)))
    before = node.parameters

    def attempt(**values):
        return node.set_parameters_atomically([Parameter(name, value=value)
                                               for name, value in values.items()])

    assert attempt(search_least_px=30.0).reason.endswith('exceed search_most_px.')
    assert 'one of auto' in attempt(image_transport='smoke', silence_s=2.0).reason
    assert 'must be of type bool' in attempt(texture=3).reason
    assert not attempt(search_most_px=1e9).successful
    assert not attempt(least_contrast=float('nan')).successful
    assert not attempt(model='other.cao', silence_s=2.0).successful
    assert node.parameters is before and not told
    # an integer stands for a real number; both at once do not contradict each other
    assert attempt(search_least_px=30, search_most_px=40).successful
    assert node.parameters.search_least_px == 30.0 and told == [(node.parameters, before)]
    assert isinstance(node.parameters.search_least_px, float)
    # nothing new is nothing to tell, and parameters of others are not ours
    node.declare_parameter('of_another', 1)
    assert attempt(search_least_px=30.0, of_another=2).successful and len(told) == 1


def test_an_integer_stands_for_a_real_number(graph):
    node = graph('-p', 'rate:=2').add(Node('some_node'))
    rate = declare(node, BagPlayerParameters).rate
    assert rate == 2.0 and isinstance(rate, float)


@pytest.mark.parametrize('given, name', [
    ('rate:=-1.0', 'rate'), ('rate:=.nan', 'rate'), ('loop:=3', 'loop'), ('rate:=fast', 'rate'),
    ('start_offset:=true', 'start_offset'), ('bag:=5', 'bag')])
def test_a_wrong_value_is_refused_in_a_sentence(graph, given, name):
    node = graph('-p', given).add(Node('some_node'))
    with pytest.raises(ArgumentError, match=f'parameter {name} must be'):
        declare(node, BagPlayerParameters)


def test_a_name_that_nobody_knows_is_told_with_the_nearest(graph, monkeypatch):
    said = []
    # those of others pass: parameters on one command line hold for all nodes of a process
    node = graph('-p', 'max_feature:=300', '-p', 'search_most_px:=30.0', '-p',
                 'use_sim_time:=false', '-p', 'zzz:=1').add(Node('some_node'))
    monkeypatch.setattr(type(node.get_logger()), 'warning', lambda self, text: said.append(text))
    declare(node, FeatureTrackerParameters)
    assert said == ["there is no parameter 'max_feature' here, so it has no effect; did you mean "
                    "max_features?", "there is no parameter 'zzz' here, so it has no effect"]


@pytest.mark.parametrize('name', [*sorted(PARAMETERS), 'all_nodes'])
def test_help_tells_what_a_node_has(name, monkeypatch, capsys):
    monkeypatch.setattr(sys, 'argv', [f'/bin/{name}', '--help'])
    before = [signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)]
    try:
        assert run_nodes(lambda: pytest.fail('no node is to start')) == 0
    finally:
        for number, handler in zip((signal.SIGINT, signal.SIGTERM), before):
            signal.signal(number, handler)
    said = capsys.readouterr().out
    assert said.startswith(f'usage: {name} ')
    for words in ([] if name == 'all_nodes' else [
            *PARAMETERS[name].__dataclass_fields__, *(e.name for e in INTERFACES[name])]):
        assert words in said


def test_a_fault_in_a_change_is_told_and_costs_no_node(graph, monkeypatch):
    graph = graph()
    node = graph.add(Node('some_node'))
    node.parameters = declare(node, RorapidTrackerParameters)
    said = []
    monkeypatch.setattr(type(node.get_logger()), 'error', lambda self, text: said.append(text))

    def check(new):
        if new.silence_s > 50:
            raise KeyError('unforeseen')

    def apply(new, old):
        raise ZeroDivisionError('unforeseen, too')

    follow(node, check, apply)
    refused, = graph.set_parameters('some_node', silence_s=100.0)
    assert "The change failed (KeyError: 'unforeseen'); please report" in refused
    assert node.parameters.silence_s == 5.0
    assert graph.set_parameters('some_node', silence_s=10.0) == ['']
    assert 'ZeroDivisionError: unforeseen, too' in said[-1] and 'Traceback' in said[-2]
    assert node.parameters.silence_s == 10.0
