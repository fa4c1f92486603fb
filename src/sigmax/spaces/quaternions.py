"""Unit quaternions (w, x, y, z), which turn vectors of the body into those of the world: no branches, smooth."""

from typing import Any

from sigmax.spaces.space import arrays

# Of a squared angle: below it a short series of sine and cosine is exact to rounding, with two derivatives.
_SMALL = 1e-6
# Of a squared angle: below it the functions of `stumpff` are series, as their closed forms cancel.
_CANCELS = 0.25
_TERMS = 7


def cross(a: Any, b: Any) -> Any:
    """The product a × b of vectors (3, ...)."""
    return arrays(a, b).stack([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])


def multiply(p: Any, q: Any) -> Any:
    """The quaternion p q (4, ...): what turns by q first, then by p."""
    a, b, c, d = p
    w, x, y, z = q
    return arrays(p, q).stack(
        [
            a * w - b * x - c * y - d * z,
            a * x + b * w + c * z - d * y,
            a * y - b * z + c * w + d * x,
            a * z + b * y - c * x + d * w,
        ]
    )


def conjugate(q: Any) -> Any:
    """The quaternion (4, ...) that turns back."""
    return arrays(q).stack([q[0], -q[1], -q[2], -q[3]])


def rotate(q: Any, v: Any) -> Any:
    """A vector v (3, ...) turned by a unit quaternion (4, ...)."""
    u = q[1:]
    t = 2.0 * cross(u, v)
    return v + q[0] * t + cross(u, t)


def exponential(r: Any) -> Any:
    """The unit quaternion (4, ...) that turns about the vector r (3, ...) by its length."""
    xp = arrays(r)
    t = squared(r)
    small = t < _SMALL
    half = 0.5 * xp.sqrt(xp.where(small, 1.0, t))
    cosine = xp.where(small, 1 - t / 8 * (1 - t / 48), xp.cos(half))
    sine = xp.where(small, 0.5 - t / 48 * (1 - t / 80), 0.5 * xp.sin(half) / half)
    return xp.stack([cosine, sine * r[0], sine * r[1], sine * r[2]])


def logarithm(q: Any) -> Any:
    """The vector (3, ...) about which a unit quaternion (4, ...) turns, its length the angle in [0, π]."""
    xp = arrays(q)
    q = q * xp.where(q[0] < 0, -1.0, 1.0).astype(q.dtype)
    return 2.0 * arc(q[1:], q[0]) * q[1:]


def arc(v: Any, w: Any) -> Any:
    """atan2(|v|, w) / |v| (...) of v (k, ...) and w (...), with |v|² + w² = 1 and v not 0 where w < 0."""
    xp = arrays(v, w)
    t = squared(v)
    small = (t < _SMALL) & (w > 0)
    length = xp.sqrt(xp.where(small, 1.0, t))
    near = xp.where(small, w, 1.0)
    b = xp.where(small, t, 0.0) / (near * near)
    return xp.where(small, (1 - b / 3 * (1 - b * (3 / 5))) / near, xp.arctan2(length, w) / length)


def squared(v: Any) -> Any:
    """|v|² (...) of v (k, ...)."""
    return sum((c * c for c in v[1:]), start=v[0] * v[0])


def of_unit_length(q: Any) -> Any:
    """A vector that is nearly of unit length, by one Newton step: rounding does not add up, and nothing is divided."""
    return q * (1.5 - 0.5 * squared(q))


def stumpff(t: Any) -> list[Any]:
    """Stumpff's c_k(t) = Σ (−t)ⁱ/(2i + k)!, k = 0 … 5, of a squared angle t (...): cos θ, sin θ/θ, (1 − cos θ)/θ²."""
    xp = arrays(t)
    small = t < _CANCELS
    b, far = xp.where(small, t, 0.0), xp.where(small, 1.0, t)
    angle = xp.sqrt(far)
    closed = [xp.cos(angle), xp.sin(angle) / angle]
    series = [_horner(b, 4), _horner(b, 5)]
    for k, start in ((2, 1.0), (3, 1.0), (4, 1 / 2), (5, 1 / 6)):
        closed.append((start - closed[k - 2]) / far)
    for inverse in (1 / 6, 1 / 2, 1.0, 1.0):
        series.insert(0, inverse - b * series[1])
    return [xp.where(small, *pair) for pair in zip(series, closed, strict=True)]


def _horner(t: Any, k: int) -> Any:
    factor, made = 1.0, 1.0
    for i in range(_TERMS - 1, 0, -1):
        made = 1 - t / ((2 * i + k) * (2 * i + k - 1)) * made
    for i in range(2, k + 1):
        factor /= i
    return factor * made


def left(d: Any, v: Any) -> Any:
    """J_l(δ) v, the left Jacobian of SO(3): v + (1 − cos θ)/θ² δ×v + (θ − sin θ)/θ³ δ×(δ×v) (Barfoot, (7.77))."""
    c = stumpff(squared(d))
    once = cross(d, v)
    return v + c[2] * once + c[3] * cross(d, once)


def left_back(d: Any, v: Any) -> Any:
    """J_l(δ)⁻¹ v: v − ½ δ×v + (1 − ½θ cot ½θ)/θ² δ×(δ×v) (Barfoot, (7.76)); of angles below 2π."""
    c = stumpff(0.25 * squared(d))
    once = cross(d, v)
    # 1 − c₀/c₁ of half the angle, with nothing that cancels.
    return v - 0.5 * once + 0.25 * (c[2] - c[3]) / c[1] * cross(d, once)
