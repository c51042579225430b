# SPDX-License-Identifier: Apache-2.0
"""Sessions in several files: written as rosbag2 splits, read, salvaged and replayed as one."""

import errno
import json

import numpy as np
import pytest
import yaml
from rosbags.rosbag2 import Reader

from needle_sim_ros import Simulator
from needle_sim_ros.cli import main
from needle_sim_ros.session import cdr
from needle_sim_ros.session.bag import Bag, Split, Topic
from needle_sim_ros.session.mcap_file import McapFile
from needle_sim_ros.session.motion import Motion
from needle_sim_ros.session.reader import mcap_files, read_session
from needle_sim_ros.session.recorder import Recorder
from needle_sim_ros.session.replay import replay, replay_ticks
from needle_sim_ros.session.writer import SessionWriter

TOPIC = Topic("/depth", "std_msgs/msg/Float64")
DT = 0.05


def information(folder):
    text = (folder / "metadata.yaml").read_text()
    return yaml.safe_load(text)["rosbag2_bagfile_information"]


def recorded(folder, split, count=1000):
    """Record numbers, one a millisecond, in batches of 25."""
    recorder = Recorder(Bag(folder, split), interval=600.0)
    channel = recorder._bag.add_topic(TOPIC)
    for start in range(0, count, 25):
        batch = [(channel, k, k * 10**6, cdr.float64(k)) for k in range(start, start + 25)]
        for piece in recorder._bag.pieces(batch):
            recorder._write(piece)
    return recorder.close()


@pytest.mark.parametrize("split", [Split(duration=0.06), Split(size=2000), Split(2000, 0.06)])
def test_files_follow_each_other_and_other_readers_see_one_bag(tmp_path, split):
    status = recorded(tmp_path / "bag", split)
    assert (status.written, status.lost) == (1000, 0)
    folder = tmp_path / "bag"
    about = information(folder)
    names = about["relative_file_paths"]
    assert names == [f"bag_{k}.mcap" for k in range(len(names))]
    assert sorted(p.name for p in folder.glob("*.mcap")) == sorted(names)
    assert len(names) > 10
    assert [p.name for p in mcap_files(folder)] == names  # 10 comes after 9
    assert sum(f["message_count"] for f in about["files"]) == about["message_count"] == 1000
    assert about["duration"]["nanoseconds"] == 999 * 10**6
    starts = [f["starting_time"]["nanoseconds_since_epoch"] for f in about["files"]]
    assert starts == sorted(starts)
    if split.duration:
        assert max(f["duration"]["nanoseconds"] for f in about["files"]) < 60 * 10**6
    if split == Split(duration=0.06):
        assert {f["message_count"] for f in about["files"][:-1]} == {60}
    if split.size:
        sizes = [(folder / name).stat().st_size for name in names[:-1]]
        assert max(sizes) < 2000 + 3500  # a chunk more, and the summary
    with Reader(folder) as reader:
        assert reader.message_count == 1000
        assert [stamp for _, stamp, _ in reader.messages()] == [k * 10**6 for k in range(1000)]


def test_without_room_for_another_file_the_recording_goes_on_in_the_same(tmp_path, monkeypatch):
    made = McapFile.__init__

    def full(self, path, *arguments):
        if not path.name.endswith("_0.mcap"):
            raise OSError(errno.ENOSPC, "No space left on device")
        made(self, path, *arguments)

    monkeypatch.setattr(McapFile, "__init__", full)
    status = recorded(tmp_path / "bag", Split(duration=0.06))
    assert (status.written, status.lost, status.error) == (1000, 0, "")
    assert information(tmp_path / "bag")["relative_file_paths"] == ["bag_0.mcap"]


@pytest.fixture(scope="module")
def split_session(tmp_path_factory, coarse_scene):
    """Return the folder of a session in several files, and its scene."""
    scene = coarse_scene({"markers": [[0.0, 0.0, -0.01]]})
    folder = tmp_path_factory.mktemp("split") / "session"
    writer = SessionWriter(folder, scene, DT, split=Split(duration=1.0))
    simulator = Simulator(scene)
    motion = Motion("velocity", (0.0, 0.0, -6e-3), (0.0, 0.0, 0.0))
    for _ in range(75):
        writer.observe(simulator.step(motion.command(), DT), motion)
    assert writer.close().lost == 0
    return folder, scene


def test_a_split_session_is_read_and_replayed_as_one(split_session):
    folder, scene = split_session
    files = mcap_files(folder)
    assert len(files) == 4
    session = read_session(folder)
    assert session.complete and session.path == folder
    np.testing.assert_allclose(session.series.time, DT * np.arange(1, 76))
    done = replay(session.metadata, Simulator(scene), replay_ticks(session))
    np.testing.assert_array_equal(done.series.base_force, session.series.base_force)
    part = read_session(files[1])  # each file has the scene, too
    assert part.scene_text == session.scene_text
    assert len(part.series) == 20


def test_the_command_replays_a_split_session(split_session, tmp_path, capsys):
    folder, _ = split_session
    assert main(["replay", str(folder), "--json", str(tmp_path / "out.json")]) == 0
    out = json.loads((tmp_path / "out.json").read_text())
    assert out["ticks_compared"] == 75
    assert all(channel["max_abs"] == 0 for channel in out["channels"].values())


def test_a_split_session_that_was_cut_off_is_salvaged_whole(split_session, tmp_path, capsys):
    folder, _ = split_session
    broken = tmp_path / "broken"
    broken.mkdir()
    for file in mcap_files(folder):  # as after kill -9: no metadata.yaml, the last one cut
        (broken / file.name).write_bytes(file.read_bytes())
    last = mcap_files(broken)[-1]
    last.write_bytes(last.read_bytes()[:-3000])
    middle = mcap_files(broken)[1]
    data = bytearray(middle.read_bytes())
    place = data.index(b"zstd") + 200
    data[place] ^= 1
    middle.write_bytes(bytes(data))
    before = {file: file.read_bytes() for file in broken.iterdir()}
    assert not read_session(broken).complete

    out = tmp_path / "saved"
    result = tmp_path / "result.json"
    assert main(["salvage", str(broken), "--output", str(out), "--json", str(result)]) == 0
    report = json.loads(result.read_text())
    assert {loss["file"] for loss in report["losses"]} >= {last.name, middle.name}
    assert f"{middle.name} at byte" in capsys.readouterr().out
    assert {file: file.read_bytes() for file in broken.iterdir()} == before
    session = read_session(out)
    assert session.complete
    ticks = np.rint(session.series.time / DT).astype(int)
    assert set(ticks) >= {*range(1, 21), *range(41, 61)}  # the files that are whole
    assert len(ticks) < 75
    with Reader(out) as reader:
        assert reader.message_count == report["messages"]
        assert len({c.topic for c in reader.connections}) == len(reader.connections)


def test_a_folder_without_one_readable_file_is_refused(tmp_path, capsys):
    folder = tmp_path / "bag"
    folder.mkdir()
    for k in range(2):
        (folder / f"bag_{k}.mcap").write_bytes(b"no MCAP at all" * 100)
    assert main(["salvage", str(folder), "--output", str(tmp_path / "out")]) != 0
    assert "not an MCAP file" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()
