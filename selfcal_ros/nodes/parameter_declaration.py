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
"""Declares parameters on a node, checks what is given, and lets those change that may."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import Field, fields, is_dataclass, replace
from difflib import get_close_matches
import math
import traceback
from typing import Any, TYPE_CHECKING, TypeVar

from rcl_interfaces.msg import (FloatingPointRange, IntegerRange, ParameterDescriptor,
                                SetParametersResult)
from rclpy.exceptions import InvalidParameterValueException
from rclpy.node import Node
from rclpy.parameter import Parameter

from selfcal_ros.errors import ArgumentError, SelfcalError
from selfcal_ros.nodes import parameters
from selfcal_ros.nodes.parameter_words import in_parameters

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

Table = TypeVar('Table', bound='DataclassInstance')

#: Parameters that every node of ROS has, or that come with its topics.
_OF_ROS = ('use_sim_time', 'qos_overrides.', 'start_type_description_service')


def declare(node: Node, table: type[Table]) -> Table:
    """
    Declare the parameters of a dataclass on a node and read their values; see `follow`.

    Parameters
    ----------
    node : rclpy.node.Node
    table : type
        Dataclass whose fields were made with `parameter`.

    Returns
    -------
    table
        An instance with the values in force.

    Raises
    ------
    ArgumentError
        If a value has the wrong type or is out of range; the sentence names the parameter.

    """
    values: dict[str, Any] = {}
    for entry in fields(table):
        try:
            given = node.declare_parameter(entry.name, entry.default, _descriptor(entry)).value
        except InvalidParameterValueException:
            # rclpy has looked at the range before us
            raise ArgumentError(f'The parameter {entry.name} must be {_bounds(entry)}.') from None
        values[entry.name] = _checked(entry, given)
    _tell_of_unknown(node, list(values))
    return table(**values)


def _tell_of_unknown(node: Node, names: list[str]) -> None:
    """
    Warn of what was given under a name that none of our nodes knows.

    It is no error: launch files give parameters to all nodes at once (`/**`), and other nodes may
    know it.
    """
    known = {name for kind in vars(parameters).values() if is_dataclass(kind)
             for name in kind.__dataclass_fields__}
    # rclpy has no other way to ask what was given
    for given in getattr(node, '_parameter_overrides', ()):
        if given in known or given.startswith(_OF_ROS) or node.has_parameter(given):
            continue
        near = get_close_matches(given, names, 1, 0.7)
        node.get_logger().warning(f'there is no parameter {given!r:.60} here, so it has no effect'
                                  + (f'; did you mean {near[0]}?' if near else ''))


def follow(node: Any, check: Callable[[Any], object],
           apply: Callable[[Any, Any], object]) -> None:
    """
    Let the parameters of a node that may change do so, each change whole or not at all.

    The callbacks run in the executor that spins the node, between its other callbacks. From then
    on `node.parameters` is always what is in force.

    Parameters
    ----------
    node : rclpy.node.Node
        With the values from `declare` as its attribute `parameters`.
    check : callable
        Called as check(new) before a change; it raises an ArgumentError or InputError where
        values contradict each other, and changes nothing.
    apply : callable
        Called as apply(new, old) once the change is certain, after `node.parameters` is new.

    """
    entries = {entry.name: entry for entry in fields(node.parameters)}

    def changed(given: Iterable[Parameter]) -> Any:
        # others' parameters pass by: use_sim_time, qos_overrides
        return replace(node.parameters, **{one.name: _checked(entries[one.name], one.value)
                                           for one in given if one.name in entries})

    def judge(given: list[Parameter]) -> SetParametersResult:
        try:
            new = changed(given)
            if new != node.parameters:
                check(new)
        except SelfcalError as error:
            return SetParametersResult(successful=False, reason=in_parameters(str(error)))
        except Exception as error:  # a node must not die of what somebody asks for
            return SetParametersResult(successful=False, reason=_fault(node, error))
        return SetParametersResult(successful=True)

    def take(given: list[Parameter]) -> None:
        old, node.parameters = node.parameters, changed(given)
        if node.parameters != old:
            try:
                apply(node.parameters, old)
            except Exception as error:  # as above
                node.get_logger().error(_fault(node, error))

    node.add_on_set_parameters_callback(judge)
    node.add_post_set_parameters_callback(take)


def _fault(node: Node, error: Exception) -> str:
    """Log where the program is at fault, and say so."""
    node.get_logger().error(''.join(traceback.format_exception(error)))
    return (f'The change failed ({type(error).__name__}: {error}); please report the lines that '
            'are logged.')


def _descriptor(entry: Field[Any]) -> ParameterDescriptor:
    """Describe a field; the type is ours to check, so that a YAML 20 may stand for 20.0."""
    about = entry.metadata
    descriptor = ParameterDescriptor(description=about['description'],
                                     read_only=not about['live'], dynamic_typing=True)
    if about['one_of']:
        descriptor.additional_constraints = 'one of ' + ', '.join(about['one_of'])
    low, high = about['low'], about['high']
    if low is not None or high is not None:
        if isinstance(entry.default, float):
            descriptor.additional_constraints = f'from {low} to {high}'
            descriptor.floating_point_range = [FloatingPointRange(
                from_value=float(-math.inf if low is None else low),
                to_value=float(math.inf if high is None else high), step=0.0)]
        else:
            descriptor.integer_range = [IntegerRange(
                from_value=int(-2 ** 63 if low is None else low),
                to_value=int(2 ** 63 - 1 if high is None else high), step=0)]
    return descriptor


def _checked(entry: Field[Any], value: Any) -> Any:
    """Return the value in the type of its default."""
    wanted, about = type(entry.default), entry.metadata
    if wanted is float and isinstance(value, int) and not isinstance(value, bool):
        value = float(value)
    if type(value) is not wanted:
        raise ArgumentError(f'The parameter {entry.name} must be of type {wanted.__name__}, '
                            f'not {value!r}.')
    if about['one_of'] and value not in about['one_of']:
        raise ArgumentError(f'The parameter {entry.name} must be one of '
                            f'{", ".join(about["one_of"])}, not {value!r}.')
    low, high = about['low'], about['high']
    # written so that NaN fails
    if (low is not None and not value >= low) or (high is not None and not value <= high):
        raise ArgumentError(f'The parameter {entry.name} must be {_bounds(entry)}, '
                            f'not {value!r}.')
    return value


def _bounds(entry: Field[Any]) -> str:
    """Say between what a number must lie."""
    low, high = entry.metadata['low'], entry.metadata['high']
    if None in (low, high):
        return f'at least {low}' if high is None else f'at most {high}'
    return f'from {low} to {high}'
