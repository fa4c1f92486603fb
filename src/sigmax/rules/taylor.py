"""Taylor rules: derivatives along the columns of the factor; no Jacobian or Hessian is ever formed."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import jax
import jax.numpy as jnp
import numpy as np

from sigmax.algebra.arrays import wrap
from sigmax.rules.linearization import Function, Linearization, slope_of


@dataclass(frozen=True)
class Taylor1:
    """First order: the rule of the extended Kalman filter. One evaluation and n derivatives."""

    # The line is that at x̂, however far S reaches.
    local: ClassVar[bool] = True

    def __call__(self, g: Function, x: jax.Array, S: jax.Array, angular: Sequence[bool]) -> Linearization:
        """ŷ = g(x̂), E_j = dg[s_j], nothing left over."""
        y, slope = slope_of(g, x, S)
        return Linearization(wrap(y, angular), slope, slope[:, :0], slope[:, :0])


@dataclass(frozen=True)
class Taylor2:
    """Second order: the rule of the polynomial filter (Stepanov et al., (18)-(22)).

    Exact for quadratic g. With h_ij = d²g[s_i, s_j] the mean gains ½ Σ h_jj, the covariance
    ½ Σ_ij h_ij h_ijᵀ. n(n+1)/2 second derivatives.

    Attributes:
        mean: keep the term of the mean (d in the paper).
        covariance: keep the term of the covariance (D in the paper); without it at the prediction
            the filter is the second-order filter SOKF.
    """

    mean: bool = True
    covariance: bool = True

    def __call__(self, g: Function, x: jax.Array, S: jax.Array, angular: Sequence[bool]) -> Linearization:
        """ŷ = g(x̂) + ½ Σ h_jj, E_j = dg[s_j], N = (h_ij for i < j, h_jj / √2)."""
        y, slope = slope_of(g, x, S)
        n = S.shape[1]
        i, j = (np.concatenate(pair) for pair in zip(np.triu_indices(n, 1), (np.arange(n),) * 2, strict=True))

        def along(v: jax.Array) -> jax.Array:
            def first(at: jax.Array) -> jax.Array:
                return jax.jvp(g, (at,), (v[0],))[1]

            return jax.jvp(first, (x,), (v[1],))[1]

        pairs = jnp.stack([S[:, i], S[:, j]])
        h = jax.vmap(along, in_axes=2, out_axes=1)(pairs)
        mixed, pure = h[:, : len(i) - n], h[:, len(i) - n :]
        mean = y + 0.5 * pure.sum(1) if self.mean else y
        residual = jnp.concatenate([mixed, pure * np.sqrt(0.5).astype(h.dtype)], axis=1)
        if not self.covariance:
            residual = residual[:, :0]
        return Linearization(wrap(mean, angular), slope, residual, slope[:, :0])
