"""Forms: what a filter does with a linearisation and the factor of its covariance."""

from sigmax.forms.form import Corrected, Form, Predicted
from sigmax.forms.information import information, root_information, without_omega
from sigmax.forms.square_root import block, covariance, square_root
from sigmax.forms.two_stage import two_stage

__all__ = [
    "Corrected",
    "Form",
    "Predicted",
    "block",
    "covariance",
    "information",
    "root_information",
    "square_root",
    "two_stage",
    "without_omega",
]
