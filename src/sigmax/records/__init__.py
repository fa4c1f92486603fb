"""Records: real measurements with the model for them, built in or the user's own."""

from sigmax.descriptions.trial import Trial, parse_trial, with_updates
from sigmax.files.userfile import functions_allowed_from
from sigmax.records.find_model import find_model
from sigmax.records.load import builtin, load, load_plots
from sigmax.records.record import Backdrop, Record
from sigmax.records.tracking import Outcome, check, robust_trial, track

__all__ = [
    "Backdrop",
    "Outcome",
    "Record",
    "Trial",
    "builtin",
    "check",
    "find_model",
    "functions_allowed_from",
    "load",
    "load_plots",
    "parse_trial",
    "robust_trial",
    "track",
    "with_updates",
]
