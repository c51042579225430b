# SPDX-License-Identifier: Apache-2.0
"""What every benchmark returns: figures that others read, and a table for people."""

from __future__ import annotations

import itertools
import json
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from needle_sim_ros.plain import plain

Row = dict[str, Any]


@dataclass
class BenchmarkResult:
    """Figures and table of one benchmark run.

    Attributes
    ----------
    name : str
        Of the benchmark, ``speed`` for instance.
    scene : str
        Name of the scene it ran on.
    figures : dict
        From name to number, None where it was not measured. Errors are fractions, times
        of one run ratios; another unit stands at the end of the name.
    table : list of dict
        Rows; rows that follow each other with the same ``section`` are printed together.
    """

    name: str
    scene: str
    figures: dict[str, float | None] = field(default_factory=dict)
    table: list[Row] = field(default_factory=list)

    def to_json(self) -> str:
        """Return the JSON text; numbers that are not finite become null."""
        content = {
            "benchmark": self.name,
            "scene": self.scene,
            "figures": self.figures,
            "table": self.table,
        }
        return json.dumps(plain(content), indent=2, allow_nan=False) + "\n"

    def write_json(self, path: str | Path) -> None:
        """Write the JSON text to a file, whole or not at all."""
        path = Path(path)
        path.parent.mkdir(parents=True, exist_ok=True)
        partial = path.with_name(path.name + ".part")
        partial.write_text(self.to_json(), encoding="utf-8")
        partial.replace(path)

    def text(self) -> str:
        """Return the tables, section by section, and the figures below them."""
        parts = [f"benchmark {self.name}, scene {self.scene}"]
        for section, rows in itertools.groupby(self.table, lambda row: row.get("section")):
            bare = [{k: v for k, v in row.items() if k != "section"} for row in rows]
            parts.append((f"{section}\n" if section else "") + _aligned(bare))
        figures = [{"figure": name, "value": value} for name, value in self.figures.items()]
        parts.append(_aligned(figures))
        return "\n\n".join(parts) + "\n"


def _aligned(rows: Iterable[Row]) -> str:
    rows = list(rows)
    columns = list(dict.fromkeys(itertools.chain.from_iterable(rows)))
    cells = [columns, *([_cell(row.get(column)) for column in columns] for row in rows)]
    widths = [max(map(len, column)) for column in zip(*cells, strict=True)]
    numeric = [all(not isinstance(row.get(column), str) for row in rows) for column in columns]
    lines = (
        "  ".join(
            cell.rjust(width) if right else cell.ljust(width)
            for cell, width, right in zip(line, widths, numeric, strict=True)
        ).rstrip()
        for line in cells
    )
    return "\n".join(lines)


def _cell(value: Any) -> str:
    if value is None:
        return "-"
    if isinstance(value, (bool, np.bool_)):
        return "yes" if value else "no"
    if isinstance(value, (float, np.floating)):
        return f"{value:.4g}"
    return str(value)
