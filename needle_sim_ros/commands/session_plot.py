# SPDX-License-Identifier: Apache-2.0
"""A recorded session as figures and pictures, for ``plot``, ``report`` and ``demo``."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from needle_sim_ros.commands.output import progress
from needle_sim_ros.errors import SessionError

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from needle_sim_ros.session.reader import Session
    from needle_sim_ros.session.summary import Summary
    from needle_sim_ros.view.section import Section


def plot_session(bag: Path, output: Path, movie: Path | None = None, frames: int = 0) -> Summary:
    """Draw a session into a file, and as a film of so many frames; return its summary.

    Raises
    ------
    SessionError
        When the session cannot be read or holds no tick, or its scene and motion, which a
        film needs, are not known.
    """
    from needle_sim_ros.view.files import save_figure

    session = read_drawable(bag)
    sections, note = sections_of(session, film_rows(session, frames) if movie else ())
    save_figure(figure_of(session, sections, note), output)
    if movie is not None:
        if not sections:
            raise SessionError(f"{movie}: not made. {note}")
        _film(session, sections, movie)
    return summary_of(session)


def read_drawable(bag: Path) -> Session:
    """Read a session that holds a tick at least; SessionError where none can be had."""
    from needle_sim_ros.session.reader import read_session

    session = read_session(bag)
    if not len(session.series):
        raise SessionError(f"{bag}: no tick was recorded")
    return session


def summary_of(session: Session) -> Summary:
    """Return a session's summary, with its tick times where they were recorded."""
    from needle_sim_ros.session.summary import summarise

    times = session.tick_times if len(session.tick_times) else None
    return summarise(session.series, float(session.metadata["tick_period"]), times)


def figure_of(session: Session, sections: dict[int, Section], note: str) -> Figure:
    """Return the figure of a session, with its section at the end of the insertion."""
    from needle_sim_ros.session.run import insertion_end
    from needle_sim_ros.view.figure import session_figure

    return session_figure(
        session.series,
        session.metadata.get("scene", "session"),
        section=sections.get(insertion_end(session.series)),
        tick_times=session.tick_times if len(session.tick_times) else None,
        time_step=float(session.metadata["tick_period"]),
        notes=note if session.complete else f"{note} The recording was cut off.",
    )


def film_rows(session: Session, frames: int) -> list[int]:
    """Return the rows of the series that a film shows, evenly spread between two resets."""
    from needle_sim_ros.session.run import insertion_end

    end = row_time(session, insertion_end(session.series))
    resets = [time for time, event in session.events if event.get("event") == "reset"]
    after = max((time for time in resets if time < end), default=-1)
    until = min((time for time in resets if time >= end), default=None)
    rows = [
        row
        for row in range(len(session.series))
        if after < row_time(session, row) and (until is None or row_time(session, row) <= until)
    ]
    spread = np.linspace(0, len(rows) - 1, min(frames, len(rows))).round().astype(int)
    return [rows[k] for k in spread]


def sections_of(session: Session, rows: Iterable[int] = ()) -> tuple[dict[int, Section], str]:
    """Simulate a session again and return its section at some rows of the series.

    Parameters
    ----------
    session : Session
        With a tick at least.
    rows : iterable of int
        Besides the end of the insertion, with no reset between them; see :func:`film_rows`.

    Returns
    -------
    dict of int to Section
        By row; empty where the session does not tell how to simulate it.
    str
        Where the section at the end of the insertion comes from, or why it is not there.
    """
    from needle_sim_ros.session.resimulate import resimulate, ticks_until
    from needle_sim_ros.session.run import insertion_end
    from needle_sim_ros.view.section import take_section

    end = insertion_end(session.series)
    wanted = {row_time(session, row): row for row in (*rows, end)}
    try:
        ticks = ticks_until(session, max(wanted.values()))
    except SessionError as error:
        return {}, f"No section: {error}."
    sections: dict[int, Section] = {}
    with progress(len(ticks), "simulating the session again") as bar:
        for tick, sim, observation in resimulate(session, ticks):
            bar.update()
            row = None if tick.log_time is None else wanted.get(tick.log_time)
            if row is not None:
                sections[row] = take_section(sim, observation)
            if row == end:
                tip = observation.tip_position
    apart = float(np.linalg.norm(tip - session.series.tip_position[end]))
    return sections, (
        "Section simulated again from the recorded scene and motion; its tip is "
        f"{1e6 * apart:.3g} µm from the recorded one."
    )


def row_time(session: Session, row: int) -> int:
    """Return the log time of a row of the series, ns."""
    return round(float(session.series.time[row]) * 1e9)


def _film(session: Session, sections: dict[int, Section], path: Path) -> None:
    from needle_sim_ros.view.film import make_film

    name = session.metadata.get("scene", "session")
    with progress(len(sections), f"drawing {path.name}", unit="frame") as bar:
        make_film(session.series, list(sections.values()), name, path, bar.update)
