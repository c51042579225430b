# SPDX-License-Identifier: Apache-2.0
"""What each panel shows, read back from what it drew."""

import itertools

import numpy as np
import pytest
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure

from needle_sim_ros.view.bands import Band, bands, draw_bands
from needle_sim_ros.view.force import axial_force, draw_force_over_depth, draw_force_over_time
from needle_sim_ros.view.markers import draw_marker_tracks, exaggeration
from needle_sim_ros.view.section import draw_section, needle_outline
from needle_sim_ros.view.style import PROCESSES, styled
from needle_sim_ros.view.timing import draw_tick_histogram


@pytest.fixture
def ax():
    with styled():
        yield Figure(figsize=(8, 3)).add_subplot()


def _line(ax, label):
    return next(line for line in ax.lines if line.get_label() == label)


def test_bands_are_runs_of_one_process():
    process = ["free", "free", "contact", "hold", "hold", "hold", "contact"]
    assert bands(process) == [
        Band("free", 0, 1),
        Band("contact", 2, 2),
        Band("hold", 3, 5),
        Band("contact", 6, 6),
    ]
    assert bands([]) == []


def test_band_labels_slant_only_where_they_are_wider_than_the_band(ax):
    process = ["free"] * 50 + ["contact"] * 3 + ["insertion"] * 100
    time = np.arange(1, len(process) + 1) * 0.1
    ax.set_xlim(0, time[-1])
    draw_bands(ax, time, process)
    slants = {text.get_text(): text.get_rotation() for text in ax.texts}
    assert slants == {"free": 0, "contact": 40, "insertion": 0}


def test_flickering_labels_do_not_pile_up(ax):
    process = ["insertion", "hold"] * 500
    time = np.arange(1, 1001) * 0.01
    ax.set_xlim(0, 10)
    draw_bands(ax, time, process)
    assert len(ax.texts) == 0


def test_processes_differ_in_grey():
    def grey(colour):
        return float(np.dot(to_rgb(colour), (0.2126, 0.7152, 0.0722)))

    order = ["free", "contact", "insertion", "hold", "retraction", "free"]
    for one, two in itertools.pairwise(order):
        assert abs(grey(PROCESSES[one].band) - grey(PROCESSES[two].band)) > 0.015
    dashes = [style.dashes for style in PROCESSES.values()]
    assert len(set(dashes)) == len(dashes)


def test_force_is_positive_when_pushed_in_and_the_sum_of_its_parts(drawn, ax):
    series = drawn.run.series
    draw_force_over_time(ax, series, instant=drawn.section.time)
    total = _line(ax, "base (total)").get_ydata()
    process = np.array(series.process)
    assert total[process == "insertion"].min() > 0
    assert total[process == "retraction"][-20:].max() < 0
    parts = _line(ax, "friction").get_ydata() + _line(ax, "tip").get_ydata()
    assert np.allclose(parts, total, atol=1e-9)
    mark = _line(ax, "section below")
    assert mark.get_xdata()[0] == drawn.section.time
    assert mark.get_ydata()[0] in total


def test_force_over_depth_in_millimetres(drawn, ax):
    series = drawn.run.series
    draw_force_over_depth(ax, series)
    labels = [text.get_text() for text in ax.get_legend().get_texts()]
    assert labels == ["contact", "insertion", "hold", "retraction"]
    insertion = _line(ax, "insertion")
    deepest = 1e3 * series.insertion_depth[np.array(series.process) == "insertion"].max()
    assert insertion.get_xdata().max() == pytest.approx(deepest)
    assert insertion.get_ydata()[-1] == axial_force(series)[series.process.index("hold") - 1]


def test_exaggeration_keeps_neighbours_apart():
    reference = np.array([[0.0, 0, -0.01], [0.01, 0, -0.01], [0, 0, -0.03]])
    moved = np.zeros((5, 3, 3))
    moved[:, 0, 2] = np.linspace(0, -1e-3, 5)
    assert exaggeration(reference, moved) == 10
    assert exaggeration(reference, 30 * moved) == 1
    assert exaggeration(reference, 0 * moved) == 1
    # Towards each other they must share the way between them.
    moved[:, 0, 0], moved[:, 1, 0] = np.linspace(0, 1e-3, 5), np.linspace(0, -1e-3, 5)
    assert exaggeration(reference, moved) == 2


def test_marker_tracks_start_where_the_markers_were(drawn, ax):
    series = drawn.run.series
    draw_marker_tracks(ax, series)
    factor = exaggeration(series.marker_reference, series.marker_displacements)
    assert factor > 1
    assert ax.get_title(loc="left") == f"Marker tracks, drawn {factor} times longer"
    assert np.allclose(_line(ax, "start").get_xydata(), 1e3 * series.marker_reference[:, [0, 2]])
    numbers = {text.get_text() for text in ax.texts}
    assert numbers == {str(k) for k in range(1, len(series.marker_reference) + 1)}
    track = _line(ax, "insertion").get_xydata()
    first = series.process.index("insertion") - 1
    shift = track[0] - 1e3 * series.marker_reference[0, [0, 2]]
    assert np.allclose(shift, 1e3 * factor * series.marker_displacements[first, 0, [0, 2]])


def test_section_is_that_of_the_simulator(drawn, ax):
    section, series = drawn.section, drawn.run.series
    row = int(np.argmin(np.abs(series.time - section.time)))
    assert series.process[row] == "insertion" and series.process[row + 1] != "insertion"
    assert np.allclose(section.markers, series.marker_positions[row])
    assert np.allclose(section.needle[-1], series.tip_position[row])
    assert np.isfinite(section.displacement).all()
    # u = 0 on the fixed faces: left, right, bottom.
    for edge in (section.displacement[:, 0], section.displacement[:, -1], section.displacement[-1]):
        assert np.abs(edge).max() < 1e-12
    # The track lies on the needle.
    on_needle = np.interp(section.track[:, 2], section.needle[::-1, 2], section.needle[::-1, 0])
    assert np.abs(section.track[:, 0] - on_needle).max() < 0.2 * section.radius
    draw_section(ax, section)
    drawn_values = ax.collections[0].get_array()
    assert drawn_values.max() == pytest.approx(
        1e3 * np.linalg.norm(section.displacement, axis=2).max()
    )
    assert ax.child_axes[0].get_ylabel() == "displacement (mm)"


def test_needle_outline_is_as_thick_as_the_needle_and_bevelled(drawn):
    section = drawn.section
    outline = needle_outline(section)
    base = section.needle[0, [0, 2]]
    ends = outline[np.abs(outline[:, 1] - base[1]) < 1e-4]
    assert np.ptp(ends[:, 0]) == pytest.approx(2 * section.radius, rel=1e-3)
    right, left = outline[outline[:, 0] > base[0]], outline[outline[:, 0] < base[0]]
    assert right[:, 1].min() < left[:, 1].min()  # the sharp edge is on the +x side


def test_histogram_counts_every_tick(drawn, ax):
    times = drawn.run.tick_times
    draw_tick_histogram(ax, times, 0.02)
    labels = [text.get_text() for text in ax.get_legend().get_texts()]
    assert labels[0] == f"median {1e3 * np.median(times):.3g} ms"
    assert labels[2] == "real time 20 ms"
    steps = ax.patches[0].get_xy()
    counts = steps[1:-1:2, 1]
    assert counts.max() <= len(times)
    assert steps[:, 0].min() < 1e3 * times.min() and steps[:, 0].max() > 1e3 * times.max()
