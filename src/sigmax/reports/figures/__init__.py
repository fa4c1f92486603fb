"""The figures of the page, as the dictionaries that plotly.js draws."""

from sigmax.reports.figures.components import component_figure
from sigmax.reports.figures.draw import Figure, Shown, colour, limit, shown_in
from sigmax.reports.figures.examination import examination_figures
from sigmax.reports.figures.modes import modes_figure
from sigmax.reports.figures.nis import nis_figure
from sigmax.reports.figures.path import path_figure
from sigmax.reports.figures.weights import weights_figure

__all__ = [
    "Figure",
    "Shown",
    "colour",
    "component_figure",
    "examination_figures",
    "limit",
    "modes_figure",
    "nis_figure",
    "path_figure",
    "shown_in",
    "weights_figure",
]
