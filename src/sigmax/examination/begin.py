"""A prior that was made from a measurement begins elsewhere where that measurement is read in another way."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np

from sigmax.examination.envelope import Envelope
from sigmax.examination.variants import RecordData, shifted

# A start found so has its covariance times this: it stands where the first measurement after the prior was made.
_WIDER = 100.0


def begun(family: Envelope, sensor: str, record: RecordData) -> RecordData:
    """The record with a prior near the old one from which a sensor would see its first whole measurement.

    As many components move as the measurement tells of, by as few of their deviations as will do.
    """
    from scipy.optimize import least_squares

    z = record.z[sensor]
    whole = np.flatnonzero(np.isfinite(z).all(1))
    spread = np.sqrt(np.diag(record.cov))
    if not len(whole) or not spread.any():
        return record
    k = int(whole[0])
    model = family.plain
    u = (jnp.asarray(record.u[k]),) if model.sensor_inputs[sensor] else ()
    seen = jax.jit(model.sensors[sensor])
    space = model.measured_space(sensor, z.shape[1])
    size = np.where(space.periodic, 1.0, 1.0 if not space.flat else np.maximum(np.abs(z[k]), 1e-9))

    def miss(y: np.ndarray) -> np.ndarray:
        there = np.asarray(seen(jnp.asarray(shifted(model, record.mean, spread * y)), *u))
        return np.concatenate([space.difference(there, z[k]) / size, 1e-7 * y])

    with np.errstate(all="ignore"):
        start = miss(np.zeros(len(spread)))
        if not np.isfinite(start).all():
            return record
        found = least_squares(miss, np.zeros(len(spread)), diff_step=np.full(len(spread), 1e-4), max_nfev=60)
    if not np.isfinite(found.x).all():
        return record
    return replace(record, mean=shifted(model, record.mean, spread * found.x), cov=record.cov * _WIDER)
