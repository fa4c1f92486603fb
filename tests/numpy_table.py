"""Functions of NumPy and `math` as people use them in models, each of x (3,)."""

import functools
import math

import numpy as np

A = np.array([[2.0, 0.3, 0.1], [0.2, 1.5, 0.4], [0.1, 0.3, 1.2]])
AT, TABLE = np.linspace(-5, 5, 11), np.sin(np.linspace(-5, 5, 11))


def assigned(x):
    y = np.zeros(3)
    y[:2] = x[:2]
    y[2] += x[2]
    return y


def by_mask(x):
    y = x.copy()
    y[y > 0] = 0
    return y


def another_name(x):
    y = x
    y += 1
    return x


def a_view(x):
    y = x[1:]
    y[0] = 5
    return x * 2


def matrix(x):
    F = np.eye(3)
    F[0, 1] = x[1]
    F[2] = x
    return F @ F.T @ x


def of_a_global(x):
    F = A.copy()
    F[0, 1] = x[1]
    return F @ x


def imported(x):
    from math import cos

    import numpy as other

    return other.array([cos(x[0])])


def unpacked(x):
    a, *b = x
    return np.array([a, *b])


FUNCTIONS = {
    "assign": assigned,
    "mask": by_mask,
    "view": another_name,
    "view2": a_view,
    "matrix": matrix,
    "local": imported,
    "unpack": unpacked,
    "interp": lambda x: np.interp(x, AT, TABLE),
    "interp1": lambda x: np.array([np.interp(x[0], AT, TABLE), np.interp(x[1], [0.0, 1.0], [2.0, 3.0])]),
    "clip": lambda x: np.clip(x, -0.5, 0.5),
    "clip2": lambda x: np.clip(x, a_min=0, a_max=1),
    "clipm": lambda x: x.clip(0, 1),
    "clip0": lambda x: np.array([np.clip(x[0], 0, 1)]),
    "maximum": lambda x: np.maximum(x, 0),
    "dot": lambda x: np.array([np.dot(x, x), x.dot(x), x @ x, np.vdot(x, x), np.inner(x, x)]),
    "inv": lambda x: np.linalg.inv(A + np.outer(x, x) * 0.01) @ x,
    "solve": lambda x: np.linalg.solve(A + np.diag(x**2), x),
    "det": lambda x: np.array([np.linalg.det(A + np.diag(x**2))]),
    "norm": lambda x: np.array([np.linalg.norm(x), np.linalg.norm(x[:2]), np.linalg.norm([x[0], 1.0])]),
    "norm1": lambda x: np.array([np.linalg.norm(x, 1), np.linalg.norm(x, np.inf)]),
    "norm_axis": lambda x: np.linalg.norm(A - x, axis=1),
    "cross": lambda x: np.cross(x, [1.0, 2.0, 3.0]),
    "cross2": lambda x: np.cross(x, x[::-1]),
    "concat": lambda x: np.concatenate([x, x[:1] * 2]),
    "hstack": lambda x: np.hstack([x, 1.0, x[0]]),
    "vstack": lambda x: np.vstack([x, x**2]).T.ravel(),
    "stack": lambda x: np.stack([x[0], x[1]]),
    "eye": lambda x: np.eye(3) @ x,
    "outer": lambda x: np.outer(x, x).sum(0),
    "sumf": lambda x: np.array(
        [np.sum(x), np.mean(x), np.prod(x), x.sum(), x.mean(), x.prod(), x.max(), x.min(), x.std(), np.var(x)]
    ),
    "cumsum": lambda x: np.cumsum(x),
    "cumprod": lambda x: np.cumprod(x),
    "cummax": lambda x: np.maximum.accumulate(x),
    "deg2rad": lambda x: np.deg2rad(x) + np.rad2deg(x) + np.radians(x) + np.degrees(x),
    "mod": lambda x: np.mod(x + np.pi, 2 * np.pi) - np.pi,
    "pct": lambda x: (x + np.pi) % (2 * np.pi),
    "remainder": lambda x: np.remainder(x, 0.7) + np.fmod(x, 0.7),
    "arctan2": lambda x: np.array([np.arctan2(x[1], x[0]), np.hypot(x[0], x[1])]),
    "mathf": lambda x: np.array(
        [
            math.cos(x[0]),
            math.atan2(x[0], x[1]),
            math.sqrt(x[0] ** 2),
            math.exp(x[0]),
            math.hypot(x[0], x[1]),
            math.pi,
            math.degrees(x[0]),
            math.fabs(x[0]),
            math.tanh(x[0]),
            math.pow(abs(x[0]), 1.5),
            math.log(abs(x[0])),
            math.log(abs(x[0]), 2),
            math.erf(x[0]),
            math.floor(x[0]),
            math.fmod(x[0], 0.3),
        ]
    ),
    "sign": lambda x: np.sign(x) + np.abs(x) + abs(x) + np.fabs(x) + np.square(x) + np.cbrt(x),
    "floor": lambda x: np.floor(x) + np.ceil(x) + np.round(x, 1) + np.rint(x) + np.trunc(x) + np.fix(x),
    "explog": lambda x: (
        np.exp(x)
        + np.log(np.abs(x))
        + np.log1p(np.abs(x))
        + np.expm1(x)
        + np.log10(np.abs(x))
        + np.log2(np.abs(x))
        + np.exp2(x)
    ),
    "hyper": lambda x: np.sinh(x) + np.cosh(x) + np.tanh(x) + np.arcsinh(x),
    "power": lambda x: np.power(x, 2) + x**3 + x**2.0 + np.abs(x) ** 0.5 + 2**x + np.float_power(np.abs(x), 1.5),
    "reshape": lambda x: x.reshape(3, 1)[:, 0] + x[:, None].ravel() + x.flatten(),
    "T": lambda x: (A @ x[:, None]).T[0],
    "einsum": lambda x: np.einsum("ij,j->i", A, x),
    "kron": lambda x: np.kron(np.eye(2), [[1, x[0]], [0, 1]]) @ np.ones(4),
    "diag": lambda x: np.diag(x) @ x + np.diag([x[0], 1.0, 2.0]) @ x,
    "trace": lambda x: np.array([np.trace(np.outer(x, x)), np.outer(x, x).trace()]),
    "tensordot": lambda x: np.tensordot(A, x, 1),
    "matmul": lambda x: np.matmul(A, x),
    "polyval": lambda x: np.polyval([1.0, 2.0, 3.0], x),
    "diff": lambda x: np.diff(x),
    "roll": lambda x: np.roll(x, 1) + np.flip(x) + x[::-1],
    "tile": lambda x: np.tile(x, 2),
    "repeat": lambda x: np.repeat(x, 2),
    "append": lambda x: np.append(x, 1.0),
    "insert": lambda x: np.insert(x, 1, 0.5),
    "delete": lambda x: np.delete(x, 0),
    "split": lambda x: np.split(x, 3)[1],
    "atleast": lambda x: np.atleast_1d(x[0]),
    "atleast2": lambda x: np.atleast_2d(x)[0],
    "squeeze": lambda x: np.squeeze(x[None]),
    "full": lambda x: np.full(3, x[0]),
    "zeros_like": lambda x: np.zeros_like(x) + x + np.ones_like(x) + np.full_like(x, x[1]),
    "block": lambda x: np.block([[A, x[:, None]]]).sum(1),
    "isnan": lambda x: np.where(np.isnan(x), 0.0, x),
    "logical": lambda x: np.where(np.logical_and(x > 0, x < 1), 1.0, x),
    "amp": lambda x: np.where((x > 0) & ~(x > 1) | (x < -1), 1.0, x),
    "select": lambda x: np.select([x < 0, x < 1], [-x, x**2], 7.0),
    "piecewise": lambda x: np.heaviside(x, 0.5),
    "sinc": lambda x: np.sinc(x),
    "unwrap": lambda x: np.unwrap(x),
    "angle": lambda x: np.nan_to_num(x),
    "sort": lambda x: np.sort(x),
    "median": lambda x: np.array([np.median(x), np.ptp(x), np.amax(x), np.amin(x)]),
    "average": lambda x: np.array([np.average(x, weights=[1.0, 2.0, 3.0])]),
    "trapz": lambda x: np.array([np.trapezoid(x, dx=0.1)]),
    "convolve": lambda x: np.convolve(x, [1.0, 2.0]),
    "dotm": lambda x: A.dot(x) + np.dot(A, x),
    "linspace": lambda x: np.linspace(0, 1, 3) * x + np.arange(3) * x,
    "pinv": lambda x: np.linalg.pinv(A + np.diag(x**2)) @ x,
    "chol": lambda x: np.linalg.cholesky(A @ A.T + np.diag(x**2)) @ x,
    "mpow": lambda x: np.linalg.matrix_power(A, 2) @ x,
    "mpow2": lambda x: np.linalg.matrix_power(A + np.diag(x), 2) @ x,
    "any": lambda x: np.where(np.any(x > 1), x, -x),
    "allc": lambda x: np.where((x > 0).all(), x, -x),
    "copysign": lambda x: np.copysign(x, -1.0) + math.copysign(2.0, x[0]),
    "sin": lambda x: np.sin(x) + np.cos(x) + np.tan(x) + np.arctan(x) + np.arcsin(np.tanh(x)) + np.arccos(np.tanh(x)),
    "negative": lambda x: -x + +x + np.negative(x) + np.positive(x) + np.reciprocal(x) + 1 / x,
    "divmod": lambda x: np.divmod(x, 0.7)[1] + divmod(x[0], 0.7)[0],
    "minimum.reduce": lambda x: np.array([np.minimum.reduce(x), np.add.reduce(x)]),
    "outerop": lambda x: np.subtract.outer(x, x)[0],
    "f64": lambda x: np.array([np.float64(2) * x[0], np.float64(2) - x[0], np.pi * x[0]]),
    "round": lambda x: np.array([round(x[0], 1), abs(x[0]), x[0].round(2), round(x[1])]),
    "copy": lambda x: np.copy(x) + np.array(x) + np.asarray(x) + x.astype(float),
    "nested": lambda x: np.array([[x[0], 1], [0, x[1]]]) @ x[:2],
    "out": lambda x: np.add(x, 1.0, out=np.zeros(3)),
    "meshgrid": lambda x: np.meshgrid(x, x)[0][0],
    "triu": lambda x: np.triu(np.outer(x, x)).sum(0) + np.tril(np.outer(x, x)).sum(1),
    "expand": lambda x: np.expand_dims(x, 0)[0] + np.moveaxis(x[None], 0, 1)[:, 0],
    "broadcast": lambda x: np.broadcast_to(x, (2, 3)).sum(0),
    "gradient": lambda x: np.gradient(x),
    "logaddexp": lambda x: np.logaddexp(x, 0),
    "hypot3": lambda x: np.sqrt(np.sum((x - np.array([1.0, 2.0, 3.0])) ** 2)) * np.ones(1),
    "norm_mat": lambda x: np.array([np.linalg.norm(np.outer(x, x))]),
    "eig": lambda x: np.linalg.eigvalsh(A + A.T + np.diag(x**2)),
    "lstsq": lambda x: np.linalg.lstsq(A + np.diag(x**2), x, rcond=None)[0],
    "qr": lambda x: np.abs(np.linalg.qr(A + np.diag(x**2))[1]).sum(0),
    "fftr": lambda x: np.abs(np.fft.fft(x)),
    "where": lambda x: np.where(x > 0, x, 2 * x),
    "r_": lambda x: np.r_[x[:2], 1.0],
    "c_": lambda x: np.c_[x, x * 2].ravel(),
    "max and min": lambda x: np.array([max(x[0], 0.1), min(x[1], x[2]), max(x)]),
    "float": lambda x: np.array([float(x[0])]),
    "list": lambda x: [v * 2 for v in x],
    "sum": lambda x: np.array([sum(x), sum(v * v for v in x)]),
    "whole numbers": lambda x: np.array([1, 2, 3]) * x / 2 + x // 1,
    "enumerate": lambda x: np.array([i * v for i, v in enumerate(x)]),
    "argmin": lambda x: np.array([TABLE[np.argmin(x)]]),
    "a copy of a global": of_a_global,
    "reduce": lambda x: np.array([functools.reduce(np.hypot, x)]),
}
# What JAX has no scalar operations for: XLA alone runs these.
XLA_ALONE = ("sort", "median", "convolve", "pinv", "eig", "lstsq", "qr", "fftr", "copysign")
