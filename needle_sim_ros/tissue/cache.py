# SPDX-License-Identifier: Apache-2.0
"""What was prepared for a tissue, kept on disk for the next start of the same scene.

A file's name is a digest of everything that its numbers follow from, to the bit: the
matrices, the elimination, the library, the machine. A file that is damaged, or is none of
ours, is ignored with a warning and replaced.
"""

from __future__ import annotations

import contextlib
import hashlib
import logging
import os
import platform
import tempfile
import zipfile
from collections.abc import Mapping
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import scipy.sparse as sp

from needle_sim_ros.geometry import Vector

if TYPE_CHECKING:
    from needle_sim_ros.tissue.compliance import NodalCompliance
    from needle_sim_ros.tissue.factor import Factor
    from needle_sim_ros.tissue.mesh import Index
    from needle_sim_ros.tissue.model import TissueModel

VARIABLE = "NEEDLE_SIM_CACHE"
_FORMAT = "needle_sim_ros responses 1"
_NAMES = ("blocks", "read", "eigenvalues", "shapes")
_LIMIT = 2_000_000_000  # bytes of all files; the one used longest ago goes first
# the number of threads that a product is split into shows in its last bits
_THREADS = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS")

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Cache:
    """A folder of files, or none.

    Parameters
    ----------
    folder : Path or None
        None keeps and finds nothing.
    limit : int
        Bytes that all files together may take.
    """

    folder: Path | None
    limit: int = _LIMIT

    @classmethod
    def of_environment(cls) -> Cache:
        """Take ``NEEDLE_SIM_CACHE`` (``off`` or a folder), else the user's folder of caches."""
        wanted = os.environ.get(VARIABLE, "")
        if wanted.lower() in ("off", "0", "none"):
            return cls(None)
        if wanted:
            return cls(Path(wanted).expanduser())
        base = os.environ.get("XDG_CACHE_HOME", "")
        try:
            home = Path(base) if Path(base).is_absolute() else Path.home() / ".cache"
        except RuntimeError:  # no home
            return cls(None)
        return cls(home / "needle_sim_ros")

    def load(self, key: str) -> dict[str, Vector] | None:
        """Return what is stored under a key; None where nothing whole is."""
        path = self._path(key)
        if path is None or not path.is_file():
            return None
        try:
            with np.load(path, allow_pickle=False) as file:
                found = {name: np.asarray(file[name]) for name in (*_NAMES, "digest")}
        except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile) as error:
            log.warning("%s is damaged and will be replaced: %s", path, error)
            return None
        digest = str(found.pop("digest"))
        if digest != _digest(key, found):
            log.warning("%s is damaged and will be replaced: wrong digest", path)
            return None
        with contextlib.suppress(OSError):
            os.utime(path)  # used now
        return found

    def store(self, key: str, arrays: Mapping[str, Vector]) -> None:
        """Write arrays under a key, whole or not at all; a full disk is no error."""
        path = self._path(key)
        if path is None or sum(array.nbytes for array in arrays.values()) > self.limit:
            return
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            handle, name = tempfile.mkstemp(dir=path.parent, prefix=".new-", suffix=".npz")
        except OSError as error:
            log.warning("nothing is cached in %s: %s", path.parent, error.strerror)
            return
        try:
            with os.fdopen(handle, "wb") as file:
                whole = {name: np.ascontiguousarray(array) for name, array in arrays.items()}
                digest = np.array(_digest(key, whole))
                np.savez(file, digest=digest, **whole)  # type: ignore[arg-type]
            os.replace(name, path)
        except OSError as error:
            log.warning("%s is not cached: %s", path, error.strerror)
            Path(name).unlink(missing_ok=True)
            return
        self._evict(path)

    def _path(self, key: str) -> Path | None:
        return None if self.folder is None else self.folder / f"{key}.npz"

    def _evict(self, newest: Path) -> None:
        """Remove the files used longest ago until the rest fit; also what a crash left."""
        files = []
        for path in newest.parent.glob("*.npz"):
            try:
                about = path.stat()
            except OSError:  # another process was faster
                continue
            files.append((path == newest, about.st_mtime, about.st_size, path))
        size = sum(file[2] for file in files)
        for _, _, its, path in sorted(files)[:-1]:
            if size <= self.limit:
                return
            path.unlink(missing_ok=True)
            size -= its


def key_of(
    model: TissueModel,
    factor: Factor,
    compliance: NodalCompliance,
    planned: Index,
    modes: int,
) -> str:
    """Return the digest of everything that the prepared numbers follow from."""
    digest = hashlib.sha256()
    words = [
        _FORMAT,
        str(factor.library),
        *(f"{name} {version(name)}" for name in ("numpy", "scipy")),
        platform.python_version(),
        platform.machine(),
        platform.node(),
        str(os.cpu_count()),
        *(f"{name}={os.environ.get(name)}" for name in _THREADS),
        str(modes),
    ]
    digest.update("\n".join(words).encode())
    _add_matrix(digest, factor.matrix)
    _add_matrix(digest, compliance.reader_matrix)
    if modes:
        _add_matrix(digest, model.mass)
    for array in (factor.order, model.free, compliance.tiles.whole(planned)):
        _add(digest, np.zeros(0) if array is None else np.asarray(array))
    return digest.hexdigest()


def _add_matrix(digest: Any, matrix: sp.csr_array | sp.csr_matrix) -> None:
    for array in (matrix.indptr, matrix.indices, matrix.data):
        _add(digest, array)


def _add(digest: Any, array: Any) -> None:
    whole = np.ascontiguousarray(array)
    digest.update(f"{whole.dtype.str}{whole.shape}".encode())
    digest.update(whole.data if whole.size else b"")


def _digest(key: str, arrays: Mapping[str, Vector]) -> str:
    digest = hashlib.sha256(key.encode())
    for name in _NAMES:
        _add(digest, arrays[name])
    return digest.hexdigest()
