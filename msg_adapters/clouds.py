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
"""sensor_msgs/PointCloud2 to arrays and back: reading any cloud safely, writing structure."""

from __future__ import annotations

from msg_adapters.message_types import Message, MessageTypes
import numpy as np

from selfcal_ros.errors import ArgumentError, InputError

#: NumPy's type of each PointField datatype.
_DATATYPES = {1: 'i1', 2: 'u1', 3: 'i2', 4: 'u2', 5: 'i4', 6: 'u4', 7: 'f4', 8: 'f8'}
_CODES = {name: code for code, name in _DATATYPES.items()}


def cloud_message(records: np.ndarray, header: Message, types: MessageTypes,
                  is_dense: bool = True) -> Message:
    """
    Build an unordered PointCloud2 from a structured array.

    Parameters
    ----------
    records : structured ndarray, shape (N,)
        A field of the array becomes a field of the cloud.
    header : std_msgs/Header
    types : MessageTypes
    is_dense : bool
        Whether all values are finite.

    """
    records = np.ascontiguousarray(records)
    names = records.dtype.names or ()
    layout = np.dtype([(name, records.dtype[name].newbyteorder('<')) for name in names])
    offsets = {name: field[1] for name, field in (layout.fields or {}).items()}
    records = records.astype(layout)
    fields = [types.PointField(name=name, offset=offsets[name],
                               datatype=_CODES[layout[name].str[1:]], count=1)
              for name in names]
    data = np.frombuffer(records.tobytes(), np.uint8)
    return types.PointCloud2(header=header, height=1, width=len(records), fields=fields,
                             is_bigendian=False, point_step=layout.itemsize,
                             row_step=data.size, data=data, is_dense=is_dense)


def cloud_records(msg: Message, names: tuple[str, ...],
                  optional: tuple[str, ...] = ()) -> np.ndarray:
    """
    Read fields of a PointCloud2.

    Parameters
    ----------
    msg : sensor_msgs/PointCloud2
    names : tuple of str
        Fields that must be there.
    optional : tuple of str
        Fields that are read where they are there.

    Returns
    -------
    structured ndarray, shape (N,)
        With the datatypes of the message, in native byte order.

    Raises
    ------
    InputError
        If a field is missing or does not fit, or the data are too short.

    """
    fields = {}
    for field in msg.fields:
        if str(field.name) in names + optional:
            code, offset = int(field.datatype), int(field.offset)
            if code not in _DATATYPES or int(field.count) not in (0, 1):
                raise InputError(f'The field {field.name} of the point cloud has datatype {code} '
                                 f'and count {field.count}; expected one number.')
            fields[str(field.name)] = (_DATATYPES[code], offset)
    missing = [name for name in names if name not in fields]
    if missing:
        there = ', '.join(str(field.name)[:40] for field in list(msg.fields)[:20])
        raise InputError(f'The point cloud lacks the field {missing[0]}; it has '
                         f'{there or "none"}.')
    height, width = int(msg.height), int(msg.width)
    step, row_step = int(msg.point_step), int(msg.row_step)
    data = np.frombuffer(msg.data, np.uint8) if len(msg.data) else np.zeros(0, np.uint8)
    used = max(offset + np.dtype(kind).itemsize for kind, offset in fields.values())
    order = '>' if msg.is_bigendian else '<'
    if height * width == 0:
        return np.zeros(0, [(name, kind) for name, (kind, _) in fields.items()])
    whole = (height - 1) * row_step + width * step
    if step < used or row_step < width * step or data.size < whole:
        raise InputError(f'The point cloud of {width} x {height} points contradicts itself: '
                         f'point_step {step}, row_step {row_step}, {data.size} bytes of data.')
    layout = np.dtype({'names': list(fields), 'itemsize': step,
                       'formats': [order + kind for kind, _ in fields.values()],
                       'offsets': [offset for _, offset in fields.values()]})
    if row_step == width * step:
        records = data[:height * row_step].view(layout)
    else:
        records = np.concatenate([data[y * row_step:y * row_step + width * step].view(layout)
                                  for y in range(height)])
    return records.astype([(name, kind) for name, (kind, _) in fields.items()])


def structure_cloud(points: np.ndarray, header: Message, types: MessageTypes,
                    colours: np.ndarray | None = None) -> Message:
    """
    Build a PointCloud2 of reconstructed points, x y z [rgb] as float32.

    Parameters
    ----------
    points : ndarray, shape (P, 3) or (P, 4)
        Euclidean or homogeneous. Points at infinity and those that are not finite are left out.
    header : std_msgs/Header
    types : MessageTypes
    colours : ndarray of uint8, shape (P, 3), optional
        Red, green, blue; packed into one float as viewers expect.

    """
    points = np.asarray(points, float)
    if points.ndim != 2 or points.shape[1] not in (3, 4):
        raise ArgumentError(f'Points must be (P, 3) or (P, 4), not {points.shape}.')
    if points.shape[1] == 4:
        with np.errstate(divide='ignore', invalid='ignore', over='ignore'):
            points = points[:, :3] / points[:, 3:]
    # beyond this a float32 overflows, and no viewer shows it
    near = (np.abs(points) < 1e30).all(axis=1)
    kinds = [('x', 'f4'), ('y', 'f4'), ('z', 'f4')] + ([] if colours is None else [('rgb', 'f4')])
    records = np.zeros(int(near.sum()), kinds)
    for axis, name in enumerate('xyz'):
        records[name] = points[near, axis]
    if colours is not None:
        colours = np.asarray(colours)
        if colours.shape != (len(points), 3) or colours.dtype != np.uint8:
            raise ArgumentError(f'Colours must be uint8 of shape ({len(points)}, 3), not '
                                f'{colours.dtype} of {colours.shape}.')
        red, green, blue = colours[near].astype(np.uint32).T
        records['rgb'] = (red << 16 | green << 8 | blue).view(np.float32)
    return cloud_message(records, header, types)


def points_from_cloud(msg: Message) -> np.ndarray:
    """Return the points of a cloud, shape (P, 3); rows that are not finite are left out."""
    records = cloud_records(msg, ('x', 'y', 'z'))
    points = np.column_stack([records[name] for name in 'xyz']).astype(float)
    finite: np.ndarray = points[np.isfinite(points).all(axis=1)]
    return finite
