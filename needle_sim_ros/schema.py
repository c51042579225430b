# SPDX-License-Identifier: Apache-2.0
"""Typed, validated, frozen dataclasses out of plain mappings, and back.

A field declares its unit and its admissible range in its metadata, through
:func:`quantity`. :func:`build` walks a mapping along the type hints and raises
:class:`~needle_sim_ros.errors.SceneError` with the dotted key of what is wrong.
"""

from __future__ import annotations

import dataclasses
import difflib
import math
import types
import typing
from collections.abc import Mapping
from typing import Any, TypeVar

from needle_sim_ros.errors import SceneError

T = TypeVar("T")


def quantity(
    default: Any = dataclasses.MISSING,
    *,
    unit: str = "1",
    gt: float | None = None,
    ge: float | None = None,
    lt: float | None = None,
    le: float | None = None,
    length: tuple[int, ...] | None = None,
    factory: Any = dataclasses.MISSING,
) -> Any:
    """Declare a dataclass field with a unit and admissible bounds (per entry for tuples)."""
    metadata = {"unit": unit, "gt": gt, "ge": ge, "lt": lt, "le": le, "length": length}
    return dataclasses.field(default=default, default_factory=factory, metadata=metadata)


def build(cls: type[T], data: object, key: str = "") -> T:
    """Build the dataclass `cls` from a mapping.

    Parameters
    ----------
    cls : type
        A frozen dataclass whose fields were declared with :func:`quantity` or plainly.
    data : object
        Usually what a YAML loader returned.
    key : str
        Dotted key of `data`, for messages.

    Raises
    ------
    SceneError
        On unknown or missing keys, wrong types, non-finite or inadmissible values.
    """
    if not isinstance(data, Mapping):
        raise SceneError(key or "scene", data, "must be a mapping of keys to values")
    hints = typing.get_type_hints(cls)
    fields = {f.name: f for f in dataclasses.fields(cls)}  # type: ignore[arg-type]
    for name in data:
        if name not in fields:
            near = difflib.get_close_matches(str(name), fields, n=1)
            hint = f"; did you mean {near[0]!r}?" if near else ""
            raise SceneError(
                _join(key, str(name)),
                data[name],
                f"unknown key; allowed here: {', '.join(sorted(fields))}{hint}",
            )
    values: dict[str, Any] = {}
    for name, spec in fields.items():
        where = _join(key, name)
        if name in data:
            values[name] = _convert(hints[name], data[name], where, spec.metadata)
        elif spec.default is dataclasses.MISSING and spec.default_factory is dataclasses.MISSING:
            raise SceneError(where, None, f"required, {_expected(hints[name], spec.metadata)}")
    return cls(**values)


def plain(value: Any) -> Any:
    """Turn a dataclass tree into mappings, lists and scalars that YAML can carry."""
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return {f.name: plain(getattr(value, f.name)) for f in dataclasses.fields(value)}
    if isinstance(value, (tuple, list)):
        return [plain(v) for v in value]
    return value


def keys(cls: type, prefix: str = "") -> dict[str, str]:
    """Return every dotted key below `cls` with the unit and range it accepts."""
    hints = typing.get_type_hints(cls)
    found: dict[str, str] = {}
    for spec in dataclasses.fields(cls):
        hint, where = hints[spec.name], _join(prefix, spec.name)
        inner = [a for a in (hint, *_walk(hint)) if dataclasses.is_dataclass(a)]
        if inner:
            sequence = typing.get_origin(hint) is tuple
            found.update(keys(typing.cast(type, inner[0]), where + "[]" if sequence else where))
        else:
            found[where] = _expected(hint, spec.metadata)
    return found


def _walk(hint: Any) -> list[Any]:
    found = []
    for argument in typing.get_args(hint):
        found += [argument, *_walk(argument)]
    return found


def _join(key: str, name: str) -> str:
    return f"{key}.{name}" if key else name


def _convert(hint: Any, value: Any, key: str, meta: Mapping[str, Any]) -> Any:
    origin = typing.get_origin(hint)
    if origin in (typing.Union, types.UnionType):
        if value is None and type(None) in typing.get_args(hint):
            return None
        (inner,) = [a for a in typing.get_args(hint) if a is not type(None)]
        return _convert(inner, value, key, meta)
    if origin is typing.Literal:
        return _choice(typing.get_args(hint), value, key)
    if dataclasses.is_dataclass(hint):
        return build(typing.cast(type, hint), value, key)
    if origin is tuple:
        return _sequence(hint, value, key, meta)
    if hint is bool:
        if not isinstance(value, bool):
            raise SceneError(key, value, "must be true or false")
        return value
    if hint is str:
        if not isinstance(value, str) or not value:
            raise SceneError(key, value, "must be a non-empty text")
        return value
    return _number(hint, value, key, meta)


def _choice(choices: tuple[Any, ...], value: Any, key: str) -> Any:
    if isinstance(value, bool) or value not in choices:
        raise SceneError(key, value, f"must be one of {', '.join(map(str, choices))}")
    return value


def _sequence(hint: Any, value: Any, key: str, meta: Mapping[str, Any]) -> tuple[Any, ...]:
    if isinstance(value, (str, Mapping)) or not hasattr(value, "__iter__"):
        raise SceneError(key, value, f"must be a list, {_expected(hint, meta)}")
    entries = list(value)
    inner = typing.get_args(hint)[0]
    lengths = meta.get("length")
    nested = typing.get_origin(inner) is tuple
    if lengths and not nested and len(entries) not in lengths:
        allowed = " or ".join(map(str, lengths))
        raise SceneError(key, value, f"must have {allowed} entries, has {len(entries)}")
    return tuple(_convert(inner, v, f"{key}[{i}]", meta) for i, v in enumerate(entries))


def _number(hint: Any, value: Any, key: str, meta: Mapping[str, Any]) -> float | int:
    expected = _expected(hint, meta)
    if isinstance(value, str):  # YAML 1.1 reads 15e3 as text
        try:
            value = float(value)
        except ValueError:
            raise SceneError(key, value, f"must be {expected}") from None
    if isinstance(value, bool) or value is None:
        raise SceneError(key, value, f"must be {expected}")
    try:
        number = float(value)
    except (TypeError, ValueError, OverflowError):
        raise SceneError(key, value, f"must be {expected}") from None
    inside = (
        math.isfinite(number)
        and (meta.get("gt") is None or number > meta["gt"])
        and (meta.get("ge") is None or number >= meta["ge"])
        and (meta.get("lt") is None or number < meta["lt"])
        and (meta.get("le") is None or number <= meta["le"])
    )
    if not inside or (hint is int and number != int(number)):
        raise SceneError(key, value, f"must be {expected}")
    return int(number) if hint is int else number


def _expected(hint: Any, meta: Mapping[str, Any]) -> str:
    choices = [a for a in (hint, *_walk(hint)) if typing.get_origin(a) is typing.Literal]
    if choices:
        return "one of " + ", ".join(map(str, typing.get_args(choices[0])))
    kinds = {hint, *_walk(hint)}
    if str in kinds:
        return "a text"
    if bool in kinds:
        return "true or false"
    words = "a whole number" if int in kinds else "a finite number"
    signs = (("gt", ">"), ("ge", ">="), ("lt", "<"), ("le", "<="))
    bounds = [f"{sign} {meta[name]:g}" for name, sign in signs if meta.get(name) is not None]
    if bounds:
        words += " " + " and ".join(bounds)
    unit = meta.get("unit", "1")
    if unit != "1":
        words += f", in {unit}"
    if meta.get("length"):
        words += f" ({' or '.join(map(str, meta['length']))} of them)"
    return words
