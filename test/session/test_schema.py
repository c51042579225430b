# SPDX-License-Identifier: Apache-2.0
"""Message definitions: found in the ament index, complete, with the hash ROS uses."""

import re

import pytest
from mcap_ros2._dynamic import generate_dynamic
from rosbags.typesys import Stores, get_typestore

from needle_sim_ros.errors import SessionError
from needle_sim_ros.session import channels
from needle_sim_ros.session.schema import message_schema

TYPES = sorted({c.type for c in (*channels.INPUTS, *channels.OUTPUTS, *channels.RECORDS)})


@pytest.mark.parametrize("name", TYPES)
def test_schemas_have_all_dependencies_and_the_hash_of_jazzy(name):
    schema = message_schema(name)
    store = get_typestore(Stores.ROS2_JAZZY)
    assert schema.type_hash == store.hash_rihs01(name)
    assert name in generate_dynamic(name, schema.text)
    parts = re.split("\n={80}\n", schema.text)
    heads = [part.splitlines()[0] for part in parts[1:]]
    text, _ = store.generate_msgdef(name, ros_version=2)
    expected = re.findall("^MSG: .*$", text, flags=re.MULTILINE)
    assert sorted(heads) == sorted(expected)
    assert len(set(heads)) == len(heads)


def test_the_definitions_of_a_sourced_workspace_come_first(tmp_path, monkeypatch):
    folder = tmp_path / "share" / "std_msgs" / "msg"
    folder.mkdir(parents=True)
    (folder / "Thing.msg").write_text("float64 data # of this workspace\n")
    hashes = '{"type_hashes": [{"type_name": "std_msgs/msg/Thing", "hash_string": "RIHS01_0"}]}'
    (folder / "Thing.json").write_text(hashes)
    monkeypatch.setenv("AMENT_PREFIX_PATH", f"/nowhere:{tmp_path}")
    schema = message_schema("std_msgs/msg/Thing")
    assert schema.text == "float64 data # of this workspace\n"
    assert schema.type_hash == "RIHS01_0"


def test_a_type_that_is_not_installed_is_named():
    with pytest.raises(SessionError, match=r"std_msgs/msg/Nothing\.msg not found in .*source"):
        message_schema("std_msgs/msg/Nothing")
