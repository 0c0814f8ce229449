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
Builders of ROS messages, one interface over rclpy's classes and those of rosbags.

`types.CameraInfo(width=640, ...)` builds a message of whichever kind `types` stands for. Fields
that are not given are zero. Every value is cast to the type that the message definition names and
checked against its range and length, because rclpy does neither: an int in a float64 field, or a
3x3 array where nine numbers are due, arrives at the other end as garbage without any error.
"""

from __future__ import annotations

from array import array
from collections.abc import Callable
from importlib import import_module
import math
import re
from typing import Any, TypeAlias

import numpy as np

from selfcal_ros.errors import ArgumentError, InputError

#: Package of every message that the adapters build.
PACKAGES = {
    'builtin_interfaces': ('Duration', 'Time'),
    'std_msgs': ('ColorRGBA', 'Header', 'String'),
    'sensor_msgs': ('CameraInfo', 'CompressedImage', 'Image', 'PointCloud2', 'PointField',
                    'RegionOfInterest'),
    'geometry_msgs': ('Point', 'Pose', 'PoseStamped', 'PoseWithCovariance',
                      'PoseWithCovarianceStamped', 'Quaternion', 'Transform', 'TransformStamped',
                      'Vector3'),
    'nav_msgs': ('Path',),
    'diagnostic_msgs': ('DiagnosticArray', 'DiagnosticStatus', 'KeyValue'),
    'visualization_msgs': ('Marker', 'MarkerArray'),
    'rosgraph_msgs': ('Clock',),
}
_PACKAGE_OF = {name: package for package, names in PACKAGES.items() for name in names}
_INTEGERS = {f'{sign}int{bits}': (-(1 << bits - 1) if not sign else 0,
                                  (1 << (bits if sign else bits - 1)) - 1)
             for sign in ('u', '') for bits in (8, 16, 32, 64)}
# the other spellings of one type in rclpy's and rosbags' descriptions
_SPELLING = {'double': 'float64', 'float': 'float32', 'boolean': 'bool', 'octet': 'byte'}
_FIELD = re.compile(r'^(?:sequence<([^,>]+)(?:, *\d+)?>|([^\[]+)\[(\d+)\]|(.+))$')

#: A message of rclpy or of rosbags; only its fields count.
Message: TypeAlias = Any
Builder: TypeAlias = Callable[..., Message]
#: None for a single value, 'sequence', or the length of an array.
Shape: TypeAlias = int | str | None
#: Type of the elements of a field, and its shape.
Kind: TypeAlias = tuple[str, Shape]


class MessageTypes:
    """
    Builds messages by attribute: `types.Image(height=480, ...)`.

    Make one with `rclpy_types` or `rosbags_types`.
    """

    def __getattr__(self, name: str) -> Builder:
        """Return the builder of the message type of that name."""
        if name not in _PACKAGE_OF:
            raise AttributeError(f'no builder for the message type {name!r}')
        builder = self._builder(_PACKAGE_OF[name], name)
        setattr(self, name, builder)
        return builder

    def _builder(self, package: str, name: str) -> Builder:
        spec = self._spec(package, name)

        def build(**fields: Any) -> Message:
            unknown = fields.keys() - spec.keys()
            if unknown:
                raise ArgumentError(f'{package}/{name} has no field {sorted(unknown)[0]!r}; it '
                                    f'has {", ".join(spec)}.')
            values = {key: self._cast(f'{name}.{key}', spec[key], value)
                      for key, value in fields.items()}
            return self._make(package, name, spec, values)

        build.__name__ = name
        build.__doc__ = f'Build {package}/{name} from the keywords {", ".join(spec)}.'
        return build

    def _cast(self, where: str, kind: Kind, value: Any) -> Any:
        """Cast a value to (element type, None | 'sequence' | length of an array)."""
        element, shape = kind
        if shape is None:
            return self._scalar(where, element, value)
        if element not in _INTEGERS and not element.startswith('float'):
            items = [self._scalar(where, element, item) for item in value]
            if shape != 'sequence' and len(items) != shape:
                raise ArgumentError(f'{where} takes {shape} values, not {len(items)}.')
            return items
        if isinstance(value, (bytes, bytearray, memoryview, array)):
            value = np.frombuffer(value, value.typecode if isinstance(value, array) else np.uint8)
        values = np.asarray(value)
        if values.size == 0:
            values = values.astype(element)
        if element in _INTEGERS:
            if values.dtype != element and (values.dtype.kind not in 'ui' or not (
                    _INTEGERS[element][0] <= values.min() and
                    values.max() <= _INTEGERS[element][1])):
                raise ArgumentError(f'{where} takes numbers of type {element}.')
        values = np.ascontiguousarray(values, dtype=element).ravel()
        if shape != 'sequence' and values.size != shape:
            raise ArgumentError(f'{where} takes {shape} values, not {values.size}.')
        return self._sequence(values, shape)

    def _scalar(self, where: str, element: str, value: Any) -> Any:
        """Cast one value."""
        if element in _INTEGERS:
            low, high = _INTEGERS[element]
            try:
                whole: int | None = int(value)
            except (TypeError, ValueError, OverflowError):
                whole = None
            if whole is None or whole != value or not low <= whole <= high:
                raise ArgumentError(f'{where} takes an integer from {low} to {high}, '
                                    f'not {value!r:.60}.')
            return whole
        if element.startswith('float'):
            number = float(value)
            if element == 'float32' and math.isfinite(number):
                with np.errstate(over='ignore'):
                    return float(np.float32(number))
            return number
        if element == 'bool':
            return bool(value)
        if element == 'byte':
            return self._byte(value[0] if isinstance(value, bytes) else int(value))
        if element in ('string', 'wstring'):
            return str(value)
        return value


class _RclpyTypes(MessageTypes):
    """Builds rclpy's messages."""

    def _class(self, package: str, name: str) -> Any:
        try:
            return getattr(import_module(f'{package}.msg'), name)
        except ImportError as error:
            raise InputError(f'The ROS messages of {package} are not installed ({error}); install '
                             'ros-jazzy-common-interfaces or source a ROS 2 installation.'
                             ) from None

    def _spec(self, package: str, name: str) -> dict[str, Kind]:
        spec: dict[str, Kind] = {}
        for field, text in self._class(package, name).get_fields_and_field_types().items():
            found = _FIELD.match(text)
            if found is None:
                raise InputError(f'The field {field} of {package}/{name} has the unknown type '
                                 f'{text}.')
            sequence, element, length, single = found.groups()
            base = (sequence or element or single).strip()
            base = 'string' if base.startswith('string<') else _SPELLING.get(base, base)
            spec[field] = (base, 'sequence' if sequence else int(length) if length else None)
        return spec

    def _make(self, package: str, name: str, spec: dict[str, Kind],
              values: dict[str, Any]) -> Message:
        return self._class(package, name)(**values)

    @staticmethod
    def _sequence(values: np.ndarray, shape: Shape) -> Any:
        if shape != 'sequence':
            return values
        # array.array is what rclpy keeps; any other type it converts element by element
        packed = array(values.dtype.char if values.dtype.itemsize < 8 or
                       values.dtype.kind == 'f' else 'qQ'[values.dtype.kind == 'u'])
        packed.frombytes(values.view(np.uint8).data)
        return packed

    @staticmethod
    def _byte(value: int) -> Any:
        return bytes([value])


class _RosbagsTypes(MessageTypes):
    """Builds the messages of a rosbags typestore."""

    def __init__(self, store: Any) -> None:
        self.store = store

    def _spec(self, package: str, name: str) -> dict[str, Kind]:
        full = f'{package}/msg/{name}'
        if full not in self.store.fielddefs:
            raise InputError(f'This typestore does not know the message type {full}.')
        spec: dict[str, Kind] = {}
        for field, (node, detail) in self.store.fielddefs[full][1]:
            length = None
            if node.name in ('ARRAY', 'SEQUENCE'):
                inner, length = detail
                length = 'sequence' if node.name == 'SEQUENCE' else length
                node, detail = inner
            base = detail[0] if node.name == 'BASE' else detail
            spec[field] = (_SPELLING.get(base, base), length)
        return spec

    def _make(self, package: str, name: str, spec: dict[str, Kind],
              values: dict[str, Any]) -> Message:
        for field, kind in spec.items():
            if field not in values:
                values[field] = self._zero(kind)
        return self.store.types[f'{package}/msg/{name}'](**values)

    def _zero(self, kind: Kind) -> Any:
        element, shape = kind
        plain = {'bool': False, 'byte': 0, 'string': '', 'wstring': ''}
        if element in _INTEGERS or element.startswith('float'):
            if shape is not None:
                return np.zeros(0 if isinstance(shape, str) else shape, element)
            return 0 if element in _INTEGERS else 0.0
        if shape is not None:
            return [self._zero((element, None)) for _ in range(
                0 if isinstance(shape, str) else shape)]
        if element in plain:
            return plain[element]
        package, _, name = element.split('/')
        message = self._make(package, name, self._spec(package, name), {})
        if name == 'Quaternion':
            message.w = 1.0   # as the message definition says, and as rclpy does
        return message

    @staticmethod
    def _sequence(values: np.ndarray, shape: Shape) -> Any:
        # a copy, so that the message does not change with its source
        return values.copy()

    @staticmethod
    def _byte(value: int) -> Any:
        return value


def rclpy_types() -> MessageTypes:
    """
    Return builders of rclpy's messages.

    A builder raises InputError where the ROS messages are not installed.
    """
    return _RclpyTypes()


def rosbags_types(store: Any = None) -> MessageTypes:
    """
    Return builders of the messages of a rosbags typestore.

    Parameters
    ----------
    store : rosbags.typesys.store.Typestore, optional
        ROS 2 Jazzy's by default.

    """
    if store is None:
        from rosbags.typesys import Stores, get_typestore
        store = get_typestore(Stores.ROS2_JAZZY)
    return _RosbagsTypes(store)
