# SPDX-License-Identifier: Apache-2.0
"""Recording: never in the way, nothing lost without being counted, nothing overwritten."""

import json
import subprocess
import sys
import textwrap
import threading
import time
from datetime import datetime, timezone

import pytest
import yaml
from mcap.exceptions import McapError
from mcap.reader import make_reader
from mcap.records import Message
from mcap.stream_reader import StreamReader
from rosbags.rosbag2 import Reader

from needle_sim_ros.errors import SessionError
from needle_sim_ros.session import cdr
from needle_sim_ros.session.bag import Bag, FolderTakenError, Topic, new_folder
from needle_sim_ros.session.recorder import Recorder

TOPIC = Topic("/depth", "std_msgs/msg/Float64")
DEADLINE = 20.0


def until(condition):
    end = time.monotonic() + DEADLINE
    while not condition():
        assert time.monotonic() < end, "condition not met in time"
        time.sleep(0.01)


def messages(folder):
    with (folder / f"{folder.name}_0.mcap").open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True)
        return [(m.sequence, m.log_time, m.data) for _, _, m in reader.iter_messages()]


def test_two_threads_lose_nothing_and_the_bag_says_what_it_holds(tmp_path):
    bag = Bag(tmp_path / "one")
    ids = [bag.add_topic(TOPIC), bag.add_topic(Topic("/other", "std_msgs/msg/String"))]
    recorder = Recorder(bag, interval=0.01)

    def produce(channel):
        for k in range(2000):
            recorder.write(1000 + k, [(channel, cdr.float64(k))])

    threads = [threading.Thread(target=produce, args=(channel,)) for channel in ids]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    status = recorder.close()
    assert (status.written, status.lost, status.queued, status.error) == (4000, 0, 0, "")
    assert status.size <= (tmp_path / "one" / "one_0.mcap").stat().st_size
    with Reader(tmp_path / "one") as reader:
        assert {c.topic: c.msgcount for c in reader.connections} == {"/depth": 2000, "/other": 2000}
        assert (reader.start_time, reader.end_time) == (1000, 3000)
        assert sum(1 for _ in reader.messages()) == 4000
    text = (tmp_path / "one" / "metadata.yaml").read_text()
    information = yaml.safe_load(text)["rosbag2_bagfile_information"]
    assert information["version"] == 9
    assert information["message_count"] == 4000
    assert information["relative_file_paths"] == ["one_0.mcap"]
    assert "&id" not in text


def test_a_queue_that_is_full_loses_and_counts_but_never_waits(tmp_path):
    bag = Bag(tmp_path / "one")
    channel = bag.add_topic(TOPIC)
    recorder = Recorder(bag, capacity=10 * (12 + 120), interval=600.0)
    start = time.monotonic()
    for k in range(25):
        recorder.write(1, [(channel, cdr.float64(k))])
    assert time.monotonic() - start < 1.0
    assert recorder.status.lost == 15
    assert recorder.status.queued == 10
    assert "too slow" in recorder.status.error
    status = recorder.close()
    assert (status.written, status.lost) == (10, 15)
    assert [sequence for sequence, *_ in messages(tmp_path / "one")] == list(range(10))


def test_it_gives_way_every_few_messages(tmp_path):
    """Whoever it gives way to has to see that nothing more is written until it goes on."""
    bag = Bag(tmp_path / "one")
    channel = bag.add_topic(TOPIC)
    gate, asked = threading.Event(), threading.Event()

    def give_way():
        asked.set()
        gate.wait(DEADLINE)

    recorder = Recorder(bag, interval=0.01, give_way=give_way)
    for k in range(200):
        recorder.write(1000 + k, [(channel, cdr.float64(k))])
    assert asked.wait(DEADLINE)
    assert recorder.status.written == 0
    gate.set()
    status = recorder.close()
    assert (status.written, status.lost) == (200, 0)
    assert [sequence for sequence, *_ in messages(tmp_path / "one")] == list(range(200))


def test_many_that_begin_at_the_same_moment_get_folders_of_their_own(tmp_path):
    now = datetime(2026, 1, 1, tzinfo=timezone.utc)
    taken, start = [], threading.Barrier(8)

    def begin():
        start.wait()
        while True:
            try:
                taken.append(Bag(new_folder(tmp_path, "scene", now)).folder)
            except FolderTakenError:
                continue
            return

    threads = [threading.Thread(target=begin) for _ in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(set(taken)) == 8 == len(list(tmp_path.iterdir()))


def test_what_comes_after_the_end_is_counted(tmp_path):
    bag = Bag(tmp_path / "one")
    channel = bag.add_topic(TOPIC)
    recorder = Recorder(bag)
    assert recorder.close().lost == 0
    recorder.write(1, [(channel, cdr.float64(0))])
    assert recorder.status.lost == 1


def test_a_removed_folder_is_said_and_everything_in_it_counts_as_lost(tmp_path):
    folder = tmp_path / "one"
    bag = Bag(folder)
    channel = bag.add_topic(TOPIC)
    recorder = Recorder(bag, interval=0.01)
    recorder.write(1, [(channel, cdr.float64(0))])
    until(lambda: recorder.status.written == 1)
    (folder / "one_0.mcap").unlink()
    folder.rmdir()
    recorder.write(2, [(channel, cdr.float64(0))])
    until(lambda: recorder.status.lost)
    recorder.write(3, [(channel, cdr.float64(0))])
    status = recorder.close()
    assert (status.written, status.lost) == (0, 3)
    assert "was removed" in status.error
    assert not folder.exists()


def test_a_session_is_never_overwritten(tmp_path):
    now = datetime(2026, 1, 2, 3, 4, 5, tzinfo=timezone.utc)
    first = new_folder(tmp_path, "a scene/../x", now)
    assert first == tmp_path / "a_scene_.._x_20260102T030405Z"
    Bag(first).file.abandon()
    second = new_folder(tmp_path, "a scene/../x", now)
    assert second.name == first.name + "_2"
    content = (first / f"{first.name}_0.mcap").read_bytes()
    with pytest.raises(SessionError, match="exists: a session is never overwritten"):
        Bag(first)
    assert (first / f"{first.name}_0.mcap").read_bytes() == content


def test_a_folder_that_cannot_be_made_is_refused_with_the_reason(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(SessionError, match=r"cannot record in .*: Not a directory"):
        Bag(tmp_path / "file" / "session")


FULL_DISK = """
    import json, resource, signal, sys, time
    from pathlib import Path
    from needle_sim_ros.session.bag import Bag, Topic
    from needle_sim_ros.session.recorder import Recorder
    from needle_sim_ros.session import cdr
    signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    bag = Bag(Path(sys.argv[1]))
    channel = bag.add_topic(Topic("/depth", "std_msgs/msg/String"))
    recorder = Recorder(bag, interval=0.002)
    resource.setrlimit(resource.RLIMIT_FSIZE, (30_000, resource.RLIM_INFINITY))
    slowest = 0.0
    for k in range(300):
        start = time.perf_counter()
        recorder.write(k, [(channel, cdr.text(str(k) + "x" * 500))])
        slowest = max(slowest, time.perf_counter() - start)
        time.sleep(0.001)
    status = recorder.close()
    print(json.dumps([status.written, status.lost, status.queued, status.error, slowest]))
"""


def test_a_full_disk_ends_neither_the_program_nor_the_recording(tmp_path):
    folder = tmp_path / "one"
    command = [sys.executable, "-c", textwrap.dedent(FULL_DISK), str(folder)]
    result = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
    assert result.returncode == 0, result.stderr
    written, lost, queued, error, slowest = json.loads(result.stdout)
    assert written + lost == 300
    assert written > 0 and lost > 0 and queued == 0
    assert error
    assert slowest < 0.5
    assert len(messages(folder)) == written
    with Reader(folder) as reader:
        assert reader.message_count == written


KILLED = """
    import sys, time
    from pathlib import Path
    from needle_sim_ros.session.bag import Bag, Topic
    from needle_sim_ros.session.recorder import Recorder
    from needle_sim_ros.session import cdr
    bag = Bag(Path(sys.argv[1]))
    channel = bag.add_topic(Topic("/depth", "std_msgs/msg/Float64"))
    recorder = Recorder(bag)
    start = time.monotonic_ns()
    while True:
        now = time.monotonic_ns()
        recorder.write(now, [(channel, cdr.float64(0.0))])
        print(now, flush=True)
        time.sleep(0.002)
"""


def test_kill_9_loses_less_than_half_a_second(tmp_path):
    folder = tmp_path / "one"
    command = [sys.executable, "-c", textwrap.dedent(KILLED), str(folder)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        first = int(process.stdout.readline())
        last = first
        while last - first < 1.3e9:
            last = int(process.stdout.readline())
        process.kill()
        for line in process.stdout:
            last = int(line)
    recorded = []
    with (folder / "one_0.mcap").open("rb") as stream:
        try:
            for record in StreamReader(stream, validate_crcs=True).records:
                if isinstance(record, Message):
                    recorded.append(record.log_time)
        except McapError:
            pass
    assert recorded[0] == first
    assert last - recorded[-1] < 0.5e9
