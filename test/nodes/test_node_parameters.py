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
"""Parameters: one table, bounded, read-only, and a wrong value is a sentence."""

from dataclasses import FrozenInstanceError

import pytest
from rclpy.node import Node
from rclpy.parameter import Parameter

from selfcal_ros.errors import ArgumentError
from selfcal_ros.nodes.parameters import (AffineCalibratorParameters, BagPlayerParameters, declare,
                                          FeatureTrackerParameters, PlanarCalibratorParameters)


@pytest.mark.parametrize('table', [BagPlayerParameters, FeatureTrackerParameters,
                                   PlanarCalibratorParameters, AffineCalibratorParameters])
def test_defaults_are_declared_described_and_read_only(graph, table):
    node = graph().add(Node('some_node'))
    values = declare(node, table)
    assert values == table()
    with pytest.raises(FrozenInstanceError):
        values.anything = 1
    for name in table.__dataclass_fields__:
        descriptor = node.describe_parameter(name)
        assert descriptor.description and descriptor.read_only
        result = node.set_parameters([Parameter(name, value=getattr(values, name))])[0]
        assert not result.successful


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
