"""Random functions in plain NumPy, drawn from a seed: what people write between a state and what is seen of it."""

import numpy as np

ONE = (np.sin, np.cos, np.tanh, np.arctan, np.exp, np.abs, np.square, np.sqrt, np.log1p, np.deg2rad, np.sign, np.floor)
TWO = (np.add, np.subtract, np.multiply, np.hypot, np.arctan2, np.maximum, np.minimum, np.copysign, np.mod)
WHOLE = (np.sum, np.mean, np.prod, np.max, np.min, np.linalg.norm, np.std)


def drawn(seed):
    """A function x (4,) -> (m,), and the steps it takes, for messages."""
    rng = np.random.default_rng(seed)
    steps = [STEPS[k] for k in rng.integers(len(STEPS), size=rng.integers(3, 9))]
    numbers = rng.normal(size=(len(steps), 16))
    places = rng.integers(0, 1 << 30, size=(len(steps), 4))

    def function(x):
        y = np.array([x[0], x[1] * 0.5, x[2] - x[3], 0.3])
        for step, c, k in zip(steps, numbers, places, strict=True):
            y = step(y, x, c, k)
            y = np.clip(y, -30.0, 30.0)
        return y

    return function, [step.__name__ for step in steps]


def one(y, x, c, k):
    f = ONE[k[0] % len(ONE)]
    return f(np.abs(y) * 0.3 if f in (np.exp, np.sqrt, np.log1p) else y)


def two(y, x, c, k):
    f = TWO[k[0] % (len(TWO) - 2)]
    return f(y, x * c[0] + c[1] + 0.1)


def wrapped(y, x, c, k):
    return np.mod(y + np.pi, 2 * np.pi) - np.pi


def whole(y, x, c, k):
    return y * 0.5 + WHOLE[k[0] % len(WHOLE)](np.tanh(y) + c[:4])


def matrix(y, x, c, k):
    F = np.eye(4)
    F[k[0] % 4, k[1] % 4] = x[k[2] % 4]
    F[k[3] % 4] += c[:4] * 0.1
    return F @ y


def product(y, x, c, k):
    return c.reshape(4, 4) @ np.tanh(y) + np.outer(x, y)[k[0] % 4] * 0.1


def assigned(y, x, c, k):
    z = np.zeros(4)
    z[k[0] % 4 :] = y[k[0] % 4 :]
    z[k[1] % 4] += np.dot(x, y) * 0.1
    z[::2] *= c[0]
    return z


def view(y, x, c, k):
    z = y.copy()
    part = z[1:3]
    part += c[:2]
    part[0] = x[0]
    return z


def chosen(y, x, c, k):
    return np.where((y > c[0]) & (x < c[1]), y, x * c[2])


def masked(y, x, c, k):
    z = y.copy()
    z[y > c[0]] = c[1]
    return z


def table(y, x, c, k):
    return np.interp(y, np.linspace(-3, 3, 7), c[:7])


def stacked(y, x, c, k):
    return np.concatenate([y[2:], [x[0], c[0]]]) if k[0] % 2 else np.hstack([np.vstack([y[:2], x[:2]]).T.ravel()])


def solved(y, x, c, k):
    A = 3 * np.eye(2) + np.outer(np.tanh(x[:2]), np.tanh(y[:2]))
    z = np.linalg.solve(A, y[:2]) if k[0] % 2 else np.linalg.inv(A) @ y[2:]
    return np.append(z, [np.linalg.det(A), x[3]])


def loop(y, x, c, k):
    for i in range(3):
        y = y + 0.1 * np.array([y[1], -y[0], c[i] * y[3], np.sin(y[2])])
    return y


def turned(y, x, c, k):
    return np.append(np.cross(y[:3], x[1:]), y[3]) if k[0] % 2 else np.roll(y[::-1], k[1] % 4) + np.cumsum(x)


def extremes(y, x, c, k):
    return np.array([max(y[0], x[0], c[0]), min(y[1], c[1]), abs(y[2]), max(y)])


STEPS = (one, two, wrapped, whole, matrix, product, assigned, view, chosen, masked, table, stacked, solved, loop)
STEPS += (turned, extremes)
