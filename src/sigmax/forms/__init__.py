"""Forms: how a filter stores its covariance and what it does with a linearisation."""

from sigmax.forms.covariance import covariance
from sigmax.forms.form import Corrected, Form, Predicted
from sigmax.forms.information import information
from sigmax.forms.square_root import block, root_information, square_root
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
]
