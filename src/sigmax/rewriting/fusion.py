"""Several sensors corrected together, as one: what the central filter of many sensors is."""

from collections.abc import Mapping
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np

from sigmax.algebra.arrays import TWO_PI, inner
from sigmax.algebra.factor import Diagonal, cholesky, inverse_lower
from sigmax.errors import InputError
from sigmax.modelling.checks import is_traced
from sigmax.modelling.model import Model, check_added, check_flat
from sigmax.modelling.noise import dense_noise


class Block(NamedTuple):
    """Sensors of the same function: their measurements are one, of less noise.

    Attributes:
        members: their names; one alone stays as it is.
        angular: which components are angles.
        given: whether the noise comes with every measurement rather than from the model.
    """

    members: tuple[str, ...]
    angular: tuple[bool, ...]
    given: bool


class Fused(NamedTuple):
    """One measurement out of many.

    Attributes:
        z: (..., M), the blocks one after the other.
        u: (..., k + e), the inputs and behind them the covariances of blocks whose noise is given; or None.
        disagreement: Σ (z_s − z_c)ᵀ R_s⁻¹ (z_s − z_c) (...), what the members of blocks differ by.
        components: how many components were put together beyond those that are left (...).
        volume: ½ (Σ log |R_s| − log |R_c|) (...).
    """

    z: Any
    u: Any
    disagreement: Any
    components: Any
    volume: Any


def fused(model: Model, *, messages: bool = False) -> Model:
    """The model with its sensors corrected together at each step rather than one after the other.

    Sensors with the same function (and bias) and a noise in numbers are put together before the correction,
    R_c = (Σ R_s⁻¹)⁻¹, z_c = R_c Σ R_s⁻¹ z_s, which is exact for every filter; all others are stacked, so
    that the errors of linearisation they share, Ω, are counted once and whole. `result.fusion` says which.
    Sensors that are missing, whole or in part, are left out; the order of sensors does not matter.

    Args:
        model: a model with several sensors, whose components are named. Make the fused one once: its
            functions are what a compiled filter is found by.
        messages: for measurements that come with their own noise: see `absorb`.

    Raises:
        InputError: where there is one sensor only, or one whose components are not named.
    """
    if not isinstance(model, Model):
        raise InputError(f"model must be a sigmax.Model, it is {type(model).__name__}")
    check_flat(model, "fusing sensors")
    check_added(model, "fusing sensors")
    if not model.several:
        raise InputError("a model with one sensor has nothing to fuse; give sensor= as a dict by name")
    blocks: list[Block] = []
    for s, names in model.measurement.items():
        if names is None:
            raise InputError(f"name the components of the sensor {s!r}: R is a function and does not count them")
        alike = next((i for i, b in enumerate(blocks) if _same(model, b.members[0], s)), None)
        if alike is None:
            blocks.append(Block((s,), model.measured_angular(s, len(names)), messages))
        else:
            blocks[alike] = Block((*blocks[alike].members, s), blocks[alike].angular, True)
    return model.with_parts(fusion=tuple(blocks))


def _same(model: Model, one: str, other: str) -> bool:
    """Whether two sensors can be put together: the same function, the same bias, noises that have an inverse."""
    kinds = [[type(name) for name in model.measurement[s] or ()] for s in (one, other)]
    if model.sensors[one] is not model.sensors[other] or kinds[0] != kinds[1]:
        return False
    F, G = ((None if model.bias is None else model.bias.sensor.get(s)) for s in (one, other))
    if F is not G and (F is None or G is None or callable(F) or callable(G) or not np.array_equal(F, G)):
        return False
    return all(_invertible(model.R[s]) for s in (one, other))


def _invertible(R: Any) -> bool:
    if callable(R) or is_traced(R):
        return False
    entries = np.asarray(R.entries) if isinstance(R, Diagonal) else np.linalg.eigvalsh(np.asarray(R))
    return bool((entries > 0).all())


def name_of(model: Model) -> str:
    """What the fused sensor is called."""
    return "+".join(s for block in model.fusion or () for s in block.members)


def inputs_behind(model: Model) -> int:
    """How many inputs the fused sensor reads behind those of the model: the covariances that come with z."""
    return sum(len(b.angular) ** 2 for b in model.fusion or () if b.given)


def chosen(model: Model, additive: bool) -> dict[str, str]:
    """How each sensor is fused, by name; `additive` where stacking is no more than a sum of contributions."""
    alone = "summed" if additive else "stacked"
    return {s: "compressed" if len(b.members) > 1 else alone for b in model.fusion or () for s in b.members}


def put_together(model: Model, z: Mapping[str, Any], u: Any) -> Fused:
    """Measurements by sensor (..., m), NaN or absent where there are none, as the one of the fused sensor."""
    array: Any = jnp if is_traced((z, u, model.R)) else np
    lead = np.broadcast_shapes(*(np.shape(v)[:-1] for v in z.values()))
    parts, noises, sums = [], [], [array.zeros(lead) for _ in range(3)]
    for block in model.fusion or ():
        m = len(block.angular)
        heard = [z.get(s, np.full(m, np.nan)) for s in block.members]
        values = array.stack([array.broadcast_to(v, (*lead, m)) for v in heard], -2)
        if not block.given:
            parts.append(values[..., 0, :])
            continue
        known = [dense_noise(model.R[s]) for s in block.members]
        one, R, *told = compressed(values, array.stack([array.asarray(R) for R in known]), block.angular, array)
        parts.append(one)
        noises.append(R.reshape(*lead, m * m))
        sums = [a + b for a, b in zip(sums, told, strict=True)]
    if noises:
        own = [] if u is None else [array.broadcast_to(u, (*lead, np.shape(u)[-1]))]
        u = array.concatenate([*own, *noises], -1)
    return Fused(array.concatenate(parts, -1), u, *sums)


def compressed(values: Any, R: Any, angular: tuple[bool, ...], array: Any = np) -> tuple[Any, Any, Any, Any, Any]:
    """One measurement of N of the same thing: z_c = R_c Σ R_s⁻¹ z_s, R_c = (Σ R_s⁻¹)⁻¹.

    Args:
        values: (..., N, m), NaN where missing.
        R: (N, m, m) their covariances.
        angular: which components are angles; differences of those are taken about the first that was seen.
        array: numpy or jax.numpy.

    Returns:
        z_c (..., m), NaN where nobody saw a component; R_c (..., m, m), 1 there; what they disagree by,
        how many components were merged, and ½ (Σ log |R_s| − log |R_c|), each (...).
    """
    m = len(angular)
    one = array.eye(m)
    seen = ~array.isnan(values)
    both = seen[..., :, None] & seen[..., None, :]
    inverse, volumes = _inverse(array.where(both, R, one), array)
    weight = array.where(both, inverse, 0.0)
    total = weight.sum(-3)
    missing = ~seen.any(-2)
    total = total + one * missing[..., None]
    Rc, gained = _inverse(total, array)
    Rc = (Rc + array.swapaxes(Rc, -1, -2)) / 2
    first = values[..., -1, :]
    for k in reversed(range(values.shape[-2])):
        first = array.where(seen[..., k, :], values[..., k, :], first)
    off = array.where(seen, values - first[..., None, :], 0.0)
    turns = array.where(array.asarray(angular), array.round(off / TWO_PI) * TWO_PI, 0.0)
    off = off - turns
    pulled = (weight @ off[..., None])[..., 0]
    middle = (Rc @ pulled.sum(-2)[..., None])[..., 0]
    rest = array.where(seen, off - middle[..., None, :], 0.0)
    disagreement = (rest * (weight @ rest[..., None])[..., 0]).sum((-1, -2))
    merged = seen.sum((-1, -2)) - (~missing).sum(-1)
    return first + middle, Rc, disagreement, merged, (volumes.sum(-1) + gained) / 2


def _inverse(M: Any, array: Any) -> tuple[Any, Any]:
    """M⁻¹ (..., m, m) and log |M| (...) of a covariance; where it is traced by operations that can be lowered."""
    if array is np:
        return np.linalg.inv(M), np.linalg.slogdet(M)[1]
    L, _ = cholesky(jnp.moveaxis(M, (-2, -1), (0, 1)))
    root = inverse_lower(L)
    volume = 2 * sum(jnp.log(L[i, i]) for i in range(len(L)))
    return jnp.moveaxis(inner(root, root), (0, 1), (-2, -1)), volume
