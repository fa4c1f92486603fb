"""Sensors that stand in each other's place, and places, given in the rows, that do."""

from collections.abc import Callable, Iterator
from dataclasses import replace
from itertools import combinations

import jax.numpy as jnp
import numpy as np

from sigmax.examination.envelope import Envelope, component_names, input_names
from sigmax.examination.record_data import Alternative, RecordData

# So many places may be given in the rows.
_PLACES = 12


def of_exchanged(family: Envelope, record: RecordData) -> Iterator[Alternative]:
    """Two sensors of the same components exchanged; two places exchanged that a sensor reads from its row."""
    found = [*_of_sensors(family), *_of_places(family, record)]
    for a in found:
        yield replace(a, cost=2.0 + float(np.log(len(found))))


def _of_sensors(family: Envelope) -> Iterator[Alternative]:
    alike = {s: [n.removeprefix(f"{s}.") for n in component_names(family.plain, s, m)] for s, m in family.sizes}
    for a, b in combinations(alike, 2):
        if alike[a] == alike[b] and family.plain.measured[a] == family.plain.measured[b]:
            yield _exchange(f"{a}, {b}", f"{a} and {b}", _values(a, b))


def _of_places(family: Envelope, record: RecordData) -> Iterator[Alternative]:
    u = record.u[:, : family.driven]
    columns = [i for i in range(family.driven) if 1 < len(np.unique(u[:, i])) <= _PLACES and _read(family, record, i)]
    names = ", ".join(input_names(family.plain, family.driven)[i] for i in columns)
    heard = np.isfinite(np.concatenate(list(record.z.values()), 1)).any(1)
    places = np.unique(u[heard][:, columns], axis=0) if columns else np.zeros((0, 0))
    if len(places) > _PLACES:
        return
    for p, q in combinations(places, 2):
        said = " and ".join(f"({', '.join(f'{x:.4g}' for x in one)})" for one in (p, q))
        yield _exchange(names, f"the places {said}", _rows(columns, p, q))


def _exchange(where: str, what: str, change: Callable[[RecordData], RecordData]) -> Alternative:
    return Alternative("swap", where, f"{what} stand in each other's place", "exchange them", change)


def _read(family: Envelope, record: RecordData, i: int) -> bool:
    """Whether a sensor reads an input, and the motion does not."""
    model, x, u = family.plain, jnp.asarray(record.mean), jnp.asarray(record.u[0])
    more = u.at[i].add(1.0)
    by_sensor = any((h(x, more) != h(x, u)).any() for s, h in model.sensors.items() if model.sensor_inputs[s])
    return by_sensor and not (model.motion_inputs and (model.motion(x, 1.0, more) != model.motion(x, 1.0, u)).any())


def _values(a: str, b: str) -> Callable[[RecordData], RecordData]:
    return lambda r: replace(r, z=r.z | {a: r.z[b], b: r.z[a]})


def _rows(columns: list[int], p: np.ndarray, q: np.ndarray) -> Callable[[RecordData], RecordData]:
    def change(r: RecordData) -> RecordData:
        u = r.u.copy()
        for one, other in ((p, q), (q, p)):
            rows = (r.u[:, columns] == one).all(1)
            u[np.ix_(rows, columns)] = other
        return replace(r, u=u)

    return change
