# SPDX-License-Identifier: Apache-2.0
"""A CSV file of time and columns, as quantities in SI units."""

from __future__ import annotations

import csv
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from needle_sim_ros.errors import SceneError, SessionError
from needle_sim_ros.geometry import Vector
from needle_sim_ros.schema import build

_VECTORS = ("base_position", "base_force", "base_torque", "tip_position")
_FACTORS = {
    "s": {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "min": 60.0},
    "m": {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "um": 1e-6},
    "N": {"N": 1.0, "mN": 1e-3, "cN": 1e-2},
    "N m": {"N m": 1.0, "Nm": 1.0, "N mm": 1e-3, "Nmm": 1e-3, "mNm": 1e-3},
    "1": {"1": 1.0},
}
_HEADING = re.compile(r"^\s*(.+?)\s*(?:[\[(]\s*([^\])]+?)\s*[\])])?\s*$")  # "name [unit]"


@dataclass(frozen=True)
class Column:
    """Which column a quantity is in: its heading, its unit, and ``scale * value + offset``.

    `scale` is applied to the values in SI units, `offset` is in SI units.
    """

    column: str
    unit: str = ""
    scale: float = 1.0
    offset: float = 0.0


def quantity_unit(name: str) -> str:
    """Return the SI unit of a quantity.

    Raises
    ------
    SessionError
        When there is no such quantity.
    """
    head, _, rest = name.partition(".")
    if name == "time":
        return "s"
    if head == "base_orientation" and rest in ("x", "y", "z", "w"):
        return "1"
    if head in _VECTORS and rest in ("x", "y", "z"):
        return {"base_force": "N", "base_torque": "N m"}.get(head, "m")
    if head == "marker" and re.fullmatch(r"\d+\.[xyz]", rest):
        return "m"
    raise SessionError(
        f"quantity {name!r}: must be time, base_orientation.x to .w, marker.1.x and so on, or"
        f" .x .y .z of {', '.join(_VECTORS)}"
    )


def read_columns(path: Path | None, pairs: Sequence[str]) -> dict[str, Column]:
    """Read a YAML file of columns and ``QUANTITY=HEADING[:UNIT]`` pairs laid over it.

    Raises
    ------
    SessionError
        On what is no quantity or no column.
    """
    columns: dict[str, Column] = {}
    if path is not None:
        try:
            data: Any = yaml.safe_load(path.read_text(encoding="utf-8"))
        except (OSError, UnicodeDecodeError, yaml.YAMLError) as error:
            words = " ".join(str(error).split())
            raise SessionError(f"columns {path}: cannot be read: {words}") from None
        if not isinstance(data, Mapping):
            raise SessionError(f"columns {path}: must map quantities to columns")
        for name, value in data.items():
            entry = value if isinstance(value, Mapping) else {"column": str(value)}
            try:
                columns[str(name)] = build(Column, entry, str(name))
            except SceneError as error:
                raise SessionError(f"columns {path}: {error}") from None
    for pair in pairs:
        name, equals, rest = pair.partition("=")
        heading, _, unit = rest.rpartition(":") if ":" in rest else (rest, "", "")
        if not equals or not heading:
            raise SessionError(f"--column {pair}: must be QUANTITY=HEADING[:UNIT]")
        columns[name] = Column(heading, unit)
    for name in columns:
        quantity_unit(name)
    return columns


def read_table(path: Path, columns: Mapping[str, Column]) -> dict[str, Vector]:
    """Read quantities; without columns those whose headings are quantities, ``name [unit]``.

    Empty cells are NaN.

    Returns
    -------
    dict of ndarray, shape (n,)
        In SI units, ``time`` among them, ascending.

    Raises
    ------
    SessionError
        Naming the file and what is wrong with it.
    """
    headings, rows = _cells(path)
    chosen = dict(columns) or _by_headings(headings)
    if "time" not in chosen:
        raise SessionError(
            f"{path}: no column for the time: name it with --column time=HEADING;"
            f" its headings: {', '.join(headings)}"
        )
    found = {}
    for name, column in chosen.items():
        if column.column not in headings:
            raise SessionError(
                f"{path}: no column {column.column!r} for {name}; its headings:"
                f" {', '.join(headings)}"
            )
        own = _HEADING.match(column.column)
        unit = column.unit or (own[2] if own and own[2] else quantity_unit(name))
        factor = _factor(name, unit)
        index = headings.index(column.column)
        values = _numbers(path, rows, index, column.column)
        found[name] = column.scale * factor * values + column.offset
    _check_time(path, found["time"])
    return found


def _factor(name: str, unit: str) -> float:
    known = _FACTORS[quantity_unit(name)]
    if unit not in known:
        raise SessionError(f"unit {unit!r} of {name}: must be one of {', '.join(known)}")
    return known[unit]


def _cells(path: Path) -> tuple[list[str], list[list[str]]]:
    try:
        text = path.read_text(encoding="utf-8-sig")
    except OSError as error:
        raise SessionError(f"{path}: cannot be read: {error.strerror}") from None
    except UnicodeDecodeError as error:
        raise SessionError(
            f"{path}: not a CSV file: byte {error.start} is no text (UTF-8)"
        ) from None
    lines = [line for line in text.splitlines() if line.strip() and not line.startswith("#")]
    if len(lines) < 3:
        raise SessionError(f"{path}: must have a line of headings and at least two rows")
    separator = max(",;\t", key=lines[0].count)
    headings, *rows = csv.reader(lines, delimiter=separator)
    headings = [heading.strip() for heading in headings]
    for number, row in enumerate(rows, 1):
        if len(row) != len(headings):
            raise SessionError(
                f"{path}: row {number} has {len(row)} cells: must be {len(headings)}"
            )
    return headings, rows


def _by_headings(headings: list[str]) -> dict[str, Column]:
    found = {}
    for heading in headings:
        match = _HEADING.match(heading)
        name = match[1] if match else heading
        try:
            quantity_unit(name)
        except SessionError:
            continue
        found[name] = Column(heading, (match[2] or "") if match else "")
    return found


def _numbers(path: Path, rows: list[list[str]], index: int, heading: str) -> Vector:
    values = np.full(len(rows), np.nan)
    for k, row in enumerate(rows):
        cell = row[index].strip()
        try:
            values[k] = float(cell) if cell else np.nan
        except ValueError:
            raise SessionError(
                f"{path}: row {k + 1}, column {heading!r}: {cell!r} is not a number"
            ) from None
    return values


def _check_time(path: Path, time: Vector) -> None:
    if not np.isfinite(time).all():
        row = int(np.flatnonzero(~np.isfinite(time))[0]) + 1
        raise SessionError(f"{path}: row {row} has no time")
    back = np.flatnonzero(np.diff(time) <= 0)
    if len(back):
        k = int(back[0])
        raise SessionError(
            f"{path}: its times go backwards or stand still, from {time[k]:g} to"
            f" {time[k + 1]:g} s at row {k + 2}"
        )
