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
"""What a running node has, and what is written of it."""

from selfcal_ros.nodes.interfaces import INTERFACES

#: What every node has.
COMMON = {'/rosout', '/parameter_events'}


def has(node):
    """List the topics and services of a running node: direction, name and type."""
    def spell(kind):
        return f'{kind.__module__.split(".")[0]}/{kind.__name__}'

    found = {('out', one.topic_name, spell(one.msg_type)) for one in node.publishers}
    found |= {('in', one.topic_name, spell(one.msg_type)) for one in node.subscriptions}
    found |= {('service', node.resolve_service_name(one.srv_name), spell(one.srv_type))
              for one in node.services}
    return {one for one in found if one[1] not in COMMON and '/get_' not in one[1]
            and 'parameters' not in one[1] and 'type_description' not in one[1]}


def written(name):
    """List what is written of a node, with names as they resolve without a namespace."""
    def resolve(topic):
        return f'/{name}{topic[1:]}' if topic[0] == '~' else '/' + topic.lstrip('/')

    return {(end.direction, resolve(end.name), end.type) for end in INTERFACES[name]}
