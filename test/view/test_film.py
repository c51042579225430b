# SPDX-License-Identifier: Apache-2.0
"""Films: every frame there and different, colours kept, formats refused by name."""

import shutil
from dataclasses import replace

import numpy as np
import pytest
from PIL import Image

from needle_sim_ros.errors import NeedleSimError
from needle_sim_ros.view.film import film_writer, make_film
from needle_sim_ros.view.style import VERMILION


@pytest.fixture
def sections(drawn):
    section = drawn.section
    half = replace(section, time=section.time / 2, displacement=0.5 * section.displacement)
    return [half, section]


def test_a_gif_has_a_frame_per_section(drawn, sections, tmp_path):
    path, drawn_frames = tmp_path / "film.gif", []
    make_film(drawn.run.series, sections, "film", path, lambda: drawn_frames.append(1))
    assert len(drawn_frames) == 2
    with Image.open(path) as film:
        assert film.n_frames == 2
        frames = []
        for number in range(2):
            film.seek(number)
            frames.append(np.asarray(film.convert("RGB")).astype(int))
    assert (abs(frames[0] - frames[1]).max(axis=2) > 30).sum() > 500  # it moves
    line = np.array(list(bytes.fromhex(VERMILION[1:])))
    assert (abs(frames[0] - line).max(axis=2) <= 8).sum() > 20  # its palette has the lines'


@pytest.mark.skipif(shutil.which("ffmpeg") is None, reason="no ffmpeg here")
def test_an_mp4_is_one(drawn, sections, tmp_path):
    path = tmp_path / "film.mp4"
    make_film(drawn.run.series, sections, "film", path)
    assert path.read_bytes()[4:8] == b"ftyp"


def test_without_ffmpeg_an_mp4_is_refused_with_a_way_out(tmp_path, monkeypatch):
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(NeedleSimError, match=r"needs the program ffmpeg; a \.gif needs nothing"):
        film_writer(tmp_path / "film.mp4")


def test_other_formats_are_refused_by_name(tmp_path):
    with pytest.raises(NeedleSimError, match=r"must end in \.gif or \.mp4"):
        film_writer(tmp_path / "film.avi")
