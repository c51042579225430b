# SPDX-License-Identifier: Apache-2.0
"""Every key of a scene with its unit, range and default, out of the schema itself."""

from __future__ import annotations

import dataclasses
import inspect
import typing
from collections.abc import Iterator
from typing import Any

from needle_sim_ros.scene import Scene
from needle_sim_ros.schema import keys


@dataclasses.dataclass(frozen=True)
class Section:
    """The keys of one level of a scene.

    Parameters
    ----------
    key : str
        Dotted key of the level; empty for the scene itself, ending in ``[]`` in a list.
    text : str
        What the level describes.
    rows : list of (str, str, str)
        Key, what it accepts, default.
    """

    key: str
    text: str
    rows: list[tuple[str, str, str]]


def sections(cls: type = Scene, key: str = "") -> Iterator[Section]:
    """Yield the levels of a scene, each before those below it."""
    hints = typing.get_type_hints(cls)
    accepted = keys(cls)
    rows, below = [], []
    for field in dataclasses.fields(cls):
        inner = _dataclass_in(hints[field.name])
        if inner is None:
            words = accepted[field.name]
            if _is_list(hints[field.name]) and not field.metadata.get("length"):
                words = f"list: {words}"
            rows.append((field.name, words, _default(field)))
        else:
            several = typing.get_origin(hints[field.name]) is tuple
            where = f"{key}.{field.name}" if key else field.name
            below.append((inner, f"{where}[]" if several else where))
    text = inspect.cleandoc(cls.__doc__ or "").split("\n\nRaises\n")[0]
    yield Section(key, text, rows)
    for inner, where in below:
        yield from sections(inner, where)


def markdown() -> str:
    """Return all sections as Markdown."""
    parts = []
    for section in sections():
        lines = [f"## {section.key or 'The scene'}", section.text, ""]
        if section.rows:
            lines += ["| key | value | default |", "|---|---|---|"]
            lines += [
                f"| `{name}` | {value} | {default} |" for name, value, default in section.rows
            ]
        parts.append("\n".join(lines).rstrip() + "\n")
    return "\n".join(parts)


def _dataclass_in(hint: Any) -> type | None:
    for part in (hint, *typing.get_args(hint)):
        if dataclasses.is_dataclass(part):
            return typing.cast(type, part)
    return None


def _is_list(hint: Any) -> bool:
    return any(typing.get_origin(part) is tuple for part in (hint, *typing.get_args(hint)))


def _default(field: dataclasses.Field[Any]) -> str:
    if field.default is dataclasses.MISSING:
        return "required"
    if field.default is None:
        return "null"
    if isinstance(field.default, bool):
        return str(field.default).lower()
    if isinstance(field.default, tuple):
        return f"[{', '.join(f'{entry:g}' for entry in field.default)}]"
    return f"{field.default:g}" if isinstance(field.default, float) else str(field.default)
