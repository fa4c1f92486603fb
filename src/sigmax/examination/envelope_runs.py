"""Runs of the envelope: many parameters and changed records in one batch, and what their innovations say."""

import warnings
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from sigmax.engine import native_engine, xla_engine
from sigmax.engine.backend import attempt
from sigmax.examination.envelope import Envelope
from sigmax.examination.record_data import RecordData
from sigmax.filters import Filter
from sigmax.modelling.gaussian import Gaussian
from sigmax.modelling.model import Model
from sigmax.preparation.prepare import Prepared, prepare
from sigmax.results.result import Result

# Numbers of inputs that one batch may hold, 8 bytes each.
_MOST = 4e7
_KEPT = frozenset({"fault", "innovation"})


class Variant(NamedTuple):
    """Parameters (p,) on a record."""

    theta: np.ndarray
    record: RecordData


class Innovations(NamedTuple):
    """Innovations of B variants: by sensor ν (B, T, m) and S (B, T, m, m); where nothing was seen ν = 0 and S = 1.

    Attributes:
        nu: innovations.
        S: their covariances.
        seen: which values were there, by sensor (T, m) of the first variant.
        sound: whether no step failed, (B,).
        first_fault: the fault of the first step that failed, in words, of the first variant; empty where none did.
    """

    nu: dict[str, np.ndarray]
    S: dict[str, np.ndarray]
    seen: dict[str, np.ndarray]
    sound: np.ndarray
    first_fault: str

    def some(self, which: slice) -> "Innovations":
        """Of some of the variants."""
        nu, S = ({s: a[which] for s, a in arrays.items()} for arrays in (self.nu, self.S))
        return self._replace(nu=nu, S=S, sound=self.sound[which])

    def nis(self) -> dict[str, np.ndarray]:
        """ν' S⁻¹ ν by sensor, (B, T)."""
        return {s: _nis(v, self.S[s]) for s, v in self.nu.items()}


class Runner:
    """A filter on an envelope."""

    def __init__(self, filter: Filter, family: Envelope, update_first: bool) -> None:
        self.filter, self.family, self.update_first = filter, family, update_first
        kinds = [p.kind for p in family.parameters]
        self.of_prior = [i for i, kind in enumerate(kinds) if kind == "prior"]
        self.skews = [i for i, kind in enumerate(kinds) if kind == "skew"]
        self.late = kinds.index("input delay") if "input delay" in kinds else None
        self._ready: Prepared | None = None
        self._room = np.empty(0)

    def __call__(self, variants: Sequence[Variant]) -> Innovations:
        """All variants, in batches that fit the memory."""
        T = len(variants[0].record.dt)
        width = self.family.given + self.family.driven + len(self.family.parameters) + self.family.measured + 1
        size = max(1, int(_MOST // (T * width)))
        parts = [self._batch(variants[i : i + size]) for i in range(0, len(variants), size)]
        if len(parts) == 1:
            return parts[0]
        first = parts[0]
        return Innovations(
            {s: np.concatenate([p.nu[s] for p in parts]) for s in first.nu},
            {s: np.concatenate([p.S[s] for p in parts]) for s in first.S},
            first.seen,
            np.concatenate([p.sound for p in parts]),
            first.first_fault,
        )

    def estimates(self, variants: Sequence[Variant]) -> tuple[np.ndarray, np.ndarray]:
        """Means (B, T, n) and covariances (B, T, d, d)."""
        done, _ = self._run(variants, _KEPT | {"mean", "factor"})
        return np.asarray(done.mean), np.asarray(done.cov)

    def _batch(self, variants: Sequence[Variant]) -> Innovations:
        done, z = self._run(variants, _KEPT)
        sensors = list(z)
        nu, S = done.innovation, done.innovation_cov
        if not self.family.model.several:
            nu, S = {sensors[0]: nu}, {sensors[0]: S}
        seen = {s: seen_in(self.family.plain, s, v) for s, v in z.items()}
        fault = np.asarray(done.fault) > 0
        sound = np.asarray(~fault.any(-1))
        clean_nu, clean_S = {}, {}
        for s in sensors:
            v = np.asarray(nu[s])
            heard = np.isfinite(v) & seen[s]
            one = np.eye(v.shape[-1])
            both = heard[..., :, None] & heard[..., None, :]
            clean_nu[s] = np.where(heard, v, 0.0)
            clean_S[s] = np.where(both & np.isfinite(np.asarray(S[s])), np.asarray(S[s]), one)
        words = done.faults(1)
        return Innovations(
            clean_nu,
            clean_S,
            {s: v if v.ndim == 2 else v[0] for s, v in seen.items()},
            sound,
            words[0] if fault[0].any() else "",
        )

    def _run(self, variants: Sequence[Variant], keep: frozenset[str]) -> tuple[Result, dict[str, np.ndarray]]:
        """As `sigmax.run`, but what it checks of the model is checked once; and what was measured."""
        records = [variant.record for variant in variants]
        alone = all(r is records[0] for r in records)
        inputs = self._inputs(variants)
        mean = np.stack([
            shifted(self.family.plain, r.mean, t.theta[self.of_prior] * np.sqrt(np.diag(r.cov)))
            for t, r in zip(variants, records, strict=True)
        ])  # fmt: skip
        prior = Gaussian(mean, np.stack([r.cov for r in records]))
        # What is the same for all is not repeated: a long record has many values.
        z = {s: v if alone else np.stack([r.z[s] for r in records]) for s, v in records[0].z.items()}
        dt = records[0].dt if alone else np.stack([r.dt for r in records])
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of hypotheses that nobody believes
            return self._filtered(prior, z, dt, inputs, keep), z

    def _filtered(
        self, prior: Gaussian, z: dict[str, np.ndarray], dt: np.ndarray, inputs: np.ndarray, keep: frozenset[str]
    ) -> Result:
        model = self.family.model
        if self._ready is None:
            given = z if model.several else next(iter(z.values()))
            self._ready = prepare(self.filter, model, prior, given, dt, inputs, "float64", self.update_first, _KEPT)
        ready = self._ready._replace(
            mean=np.asarray(prior.mean), cov=np.asarray(prior.cov), z=z, dt=dt, u=inputs, inputs=inputs,
            batch=len(inputs),
        )  # fmt: skip
        total, parts = attempt(
            None, False, lambda: native_engine.filtered(keep, ready), lambda: xla_engine.filtered(keep, ready, False)
        )
        return Result(
            layout=ready.layout._replace(filter=self.filter.name), stored_mean=parts.get("mean"),
            stored_factor=parts.get("factor"),
            stored_fault=parts["fault"], stored_modes=None, stored_innovations=parts["innovation"], stored_nis=None,
            stored_log_likelihood=None, stored_count=None, stored_total=total,
        )  # fmt: skip

    def _inputs(self, variants: Sequence[Variant]) -> np.ndarray:
        """The inputs of the envelope, (B, T, K)."""
        k, T = self.family.driven, len(variants[0].record.dt)
        at = variants[0].record.u.shape[1] + k
        behind = at + len(variants[0].theta)
        M = self.family.measured
        shape = len(variants), T, behind + M + 1
        size = int(np.prod(shape))
        if len(self._room) < size:
            self._room = np.empty(size)  # kept: to clear so much memory takes longer than to fill it
        made = self._room[:size].reshape(shape)
        for row, (theta, r) in zip(made, variants, strict=True):
            row[:, : at - k] = r.u
            late = 0.0 if self.late is None else float(theta[self.late])
            row[:, at - k : at] = _late(r, k, late) - r.u[:, :k] if late else 0.0
            row[:, at:behind] = theta
            if theta[self.skews].any():
                row[:, [at + i for i in self.skews]] = np.outer(np.cumsum(r.dt), theta[self.skews])
            row[:, behind : behind + M] = r.extra + r.out * r.huge
            row[:, -1] = r.q_factor
        return made


def shifted(model: Model, x: np.ndarray, by: np.ndarray) -> np.ndarray:
    """A state (n,) so much off (d,)."""
    return np.asarray(model.space.add(x, by)) if model.curved else x + by


def seen_in(model: Model, sensor: str, z: np.ndarray) -> np.ndarray:
    """Which deviations (..., d) of what a sensor measured (..., m) are known."""
    there = np.moveaxis(~np.isnan(z), -1, 0)
    return np.asarray(np.moveaxis(model.measured_space(sensor, len(there)).whole(there), 0, -1))


def _late(r: RecordData, driven: int, by: float) -> np.ndarray:
    """The user's inputs (T, k) as they were so much before, on straight lines between the rows."""
    t = np.cumsum(r.dt)
    return np.column_stack([np.interp(t - by, t, r.u[:, i]) for i in range(driven)])


def _nis(nu: np.ndarray, S: np.ndarray) -> np.ndarray:
    """ν' S⁻¹ ν of innovations (B, T, m)."""
    if nu.shape[-1] == 1:
        return np.asarray(nu[..., 0] ** 2 / S[..., 0, 0])
    return np.asarray(np.einsum("bti,bti->bt", nu, np.linalg.solve(S, nu[..., None])[..., 0]))


def _log_det(S: np.ndarray) -> np.ndarray:
    """The logarithm of |S| of covariances (B, T, m, m)."""
    return np.asarray(np.log(S[..., 0, 0]) if S.shape[-1] == 1 else np.linalg.slogdet(S)[1])


def cut(d: Any) -> Any:
    """Where a NIS of d components begins to count by its root."""
    return d + 5.0 * np.sqrt(2.0 * np.maximum(d, 1))


def log_likelihood(outcome: Innovations) -> np.ndarray:
    """Of each variant (B,), Huberised: NIS beyond the cut counts by its root; −inf where a step failed."""
    total = np.zeros(len(outcome.sound))
    for s, nis in outcome.nis().items():
        c = cut(outcome.seen[s].sum(-1))
        rho = np.where(nis > c, 2 * np.sqrt(c * np.maximum(nis, 0)) - c, nis)
        total -= 0.5 * (rho + _log_det(outcome.S[s])).sum(-1)
    return np.where(outcome.sound & np.isfinite(total), total, -np.inf)
