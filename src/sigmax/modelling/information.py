"""A prior by its information, which may leave directions of the state open."""

from typing import Any

import numpy as np

from sigmax.errors import InputError
from sigmax.modelling.checks import finite, is_traced, numbers, own, symmetric_semidefinite
from sigmax.modelling.gaussian import Gaussian


class Information(Gaussian):
    """What is known of a state where the information matrix is singular: made by `Gaussian.information`.

    Attributes:
        y: Y x (n,), or (B, n) for a batch.
        Y: the inverse of the covariance (n, n), or (B, n, n).
    """

    y: np.ndarray
    Y: np.ndarray

    def __init__(self, y: np.ndarray, Y: np.ndarray) -> None:
        self.y, self.Y = own(y), own(Y)

    def __getattr__(self, name: str) -> Any:
        # What nobody has foreseen asks for a mean or a covariance, and there is none.
        if name in ("mean", "cov"):
            raise InputError(
                "this prior's information is singular, so that it has no mean and no covariance. EIF and SREIF take it "
                "on linear models, in run and Live; for all else sigmax.start finds a prior in the first measurements"
            )
        raise AttributeError(name)

    @property
    def size(self) -> int:
        """Components of the state."""
        return int(self.y.shape[-1])

    @property
    def dim(self) -> int:
        """The same: it is for flat spaces."""
        return self.size

    def __repr__(self) -> str:
        Y = np.atleast_3d(self.Y) if self.Y.ndim == 3 else self.Y[None]
        ranks = [self.size - len(_open(one)) for one in Y]
        rank = f"{ranks[0]}" if min(ranks) == max(ranks) else f"{min(ranks)} to {max(ranks)}"
        tracks = f"{max(len(np.atleast_2d(self.y)), len(Y)):,} tracks, " if self.y.ndim == 2 or self.Y.ndim == 3 else ""
        return f"Gaussian.information({tracks}rank {rank} of {self.size})"


def from_pair(y: Any, Y: Any) -> Gaussian:
    """The prior of an information pair; the arguments and errors are those of `Gaussian.information`."""
    if is_traced((y, Y)):
        raise InputError("whether information is singular is seen in its numbers, and these are being traced")
    vector, matrix = np.asarray(numbers("y", y), float), np.asarray(numbers("Y", Y), float)
    if vector.ndim not in (1, 2) or 0 in vector.shape:
        raise InputError(f"y has the shape (n,), or (B, n) for a batch of B ≥ 1 tracks; this one has {vector.shape}")
    n = vector.shape[-1]
    if matrix.shape == (n,):
        matrix = np.diag(matrix)
    batches = {len(vector)} if vector.ndim == 2 else set()
    batches |= {len(matrix)} if matrix.ndim == 3 else set()
    if matrix.shape[-2:] != (n, n) or matrix.ndim > 3 or len(batches) > 1:
        raise InputError(f"y of shape {vector.shape} needs Y of shape {(n, n)}; this one has {matrix.shape}")
    finite("y", vector)
    symmetric_semidefinite("Y", matrix)
    pairs = [np.broadcast_to(a, (*batches, *a.shape[a.ndim - core :])) for a, core in ((vector, 1), (matrix, 2))]
    each = list(zip(pairs[0].reshape(-1, n), pairs[1].reshape(-1, n, n), strict=True))
    found = [_open(P) for _, P in each]
    for (v, P), nothing in zip(each, found, strict=True):
        _check_within(v, P, nothing)
    if any(map(len, found)):
        return Information(vector, matrix)
    scale = 1 / np.sqrt(np.einsum("...ii->...i", pairs[1]))
    cov = (
        np.linalg.inv(pairs[1] * scale[..., :, None] * scale[..., None, :]) * scale[..., :, None] * scale[..., None, :]
    )
    cov = (cov + np.swapaxes(cov, -1, -2)) / 2
    return Gaussian(np.einsum("...ij,...j->...i", cov, pairs[0]), cov)


def _open(Y: np.ndarray) -> np.ndarray:
    """Directions (k, n) of which Y (n, n) says nothing."""
    scale = np.sqrt(np.diag(Y))
    scale = np.where(scale > 0, scale, 1)
    values, vectors = np.linalg.eigh(Y / np.outer(scale, scale))
    return (vectors[:, values <= 8 * len(Y) * np.finfo(float).eps] / scale[:, None]).T


def _check_within(y: np.ndarray, Y: np.ndarray, nothing: np.ndarray) -> None:
    """Refuse y = Y x that no x has."""
    size = np.abs(nothing) @ np.abs(y)
    off = np.abs(nothing @ y) > 1e-9 * size
    if len(nothing) and off.any():
        k = int(np.argmax(off))
        raise InputError(
            f"no state x has Y x = y: along {np.round(nothing[k], 3).tolist()} Y is 0 and y is "
            f"{float(nothing[k] @ y):.3g}; take y = Y @ x"
        )
