"""A study: how truth and measurements are drawn, and which filters are to be compared on them."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from sigmax.algebra.factor import Diagonal
from sigmax.errors import InputError, unknown
from sigmax.filters import Filter
from sigmax.modelling.checks import finite, numbers
from sigmax.modelling.model import check_added, check_flat
from sigmax.modelling.switching import check_one_mode
from sigmax.models import Gaussian, Model
from sigmax.rewriting.augment import with_bias

# What a start may be estimated by; a function (x0, w) -> mean besides.
ESTIMATES = ("prior", "drawn")
# How an optimum may be found.
OPTIMA = ("guided", "bootstrap", "bank")
# Numbers that one block of runs may hold of one covariance over time, and the runs it holds where that allows.
_ROOM, _RUNS, _FEWEST = 6_000_000, 256, 8
# Particles times steps of runs that are made together.
_PARTICLES = 1_000_000


# By title: values by label, for each series.
Charts = Mapping[str, Mapping[str, Mapping[str, float]]]


@dataclass(frozen=True, eq=False)
class Study:
    """A scenario with what is to be compared on it.

    Attributes:
        name: short, for folders and tables.
        model: the model that the filters use. A random bias of it is drawn with the truth and judged with the
            state: `model` and `prior` of the study then have it as their last components, `apart` holds
            what was given.
        prior: what they are told of the state one dt before the first measurement.
        steps: T, the number of measurements.
        dt: seconds between them: one number or (T,).
        title: in words.
        nature: the model that truth and measurements follow; without it the filters' own.
            `undisturbed(model)` moves without noise.
        start: the true state (n,) one dt before the first measurement; without it every run draws its own
            from the prior.
        estimate: where the filters start: "prior" at the mean of the prior, "drawn" at a draw around the true
            start with the covariance of the prior, or a function (x0 (n,), w (n,)) -> (n,) of the true start and
            of standard normal numbers.
        detection: probability that a sensor reports at a step: one number, or a dict by sensor.
        measured: which components of the measurement are there at each step (T, m), by sensor, the same in all runs;
            without it all of them.
        inputs: (T, k), the same in all runs, or None.
        filters: the filters by name.
        groups: filters that pictures show together, by the name of the group; without it all together.
        runs: how many runs are made if nothing else is said.
        look: times, in steps from 1, at which histograms and medians are shown.
        mirror: the other state that is the same motion, x -> x, where a model has one: a run that ends
            nearer to it than to the truth is lost.
        limit: error (n,) beyond which a run counts as diverged at the end. Without it four times the deviation
            that a prediction from the prior without any measurement would have, of an angle a right angle at most.
        reach: a run whose truth goes beyond it (n,) has escaped, as one whose truth is not finite: quadratic motions
            have a basin. Escaped runs are counted and left out.
        particles: of the optimum, or members of its bank, 0 for none; it supposes that nature is the filters' model.
        optimum: how it is found: "guided" or "bootstrap" particles, or a "bank" of filters where the motion has so
            little noise that particles run out.
        optimum_runs: the optimum is computed in the first so many runs.
        units: of the components of the state, "" where unknown; angles are radians.
        about: sentences for the report.
        extra: what else the summary is to hold, found once at the end.
        charts: of `extra`, for the page: title of a chart -> series -> value by label.
    """

    name: str
    model: Model
    prior: Gaussian
    steps: int
    dt: Any = 1.0
    title: str = ""
    nature: Model | None = None
    start: Any = None
    estimate: str | Callable[[Any, Any], Any] = "prior"
    detection: Any = 1.0
    measured: Mapping[str, Any] = field(default_factory=dict)
    inputs: Any = None
    filters: Mapping[str, Filter] = field(default_factory=dict)
    groups: Mapping[str, Sequence[str]] = field(default_factory=dict)
    runs: int = 1000
    look: Sequence[int] = ()
    mirror: Callable[[Any], Any] | None = None
    limit: Any = None
    reach: Any = None
    particles: int = 0
    optimum: str = "guided"
    optimum_runs: int = 500
    units: Sequence[str] = ()
    about: Sequence[str] = ()
    extra: Callable[[], Mapping[str, Any]] | None = None
    charts: Callable[[Mapping[str, Any]], Charts] | None = None
    apart: Model | None = field(init=False, default=None)

    def __post_init__(self) -> None:
        if self.model.bias is not None and self.prior.size == self.model.size and self.prior.mean.ndim == 1:
            model, prior = with_bias(self.model, self.prior)
            for what, value in (("apart", self.model), ("model", model), ("prior", prior)):
                object.__setattr__(self, what, value)
        for drawn in (self.model, self.nature or self.model):
            check_added(drawn, f"{self.name}: a study")
        n, d = self.model.size, self.model.dim
        if (np.shape(self.prior.mean), np.shape(self.prior.cov)) != ((n,), (d, d)):
            raise InputError(f"{self.name}: the prior must be of one run: a mean ({n},) and a covariance ({d}, {d})")
        if self.steps < 1:
            raise InputError(f"{self.name}: a study needs at least one step; steps = {self.steps}")
        if isinstance(self.estimate, str) and self.estimate not in ESTIMATES:
            raise unknown("estimate of the start", self.estimate, ESTIMATES)
        if self.optimum not in OPTIMA:
            raise unknown("way to the optimum", self.optimum, OPTIMA)
        for what, given, size in (("start", self.start, n), ("limit", self.limit, d), ("reach", self.reach, n)):
            if given is not None and np.shape(given) != (size,):
                raise InputError(f"{self.name}: {what} must have the shape ({size},); it has {np.shape(given)}")
        if self.particles:
            if self.model.constraints:
                raise InputError(f"{self.name}: the optimum does not know constraints yet: particles=0")
            check_one_mode(self.model, "the optimum, which particles= asks for,")
            check_flat(self.model, "the optimum, which particles= asks for,")
        dt = numbers("dt", self.dt)
        finite("dt", dt)
        if dt.ndim > 1 or (dt.ndim == 1 and len(dt) != self.steps) or (dt < 0).any():
            raise InputError(f"{self.name}: dt must be a number of seconds or one for each of the {self.steps} steps")
        if self.inputs is not None and (np.ndim(self.inputs) != 2 or len(self.inputs) != self.steps):
            raise InputError(f"{self.name}: inputs must have the shape ({self.steps}, k)")
        for sensor, there in self.measured.items():
            if sensor not in self.model.sensors:
                raise unknown("sensor", sensor, self.model.sensors)
            if np.ndim(there) != 2 or len(there) != self.steps:
                raise InputError(f"{self.name}: measured must have the shape ({self.steps}, m) for each sensor")
        if self.nature is not None and (self.nature.size != n or list(self.nature.sensors) != list(self.model.sensors)):
            raise InputError(f"{self.name}: nature must have the state and the sensors of the model")
        for sensor, p in self.detections.items():
            if not 0 <= p <= 1:
                raise InputError(f"{self.name}: the probability of detection of {sensor or 'the sensor'} is {p}")
        for step in self.look:
            if not 1 <= step <= self.steps:
                raise InputError(f"{self.name}: look has the step {step}; there are the steps 1 to {self.steps}")
        if self.units and len(self.units) != d:
            raise InputError(f"{self.name}: units must name {d} units, one a component")

    def model_and_prior(self, mean: Any) -> tuple[Model, Gaussian]:
        """The model and the prior about `mean` (B, n) that the filters are told of."""
        if self.apart is None or self.apart.bias is None:
            return self.model, Gaussian(mean, self.prior.cov)
        n, d = self.apart.size, self.apart.dim
        model = self.apart.with_bias_prior(Gaussian(mean[:, n:], self.prior.cov[d:, d:]))
        return model, Gaussian(mean[:, :n], self.prior.cov[:d, :d])

    @property
    def detections(self) -> dict[str, float]:
        """The probability that each sensor reports.

        Raises:
            InputError: for a sensor that the model does not have.
        """
        if not isinstance(self.detection, Mapping):
            return dict.fromkeys(self.model.sensors, float(self.detection))
        for sensor in self.detection:
            if sensor not in self.model.sensors:
                raise unknown("sensor", sensor, self.model.sensors)
        return {sensor: float(self.detection.get(sensor, 1.0)) for sensor in self.model.sensors}

    @property
    def elapsed(self) -> np.ndarray:
        """Seconds of each step (T,)."""
        return np.broadcast_to(np.asarray(self.dt, float), (self.steps,)).copy()

    @property
    def time(self) -> np.ndarray:
        """Seconds since the prior (T,)."""
        return self.elapsed.cumsum()

    @property
    def looked(self) -> tuple[int, ...]:
        """The steps, from 1, at which it is looked closely: as given, else five over the study."""
        if self.look:
            return tuple(sorted(set(self.look)))
        return tuple(dict.fromkeys(np.geomspace(1, self.steps, 5).round().astype(int).tolist()))

    @property
    def fair(self) -> bool:
        """Whether truth is drawn as the filters suppose, so that an optimum and a bound are defined."""
        return self.nature is None and self.start is None and self.estimate == "prior"

    def piece(self, particles: int) -> int:
        """The runs for which the optimum is found together: so few that it takes seconds; a part of a block."""
        fitting = _PARTICLES // (max(particles, 1) * self.steps)
        return int(min(self.block, 64, 2 ** int(np.log2(max(fitting, 8)))))

    @property
    def unasked(self) -> str:
        """Why it cannot be asked whether a filter errs as it claims, "" where it can."""
        if self.start is not None and self.estimate == "prior":
            return "all runs begin with the same truth and the same estimate, so that the first error is no draw"
        if self.nature is not None and _still(self.nature) and not _still(self.model):
            return "the truth moves without the noise that the filters suppose"
        return ""

    @property
    def block(self) -> int:
        """The runs that are made together; numbers depend on it, so it depends on the study alone.

        Raises:
            InputError: for a study whose covariances of a few runs do not fit into memory.
        """
        fitting = _ROOM // (self.steps * self.model.size**2)
        if fitting < _FEWEST:
            raise InputError(
                f"{self.name}: {self.steps} steps of {self.model.size} components are too much to be kept for "
                f"{_FEWEST} runs at once: use at most {_ROOM // (_FEWEST * self.model.size**2)} steps, or a longer dt"
            )
        return int(min(_RUNS, 2 ** int(np.log2(fitting))))


def _still(model: Model) -> bool:
    Q = model.Q
    return not callable(Q) and not np.any(np.asarray(Q.entries if isinstance(Q, Diagonal) else Q))


def undisturbed(model: Model) -> Model:
    """The same model without noise of the motion: a truth that is fixed."""
    return model.with_parts(Q=Diagonal(np.zeros(model.size)))
