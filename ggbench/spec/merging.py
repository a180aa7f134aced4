"""Merging of tables with changes by a case, by the truth or by the model."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, TypeVar

from .aiding import KINDS
from .named_sensors import SIDES
from .presets import NOISES, replaced
from .tables import Section

S = TypeVar("S", bound=Section)


def laid_over(base: Mapping[str, Any], change: Mapping[str, Any]) -> dict[str, Any]:
    """Merge changes into the tables of a case.

    The short form ``[gnss]`` and the long form ``[sensor.gnss]`` are the same table. The result has
    the form that ``base`` has.
    """
    return merged(base, _written_as_in(base, change))


def _written_as_in(base: Mapping[str, Any], change: Mapping[str, Any]) -> dict[str, Any]:
    """Return a change with each sensor in the form, short or long, that ``base`` uses."""
    tables = dict(change)
    for side in SIDES:
        both = base.get(side), change.get(side)
        if all(isinstance(table, Mapping) for table in both):
            tables[side] = _written_as_in(base[side], change[side])
    sensors, of_base = change.get("sensor", {}), base.get("sensor", {})
    if not isinstance(sensors, Mapping) or not isinstance(of_base, Mapping):
        return tables
    sensors = dict(sensors)
    for kind in KINDS:
        if kind in tables and kind in sensors:
            continue  # a mistake, which validation finds
        if kind in tables and kind in of_base:
            sensors[kind] = tables.pop(kind)
        elif kind in sensors and kind in base:
            tables[kind] = sensors.pop(kind)
    return tables | {"sensor": sensors} if sensors or "sensor" in change else tables


def merged(base: Mapping[str, Any], change: Mapping[str, Any]) -> dict[str, Any]:
    """Merge ``change`` into ``base``, table by table.

    The gradiometer noise can be stated in several ways, for example as RMS or as density. A noise
    in ``change`` replaces a noise that ``base`` states in another way. If ``change`` has a preset,
    the keys of the preset are removed from ``base``.
    """
    result = {key: value for key, value in base.items() if key not in replaced(change)}
    for key, value in change.items():
        inner: Any = result.get(key)
        tables = isinstance(value, Mapping) and isinstance(inner, Mapping)
        result[key] = merged(inner, value) if tables else value
    of_disks, stated = "accelerometer_noise_ng_per_sqrt_hz", any(n in change for n in NOISES)
    disks, changed_disks = result.get("rotating"), change.get("rotating")
    by_disks = isinstance(changed_disks, Mapping) and of_disks in changed_disks
    if stated or by_disks:
        for noise in set(NOISES) - set(change):
            result.pop(noise, None)
    if stated and not by_disks and isinstance(disks, Mapping):
        result["rotating"] = {key: value for key, value in disks.items() if key != of_disks}
    return result


def changed(spec: S, change: Section) -> S:
    """Return the table ``spec`` with the changed keys of the table ``change``.

    Two kinds of keys of ``change`` are ignored: keys with default values, and keys that ``spec``
    does not have.

    Raises
    ------
    ValueError
        If the result breaks a rule of the table (raised by pydantic).
    """
    own = type(spec).model_fields.keys() - {"rotating"}
    explicit = {
        key: value for key, value in change.model_dump(exclude_defaults=True).items() if key in own
    }
    if not explicit:
        return spec
    return type(spec).model_validate(merged(spec.model_dump(exclude_unset=True), explicit))
