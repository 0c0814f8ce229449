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
"""Whether a result is as docs/result.schema.json says."""

import re

import numpy as np

TYPES = {'object': dict, 'array': list, 'string': str, 'integer': int, 'number': (int, float),
         'null': type(None), 'boolean': bool}


def problems(value, schema, place='result'):
    """List what contradicts a schema, of the keywords that ours uses."""
    unknown = schema.keys() - {
        '$schema', '$id', 'title', 'description', 'type', 'properties', 'required', 'items',
        'enum', 'additionalProperties', 'const', 'pattern', 'minItems', 'minimum'}
    assert not unknown, unknown
    found = []
    if 'const' in schema and value != schema['const']:
        found.append(f'{place} is {value!r}, not {schema["const"]!r}')
    if 'enum' in schema and value not in schema['enum']:
        found.append(f'{place} is {value!r}, none of {schema["enum"]}')
    names = schema.get('type', list(TYPES))
    names = [names] if isinstance(names, str) else names
    fits = ('boolean' in names if isinstance(value, bool) else
            any(isinstance(value, TYPES[name]) for name in names))
    if not fits:
        return [*found, f'{place} is {value!r}, not of type {names}']
    if isinstance(value, str) and not re.search(schema.get('pattern', ''), value):
        found.append(f'{place} is {value!r}, not like {schema["pattern"]}')
    if isinstance(value, (int, float)) and value < schema.get('minimum', -np.inf):
        found.append(f'{place} is {value!r}, too small')
    if isinstance(value, list):
        if len(value) < schema.get('minItems', 0):
            found.append(f'{place} is empty')
        for k, item in enumerate(value):
            found += problems(item, schema.get('items', {}), f'{place}[{k}]')
    if isinstance(value, dict):
        found += [f'{place} lacks {name}' for name in schema.get('required', ())
                  if name not in value]
        for name, item in value.items():
            other = schema.get('properties', {}).get(name,
                                                     schema.get('additionalProperties', True))
            if other is False:
                found.append(f'{place} has {name}')
            elif other is not True:
                found += problems(item, other, f'{place}.{name}')
    return found
