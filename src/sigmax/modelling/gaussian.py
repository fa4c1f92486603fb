"""The prior."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from sigmax.errors import InputError
from sigmax.modelling.checks import enough_memory, finite, is_traced, numbers, own, symmetric_semidefinite
from sigmax.views.words import measured, spread


@jax.tree_util.register_pytree_node_class
class Gaussian:
    """A normal distribution N(mean, cov), of one track or of a batch of them.

    Args:
        mean: (n,), or (B, n) for a batch.
        cov: covariance (n, n), or (B, n, n) for a batch; n variances (n,) stand for a diagonal matrix, the same for
            all tracks of a batch. Variances by track (B, n) are no covariance: a batch of its own needs (B, n, n).
            A variance of 0 means a component known exactly. Of curved parts, such as `rotation("attitude")`, it is the
            covariance of their deviations, which are fewer than the numbers of the mean.

    Raises:
        InputError: for shapes that do not fit, NaN, or a matrix that is no covariance.
    """

    mean: Any
    cov: Any

    def __init__(self, mean: Any, cov: Any) -> None:
        x, P = numbers("the mean", mean), numbers("the covariance", cov)
        if x.ndim not in (1, 2) or 0 in x.shape:
            raise InputError(
                f"a mean has the shape (n,), or (B, n) for a batch of B ≥ 1 tracks; this one has {x.shape}"
            )
        n = x.shape[-1]
        enough_memory(f"a prior of shape {x.shape}", x.size + P.size * 4.0)
        if (P.shape == (n,) and n > 1) or P.shape == (1,):
            P = jnp.diag(P) if isinstance(P, jax.Array) else np.diag(P)
        if P.ndim == 1 and 1 < len(P) < n:
            P = jnp.diag(P) if isinstance(P, jax.Array) else np.diag(P)
        square = P.ndim in (2, 3) and 0 < P.shape[-1] == P.shape[-2] <= n
        if not square or (P.ndim == 3 and x.ndim == 2 and len(P) != len(x)):
            shapes = [(n, n), (n,)] if x.ndim == 1 else [(len(x), n, n), (n, n), (n,)]
            raise InputError(
                f"a mean of shape {x.shape} needs a covariance of shape {' or '.join(map(str, shapes))}; "
                f"this one has {P.shape}"
            )
        finite("the mean", x)
        symmetric_semidefinite("the covariance", P)
        self.mean, self.cov = own(x), own(P)

    @classmethod
    def information(cls, y: Any, Y: Any) -> "Gaussian":
        """The same by its information pair, y = Y x and Y the inverse of the covariance, which may be singular.

        Where Y is regular this is N(Y⁻¹ y, Y⁻¹), for any filter. Where it is not, as with Y = 0, nothing is known along
        some directions: EIF and SREIF take it on linear models, exactly, and give NaN for what is still open; for all
        else there is `sigmax.start`.

        Args:
            y: (n,), or (B, n) for a batch.
            Y: (n, n), or (B, n, n); n numbers stand for a diagonal matrix.

        Raises:
            InputError: for shapes that do not fit, what is not positive semidefinite, and a y that is Y x of no x.
        """
        from sigmax.modelling.information import from_pair  # which is made of this class

        return from_pair(y, Y)

    @property
    def size(self) -> int:
        """Numbers of the mean."""
        return self.mean.shape[-1]

    @property
    def dim(self) -> int:
        """Rows of the covariance: as many, but for curved parts."""
        return self.cov.shape[-1]

    def __repr__(self) -> str:
        if not all(isinstance(a, np.ndarray | jax.Array) and not is_traced(a) for a in (self.mean, self.cov)):
            return f"Gaussian({self.mean}, {self.cov})"
        mean, P = np.atleast_2d(np.asarray(self.mean))[0], np.asarray(self.cov)
        P = P[0] if P.ndim == 3 else P
        tracks = f"{len(self.mean):,} tracks, the first: " if self.mean.ndim == 2 else ""
        std = np.sqrt(np.diag(P))
        # Of curved parts there are fewer deviations than numbers.
        alike = len(std) == len(mean)
        numbers = ", ".join(measured(float(m), float(std[i]) if alike else None) for i, m in enumerate(mean))
        apart = "" if alike else f"; deviations {', '.join(spread(float(s)) for s in std)}"
        return f"Gaussian({tracks}{numbers}{apart}{', correlated' if (np.diag(np.diag(P)) != P).any() else ''})"

    def tree_flatten(self) -> tuple[tuple[Any, Any], None]:
        """For JAX."""
        return (self.mean, self.cov), None

    @classmethod
    def tree_unflatten(cls, _: None, children: tuple[Any, Any]) -> "Gaussian":
        """For JAX: values pass unchecked."""
        return cls.unchecked(*children)

    @classmethod
    def unchecked(cls, mean: Any, cov: Any) -> "Gaussian":
        """A Gaussian of arrays as they are, which may be traced."""
        made = object.__new__(cls)
        made.mean, made.cov = mean, cov
        return made
