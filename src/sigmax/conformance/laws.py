"""The laws: what must hold for every filter, each a function from an implementation to one figure."""

from collections.abc import Callable
from dataclasses import dataclass

from sigmax.conformance import angular, gentle, honest, linear, moments
from sigmax.conformance.task import Adapter


@dataclass(frozen=True)
class Law:
    """A law and how far from it one may be.

    Attributes:
        name: one or two words.
        says: the law, in a sentence, with the unit of the figure.
        measure: the figure of an implementation.
        allowed: the largest figure with which the law is kept.
        needs: what an implementation has to offer for the law to apply.
        degree: to which its means have to be exact for the law to apply.
    """

    name: str
    says: str
    measure: Callable[[Adapter], float]
    allowed: float
    needs: frozenset[str] = frozenset()
    degree: int = 1


_ALL = [
    Law("linear", "On a linear model with full matrices it is the Kalman filter (whitened).",
        linear.plain, 1e-7),
    Law("offset", "The same with a state near 1e7 (whitened).", linear.offset, 1e-5),
    Law("stiff R", "The same with variances of the sensor of 1e-12; still positive definite (whitened).",
        linear.stiff, 0.05),
    Law("Q = 0", "The same without noise of the motion (whitened).", linear.driftless, 1e-7),
    Law("order", "Two measurements at one moment, either order, are two measurements (whitened).",
        linear.order, 1e-7, frozenset({"second update"})),
    Law("missing", "A missing measurement changes nothing (whitened).", linear.missing, 1e-7,
        frozenset({"missing"})),
    Law("partly missing", "Of a measurement with a missing component the other one counts (whitened).",
        linear.partly_missing, 1e-7, frozenset({"partly missing"})),
    Law("long run", "After 1000 steps it still is the Kalman filter, its covariance symmetric (whitened).",
        linear.long_run, 1e-7),
    Law("small noise", "With noise of 0.003 and a model that is not linear it is the extended Kalman filter, whatever "
        "the rule (whitened).", gentle.small, 0.1),
    Law("rotation", "With an angle in the state, turning the scene turns the answer (whitened).",
        angular.rotation, 1e-7, frozenset({"angles"})),
    Law("bearing at π", "A target seen at ±π is tracked like one seen at 0 (whitened).",
        angular.bearing, 1e-7, frozenset({"angles"})),
    Law("moments 3", "The means of cubic polynomials of a Gaussian are exact, in motion and sensor (relative).",
        moments.cubic, 1e-8, degree=3),
    Law("moments 5", "The means of polynomials of degree five are exact, in motion and sensor, and the covariances of "
        "quadratic ones, in the motion (relative).", moments.quintic, 1e-8, degree=5),
    *(Law(f"honest: {name}", f"On {about}, mean squared errors are what the covariance says: the factor by which they "
          "are not, in the direction where it is largest.", measure, 1.4) for name, about, measure in honest.PROBLEMS),
]  # fmt: skip

LAWS = {law.name: law for law in _ALL}
