# SPDX-License-Identifier: Apache-2.0
"""A recorded session as figures and a picture, for ``plot`` and ``demo``."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from needle_sim_ros.commands.output import progress
from needle_sim_ros.errors import SessionError

if TYPE_CHECKING:
    from needle_sim_ros.session.reader import Session
    from needle_sim_ros.session.summary import Summary
    from needle_sim_ros.view.section import Section


def plot_session(bag: Path, output: Path) -> Summary:
    """Draw a session into a file and return its summary.

    Raises
    ------
    SessionError
        When the session cannot be read or holds no tick.
    """
    from needle_sim_ros.session.reader import read_session
    from needle_sim_ros.session.summary import summarise
    from needle_sim_ros.view.figure import session_figure
    from needle_sim_ros.view.files import save_figure

    session = read_session(bag)
    if not len(session.series):
        raise SessionError(f"{bag}: no tick was recorded")
    section, note = _section(session)
    name = session.metadata.get("scene", "session")
    notes = note if session.complete else f"{note} The recording was cut off."
    save_figure(session_figure(session.series, name, section=section, notes=notes), output)
    return summarise(session.series, float(session.metadata["tick_period"]))


def _section(session: Session) -> tuple[Section | None, str]:
    """Return the section at the end of the insertion, and where it comes from."""
    from needle_sim_ros.session.resimulate import resimulate, ticks_until
    from needle_sim_ros.session.run import insertion_end
    from needle_sim_ros.view.section import take_section

    tick = insertion_end(session.series)
    try:
        ticks = ticks_until(session, tick)
    except SessionError as error:
        return None, f"No section: {error}."
    with progress(len(ticks), "simulating the section again") as bar:
        sim, observation = resimulate(session, ticks, bar.update)
    apart = float(np.linalg.norm(observation.tip_position - session.series.tip_position[tick]))
    return take_section(sim, observation), (
        "Section simulated again from the recorded scene and motion; its tip is "
        f"{1e6 * apart:.3g} µm from the recorded one."
    )
