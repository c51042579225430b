# SPDX-License-Identifier: Apache-2.0
"""Where the node may record: whoever can set its parameters cannot write anywhere else."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from needle_sim_ros.errors import SessionError
from needle_sim_ros.session.bag import Split


@dataclass(frozen=True)
class RecordFolder:
    """Folder for new sessions, inside one that was given when the node started.

    Parameters
    ----------
    root : Path
        Folder that no session leaves.
    folder : str
        Absolute, or relative to the working folder; empty is `root`.
    split : Split
        When a session goes on in another file.
    """

    root: Path
    folder: str
    split: Split

    def path(self) -> Path:
        """Return the folder, with links followed.

        Raises
        ------
        SessionError
            When it is not inside the root.
        """
        root = self.root.expanduser().resolve()
        path = Path(self.folder).expanduser().resolve() if self.folder else root
        if not path.is_relative_to(root):
            raise SessionError(f"record = {self.folder}: must be inside {root} (see record_root)")
        return path
