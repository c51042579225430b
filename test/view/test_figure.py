# SPDX-License-Identifier: Apache-2.0
"""The whole figure: readable, complete, and the same each time."""

import itertools
import struct
import xml.etree.ElementTree as ElementTree
from dataclasses import replace

import numpy as np
import pytest

from needle_sim_ros.errors import NeedleSimError
from needle_sim_ros.view.figure import session_figure
from needle_sim_ros.view.files import picture_format, save_figure


def _figure(drawn, **changes):
    given = {
        "section": drawn.section,
        "tick_times": drawn.run.tick_times,
        "time_step": drawn.scene.solver.time_step,
        "notes": "From a test.",
        **changes,
    }
    return session_figure(drawn.run.series, drawn.scene.name, **given)


def _inside(axis, axes, horizontal):
    low, high = sorted(axes.get_xlim() if horizontal else axes.get_ylim())
    labels = zip(axis.get_ticklocs(), axis.get_ticklabels(), strict=False)
    return [label for place, label in labels if low <= place <= high]


def _texts(figure):
    """Return every text that is drawn, with the axes it belongs to."""
    texts = [(None, figure._suptitle), (None, figure._supxlabel)]
    for axes in [*figure.axes, *itertools.chain(*(axes.child_axes for axes in figure.axes))]:
        own = [axes.title, axes._left_title, axes.xaxis.label, axes.yaxis.label, *axes.texts]
        own += _inside(axes.xaxis, axes, True) + _inside(axes.yaxis, axes, False)
        if axes.get_legend() is not None:
            own += axes.get_legend().get_texts()
        texts += [(axes, text) for text in own]
    return [(axes, text) for axes, text in texts if text is not None and text.get_text().strip()]


@pytest.mark.parametrize("left_out", [(), ("section",), ("tick_times",), ("section", "tick_times")])
def test_no_text_lies_over_another_or_outside(drawn, left_out):
    figure = _figure(drawn, **dict.fromkeys(left_out))
    figure.canvas.draw()
    boxes = [(text.get_text(), text.get_window_extent().padded(-0.5)) for _, text in _texts(figure)]
    assert len(boxes) > 30
    for (one, a), (two, b) in itertools.combinations(boxes, 2):
        assert not a.overlaps(b), f"{one!r} lies over {two!r}"
    for text, box in boxes:
        assert figure.bbox.x0 <= box.x0 and box.x1 <= figure.bbox.x1, text
        assert figure.bbox.y0 <= box.y0 and box.y1 <= figure.bbox.y1, text


def test_legends_lie_outside_the_data(drawn):
    figure = _figure(drawn)
    figure.canvas.draw()
    legends = [axes.get_legend() for axes in figure.axes if axes.get_legend() is not None]
    assert len(legends) == 5
    for legend, axes in itertools.product(legends, figure.axes):
        assert not legend.get_window_extent().padded(-1).overlaps(axes.get_window_extent())


def test_panels_for_what_there_is(drawn):
    series = drawn.run.series
    assert len(_figure(drawn).axes) == 5
    assert len(_figure(drawn, section=None, tick_times=None).axes) == 3
    bare = replace(
        series,
        marker_reference=np.zeros((0, 3)),
        marker_displacements=np.zeros((len(series), 0, 3)),
        friction_force=None,
        tip_force=None,
    )
    figure = session_figure(bare, "bare")
    assert len(figure.axes) == 2
    names = [text.get_text() for text in figure.axes[0].get_legend().get_texts()]
    assert names == ["base (total)"]


def test_an_empty_run_is_refused(drawn):
    series = drawn.run.series
    none = {
        name: getattr(series, name)[:0]
        for name in (
            "time",
            "insertion_depth",
            "base_force",
            "base_torque",
            "tip_position",
            "tip_deflection",
            "process",
            "marker_displacements",
            "friction_force",
            "tip_force",
            "base_position",
            "base_orientation",
        )
    }
    with pytest.raises(NeedleSimError, match="no ticks"):
        session_figure(replace(series, **none), "empty")


_BRIEF = {"section": None, "tick_times": None}


@pytest.mark.parametrize("suffix", ["png", "svg", "pdf"])
def test_files_are_whole_and_the_same_each_time(drawn, tmp_path, suffix):
    first, second = tmp_path / f"1.{suffix}", tmp_path / f"2.{suffix}"
    for path in (first, second):
        save_figure(_figure(drawn, **({} if suffix == "svg" else _BRIEF)), path)
    data = first.read_bytes()
    assert data == second.read_bytes()
    if suffix == "png":
        assert min(struct.unpack(">II", data[16:24])) > 1000
    elif suffix == "svg":
        assert ElementTree.fromstring(data).tag.endswith("svg")
    else:
        assert data.startswith(b"%PDF") and data.rstrip().endswith(b"%%EOF")


def test_other_formats_are_refused_by_name(tmp_path):
    with pytest.raises(NeedleSimError, match=r"must end in \.png, \.svg, \.pdf"):
        picture_format(tmp_path / "a.gif")
