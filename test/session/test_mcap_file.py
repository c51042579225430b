# SPDX-License-Identifier: Apache-2.0
"""One MCAP file: what is written is read, and a refused write leaves whole chunks."""

import subprocess
import sys
import textwrap

import pytest
from mcap.reader import make_reader
from mcap.stream_reader import StreamReader

from needle_sim_ros.errors import SessionError
from needle_sim_ros.session.mcap_file import McapFile


def nothing():
    return "closing", {"by": "test"}


def filled(path, chunks=3, compression_level=1):
    file = McapFile(path, "test", compression_level)
    file.add_attachment("scene.yaml", "application/yaml", b"name: x\n")
    file.add_metadata("about", {"key": "value"})
    one = file.add_channel("/one", "std_msgs/msg/Float64", "float64 data\n", {"a": "b"})
    two = file.add_channel("/two", "std_msgs/msg/Float64", "float64 data\n", {})
    for chunk in range(chunks):
        time = 1000 * chunk
        file.write_chunk([(one, chunk, time, b"x" * 12), (two, chunk, time + 1, b"y" * 40)])
    return file, one, two


@pytest.mark.parametrize("level", [0, 1])
def test_all_that_is_written_is_read_back(tmp_path, level):
    path = tmp_path / "a.mcap"
    file, one, two = filled(path, compression_level=level)
    assert file.message_counts == {one: 3, two: 3}
    assert file.finish(nothing) == 0
    with path.open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True)
        assert reader.get_header().profile == "ros2"
        messages = [(c.topic, m.sequence, m.log_time, m.data) for _, c, m in reader.iter_messages()]
        expected = []
        for k in range(3):
            expected.append(("/one", k, 1000 * k, b"x" * 12))
            expected.append(("/two", k, 1000 * k + 1, b"y" * 40))
        assert messages == expected
        only_two = [m.data for _, _, m in reader.iter_messages(topics=["/two"], starting_at=1500)]
        assert only_two == [b"y" * 40]
        (attachment,) = reader.iter_attachments()
        assert (attachment.name, attachment.data) == ("scene.yaml", b"name: x\n")
        metadata = {record.name: record.metadata for record in reader.iter_metadata()}
        assert metadata == {"about": {"key": "value"}, "closing": {"by": "test"}}
        statistics = reader.get_summary().statistics
        assert (statistics.message_count, statistics.chunk_count) == (6, 3)
        assert (statistics.message_start_time, statistics.message_end_time) == (0, 2001)
    with path.open("rb") as stream:
        assert sum(1 for _ in StreamReader(stream, validate_crcs=True).records) > 6


def test_an_existing_file_is_never_overwritten(tmp_path):
    path = tmp_path / "a.mcap"
    path.write_bytes(b"precious")
    with pytest.raises(FileExistsError):
        McapFile(path, "test")
    assert path.read_bytes() == b"precious"


def test_attachments_after_messages_are_refused(tmp_path):
    file, *_ = filled(tmp_path / "a.mcap")
    with pytest.raises(SessionError, match="before the first message"):
        file.add_attachment("late", "text/plain", b"")


def test_dropped_chunks_leave_a_valid_file(tmp_path):
    path = tmp_path / "a.mcap"
    file, one, two = filled(path, chunks=2)
    assert file.drop_last_chunk() == 2
    assert file.drop_last_chunk() == 2
    assert file.message_counts == {one: 0, two: 0}
    file.write_chunk([(two, 7, 5, b"z")])
    file.finish(nothing)
    with path.open("rb") as stream:
        messages = [(c.topic, m.data) for _, c, m in make_reader(stream).iter_messages()]
    assert messages == [("/two", b"z")]
    with path.open("rb") as stream:
        kinds = [type(record).__name__ for record in StreamReader(stream).records]
    assert kinds.index("Channel") < kinds.index("Message")


def test_a_removed_file_is_noticed(tmp_path):
    path = tmp_path / "a.mcap"
    file, *_ = filled(path)
    assert not file.removed
    path.unlink()
    assert file.removed


LIMITED = """
    import errno, resource, signal, sys
    from pathlib import Path
    from needle_sim_ros.session.mcap_file import McapFile
    signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    file = McapFile(Path(sys.argv[1]), "test", 0)
    channel = file.add_channel("/one", "std_msgs/msg/Float64", "float64 data\\n", {})
    resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, resource.RLIM_INFINITY))
    refused = 0
    for k in range(40):
        try:
            file.write_chunk([(channel, k, k, bytes([k]) * 1000)])
        except OSError as error:
            assert error.errno == errno.EFBIG, error
            refused += 1
    dropped = file.finish(lambda: ("closing", {}))
    print(refused, dropped)
"""


def test_a_full_disk_costs_the_last_chunks_and_nothing_else(tmp_path):
    path = tmp_path / "a.mcap"
    command = [sys.executable, "-c", textwrap.dedent(LIMITED), str(path)]
    result = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
    assert result.returncode == 0, result.stderr
    refused, dropped = map(int, result.stdout.split())
    assert refused > 0 and dropped > 0
    assert path.stat().st_size <= 20_000
    with path.open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True)
        messages = [(m.sequence, m.data) for _, _, m in reader.iter_messages()]
        assert reader.get_summary().statistics.message_count == len(messages)
    assert len(messages) == 40 - refused - dropped
    assert messages == [(k, bytes([k]) * 1000) for k in range(len(messages))]
