# SPDX-License-Identifier: Apache-2.0
"""What is before the damage is recovered, nothing false is, and the source stays as it is."""

import random
import resource
import signal
import subprocess
import sys
import textwrap
import time

import pytest
from mcap.opcode import Opcode
from rosbags.rosbag2 import Reader

from needle_sim_ros.errors import SessionError
from needle_sim_ros.scene import Scene
from needle_sim_ros.session.bag import Bag
from needle_sim_ros.session.content import MESSAGE_HEAD, read_content
from needle_sim_ros.session.mcap_chunk import records_in
from needle_sim_ros.session.mcap_walk import Source, walk
from needle_sim_ros.session.motion import Motion
from needle_sim_ros.session.reader import read_session
from needle_sim_ros.session.salvage import salvage
from needle_sim_ros.session.writer import SessionWriter
from needle_sim_ros.simulator import Simulator

DT = 0.01
DOWN = Motion("velocity", (0.0, 0.0, -0.05), (0.0, 0.0, 0.0))


def in_small_chunks(file, folder, size):
    """Copy a session with `size` messages to a chunk; return the new file."""
    content, bag = read_content(file), Bag(folder)
    for name, data in content.attachments.items():
        bag.file.add_attachment(name, "text/plain", data)
    for name, values in content.metadata.items():
        if name != "rosbag2":
            bag.file.add_metadata(name, values)
    entries = []
    for number, channel in content.channels.items():
        copy = bag.copy_topic(channel, content.schemas[channel.schema_id])
        messages = content.messages.get(number, [])
        entries += [(copy, sequence, time, data) for sequence, time, data in messages]
    entries.sort(key=lambda entry: entry[2])
    for start in range(0, len(entries), size):
        bag.write(entries[start : start + size])
    bag.close()
    return folder / f"{folder.name}_0.mcap"


def messages_of(file):
    """Return (topic, log time, bytes) of every message, in the order of the file."""
    content = read_content(file)
    return sorted(
        (content.channels[number].topic, time, data)
        for number, messages in content.messages.items()
        for _, time, data in messages
    )


def chunk_ends(file):
    """Return where each chunk of a whole file ends and what it holds."""
    content, ends = read_content(file), []
    with Source(file) as source:
        for piece in walk(source):
            if piece.opcode != Opcode.CHUNK:
                continue
            held = []
            for opcode, begin, end in records_in(piece.content):
                if opcode == Opcode.MESSAGE:
                    number, _, time, _ = MESSAGE_HEAD.unpack_from(piece.content, begin)
                    data = piece.content[begin + MESSAGE_HEAD.size : end]
                    held.append((content.channels[number].topic, time, data))
            ends.append((piece.end, held))
    return ends


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """Return the MCAP file of a session of 60 ticks in 20 chunks."""
    changes = {
        "solver.dynamics": "quasi_static",
        "solver.track_spacing": 4.0e-3,
        "tissue.mesh.spacing_across": 2.0e-3,
        "tissue.mesh.spacing_along": 4.0e-3,
        "markers": [[0.0, 0.0, -0.01], [0.005, 0.0, -0.02]],
    }
    folder = tmp_path_factory.mktemp("salvage")
    scene = Scene.load("gao2016", changes)
    simulator = Simulator(scene)
    writer = SessionWriter(folder / "one", scene, DT)
    for _ in range(60):
        writer.observe(simulator.step(DOWN.command(), DT), DOWN)
    assert not writer.close().error
    return in_small_chunks(folder / "one" / "one_0.mcap", folder / "many", 30)


@pytest.fixture(scope="module")
def known(whole):
    """Return all messages, and where each chunk ends with what it holds."""
    return set(messages_of(whole)), chunk_ends(whole)


def before(ends, place):
    return {message for end, held in ends if end <= place for message in held}


def new_file(folder):
    (file,) = folder.glob("*.mcap")
    return file


def test_a_file_cut_anywhere_gives_all_that_is_before_the_cut(whole, known, tmp_path):
    data, (everything, ends) = whole.read_bytes(), known
    generator = random.Random(2)
    places = [0, 5, 8, len(data) - 1, *(generator.randrange(len(data)) for _ in range(36))]
    for k, place in enumerate(places):
        cut = tmp_path / "cut.mcap"
        cut.write_bytes(data[:place])
        result = salvage([cut], tmp_path / f"out{k}")
        assert cut.read_bytes() == data[:place]
        assert result.losses, place
        found = set(messages_of(new_file(result.folder)))
        assert before(ends, place) <= found <= everything, place
        assert len(found) == sum(result.messages.values())
        if found and k % 4 == 0:
            assert read_session(result.folder).complete
            with Reader(result.folder) as reader:  # a reader that is not ours
                assert sum(1 for _ in reader.messages()) == len(found)


def test_a_flipped_bit_costs_no_more_than_its_chunk_and_nothing_false_comes_out(
    whole, known, tmp_path
):
    data, (everything, ends) = bytearray(whole.read_bytes()), known
    largest = max(len(held) for _, held in ends)
    generator = random.Random(3)
    for k in range(100):
        place, bit = generator.randrange(len(data)), 1 << generator.randrange(8)
        path = tmp_path / "flipped.mcap"
        data[place] ^= bit
        path.write_bytes(data)
        flipped = bytes(data)
        data[place] ^= bit
        result = salvage([path], tmp_path / f"out{k}")
        assert path.read_bytes() == flipped
        found = set(messages_of(new_file(result.folder)))
        assert before(ends, place) <= found <= everything, place
        assert len(everything) - len(found) <= largest, place
        assert len(found) == len(everything) or result.losses, place


def test_a_chunk_is_known_without_its_opcode(whole, known, tmp_path):
    """Each bit of it flipped: the record is then of another kind, or of none."""
    data, (everything, _) = bytearray(whole.read_bytes()), known
    with Source(whole) as source:
        chunks = [piece for piece in walk(source) if piece.opcode == Opcode.CHUNK]
    for bit in range(8):
        damaged = bytearray(data)
        damaged[chunks[5].offset] ^= 1 << bit
        path = tmp_path / f"{bit}.mcap"
        path.write_bytes(damaged)
        result = salvage([path], tmp_path / f"out{bit}")
        found = set(messages_of(new_file(result.folder)))
        assert found == everything, bit


@pytest.mark.parametrize("bit", [9, 12, 13])
def test_an_index_with_a_wrong_length_swallows_no_chunk(whole, known, tmp_path, bit):
    """Wherever the wrong length ends, even where it looks as if a record began."""
    data, (everything, _) = bytearray(whole.read_bytes()), known
    with Source(whole) as source:
        indices = [piece for piece in walk(source) if piece.opcode == Opcode.MESSAGE_INDEX]
    for k, index in enumerate(indices[:-40:6]):
        damaged = bytearray(data)
        damaged[index.offset + 1 + bit // 8] ^= 1 << bit % 8
        path = tmp_path / "longer.mcap"
        path.write_bytes(damaged)
        result = salvage([path], tmp_path / f"out{k}")
        assert set(messages_of(new_file(result.folder))) == everything, k


def test_a_lost_chunk_is_counted(whole, known, tmp_path):
    data, (_, ends) = bytearray(whole.read_bytes()), known
    data[ends[4][0] - 20] ^= 1  # within the last bytes of the fifth chunk's packed messages
    path = tmp_path / "flipped.mcap"
    path.write_bytes(data)
    (loss,) = salvage([path], tmp_path / "out").losses
    assert "checksum" in loss.reason or "unpacked" in loss.reason or "size" in loss.reason
    assert loss.messages == len(ends[4][1])


def test_what_is_not_damaged_is_copied_whole(whole, known, tmp_path):
    result = salvage([whole], tmp_path / "out")
    assert (result.losses, result.notes, result.has_scene) == ([], [], True)
    assert set(messages_of(new_file(result.folder))) == known[0]
    assert read_session(result.folder).scene_text == read_session(whole).scene_text


def test_a_session_from_before_the_scene_had_a_checksum_is_given_one(whole, tmp_path):
    # The key is renamed in place: the session then has none, as older ones.
    data = whole.read_bytes().replace(b"scene_sha256", b"scene_sha000", 1)
    old = tmp_path / "old.mcap"
    old.write_bytes(data)
    with pytest.raises(SessionError, match=r"recorded before .* needle_sim salvage"):
        read_session(old)
    result = salvage([old], tmp_path / "out")
    assert "checksum of the scene" in " ".join(result.notes)
    assert len(read_session(result.folder).series) == 60


def test_what_is_no_mcap_file_leaves_nothing_behind(tmp_path):
    path = tmp_path / "text.mcap"
    path.write_bytes(b"a text that is long enough to be searched for records " * 100)
    with pytest.raises(SessionError, match="not an MCAP file"):
        salvage([path], tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_an_existing_folder_is_left_alone(whole, tmp_path):
    (tmp_path / "out").mkdir()
    with pytest.raises(SessionError, match="exists"):
        salvage([whole], tmp_path / "out")
    assert list((tmp_path / "out").iterdir()) == []


def test_lengths_that_lie_take_no_memory(whole, known, tmp_path):
    data, (_, ends) = whole.read_bytes(), known
    begin = ends[3][0]  # what follows is found again from here
    path = tmp_path / "lies.mcap"
    lie = b"\x06" + (1 << 39).to_bytes(8, "little") + bytes(16) + (1 << 29).to_bytes(8, "little")
    path.write_bytes(data[:begin] + lie + data[begin:])
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    result = salvage([path], tmp_path / "out")
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - peak < 50_000  # KiB
    assert set(messages_of(new_file(result.folder))) == known[0]


RECORDING = """
    import sys, time
    from pathlib import Path
    from needle_sim_ros.session.recorder import Recorder
    from needle_sim_ros.session.bag import Bag, Topic
    from needle_sim_ros.session import cdr
    bag = Bag(Path(sys.argv[1]))
    topic = bag.add_topic(Topic("/depth", "std_msgs/msg/Float64"))
    recorder = Recorder(bag)
    for k in range(100_000):
        recorder.write(k, [(topic, cdr.float64(k))])
        print(time.monotonic(), flush=True)
        time.sleep(0.005)
"""


def test_a_killed_recording_loses_less_than_half_a_second(tmp_path):
    command = [sys.executable, "-c", textwrap.dedent(RECORDING), str(tmp_path / "killed")]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        times = [float(process.stdout.readline())]
        time.sleep(1.3)
        process.send_signal(signal.SIGKILL)
        times += [float(line) for line in process.stdout.read().splitlines() if "." in line[:-3]]
    result = salvage([tmp_path / "killed" / "killed_0.mcap"], tmp_path / "out")
    saved = result.messages["/depth"]
    assert saved > 20
    assert times[-1] - times[saved - 1] < 0.5
    assert [time for _, time, _ in messages_of(new_file(result.folder))] == list(range(saved))
